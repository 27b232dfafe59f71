"""OUT/LAYER/000017.obj or .ply: a mesh a layer and frame, numbered as the frames are, in the clip's axes and metres."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...scene import Mesh
from ..mesh import write_mesh
from .clip import Clip


def write_sequence(clip: Clip, folder: Path, kind: str, progress: Callable[..., None]) -> None:
    """OBJ with UVs and 7 decimals, PLY in single precision."""
    for done, frame in enumerate(clip.frames):
        for layer in clip.layers:
            mesh = Mesh(layer.at(frame), layer.faces, layer.uv, layer.face_uv)
            write_mesh(folder / layer.name / f"{frame:06d}.{kind}", mesh)
        progress("export", done + 1, len(clip.frames))
