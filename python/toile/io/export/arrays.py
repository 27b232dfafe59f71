"""A clip as one .npz without pickles, in double precision, in the clip's axes and metres.

frames (T,), fps, up; of each layer LAYER.vertices (T,n,3), LAYER.faces (m,3), and where it has them LAYER.uv (t,2),
LAYER.face_uv (m,3), LAYER.joints and LAYER.weights (n,B); of the skeleton skeleton.names (K,), .parents (K,), .J (K,3),
.rotations (T,K,3), .translation (T,3).
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from ...kernels.arrays import Anything
from .clip import Clip


def write_arrays(clip: Clip, path: Path, progress: Callable[..., None]) -> list[str]:
    """A frame in memory at a time."""
    fixed: dict[str, Anything] = {
        "frames": np.array(clip.frames),
        "fps": np.array(clip.fps),
        "up": np.array(clip.up),
    }
    for layer in clip.layers:
        parts = {"faces": layer.faces, "uv": layer.uv, "face_uv": layer.face_uv}
        parts |= {"joints": layer.joints, "weights": layer.weights}
        fixed |= {f"{layer.name}.{name}": np.asarray(part) for name, part in parts.items() if part is not None}
    if clip.skeleton is not None:
        poses = [clip.skeleton.pose(frame) for frame in clip.frames]
        fixed |= {
            "skeleton.names": np.array(clip.skeleton.names),
            "skeleton.parents": np.array(clip.skeleton.parents),
            "skeleton.J": np.asarray(clip.skeleton.J),
            "skeleton.rotations": np.stack([rotations for rotations, _ in poses]),
            "skeleton.translation": np.stack([translation for _, translation in poses]),
        }
    total = len(clip.layers) * len(clip.frames)
    with zipfile.ZipFile(path, "w") as file:
        for name, array in fixed.items():
            add_array(file, name, array.shape, array.dtype, [array])
        for i, layer in enumerate(clip.layers):

            def rows() -> Iterable[Anything]:
                for k, frame in enumerate(clip.frames):
                    yield layer.at(frame)
                    progress("export", i * len(clip.frames) + k + 1, total)

            shape = (len(clip.frames), *layer.at(clip.frames[0]).shape)
            add_array(file, f"{layer.name}.vertices", shape, np.dtype(np.float64), rows())
    return []


def add_array(
    file: zipfile.ZipFile, name: str, shape: tuple[int, ...], dtype: np.dtype, parts: Iterable[Anything]
) -> None:
    """An array of a .npz, written in parts along its first axis."""
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with file.open(f"{name}.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, header)
        for part in parts:
            member.write(np.ascontiguousarray(part, dtype).tobytes())
