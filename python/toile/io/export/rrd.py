"""A recording for rerun's viewer: each layer a mesh over the time lines `frame` and `time`, in the clip's axes and metres."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...kernels import vertex_normals
from .clip import Clip
from .usd import GREYS


def write_rrd(clip: Clip, path: Path, progress: Callable[..., None]) -> list[str]:
    """Writes .rrd in single precision, vertices and normals a frame. UserError: rerun-sdk is not installed."""
    try:
        import rerun
    except ImportError:
        raise UserError("--format rrd: rerun is not installed: pip install rerun-sdk") from None
    recording = rerun.RecordingStream("toile", recording_id=clip.name)
    recording.save(path)
    up = {"x": "RIGHT_HAND_X_UP", "y": "RIGHT_HAND_Y_UP", "z": "RIGHT_HAND_Z_UP"}[clip.up]
    recording.log("/", getattr(rerun.ViewCoordinates, up), static=True)
    for i, layer in enumerate(clip.layers):
        grey = round(255 * GREYS[i % len(GREYS)])
        still = rerun.Mesh3D.from_fields(triangle_indices=np.asarray(layer.faces), albedo_factor=(grey, grey, grey))
        recording.log(layer.name, still, static=True)
    for done, frame in enumerate(clip.frames):
        recording.set_time("frame", sequence=frame)
        recording.set_time("time", duration=frame / clip.fps)
        for layer in clip.layers:
            V = np.ascontiguousarray(layer.at(frame), np.float64)
            N = vertex_normals(V, np.ascontiguousarray(layer.faces, np.int32))
            moved = rerun.Mesh3D.from_fields(vertex_positions=V.astype(np.float32), vertex_normals=N.astype(np.float32))
            recording.log(layer.name, moved)
        progress("export", done + 1, len(clip.frames))
    recording.disconnect()  # all is written
    return []
