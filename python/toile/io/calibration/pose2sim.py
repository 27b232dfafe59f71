"""TOML of Pose2Sim, aniposelib and FreeMoCap: a table a camera with `name, size [w, h], matrix, distortions, rotation`
(Rodrigues) and `translation`, world to camera; pixel centres are whole numbers, as OpenCV calibrates.

Left: `[metadata]`, and a table's other fields. With `fisheye = true` distortions are k1 k2 k3 k4 of a fisheye. Pose2Sim writes
metres, FreeMoCap millimetres.
"""

from __future__ import annotations

from pathlib import Path

from ...errors import UserError
from ...scene import Camera
from ..bounded import read_toml
from .checked import HALF, add, fisheye_lens, intrinsics, make_camera, numbers, rigid, rotation

NAMES = ("*.toml",)
OTHERS = ("Config.toml",)  # Pose2Sim's settings, at the root of its projects


def read(path: Path, notes: list[str]) -> dict[str, Camera]:
    """{name: Camera}, in the order of the file."""
    cameras: dict[str, Camera] = {}
    for table, fields in read_toml(path).items():
        if not isinstance(fields, dict) or "matrix" not in fields:
            continue
        for field in ("size", "rotation", "translation"):
            if field not in fields:
                raise UserError(f"{path}: {table}.{field} is missing")
        K = numbers(path, f"{table}.matrix", fields["matrix"], (3, 3))
        K = intrinsics(K[0, 0], K[1, 1], K[0, 2] + HALF, K[1, 2] + HALF, K[0, 1])
        width, height = numbers(path, f"{table}.size", fields["size"], (2,))
        R = rotation(path, f"{table}.rotation", fields["rotation"])
        t = numbers(path, f"{table}.translation", fields["translation"], (3,))
        name = str(fields.get("name", table))
        bend = fields.get("distortions", [0.0] * 5)
        lens = fisheye_lens(path, f"{table}.", bend, f"{table}.fisheye" if fields.get("fisheye") else "")
        add(path, cameras, make_camera(path, name, (int(height), int(width)), K, bend, rigid(R, t), lens))
    return cameras
