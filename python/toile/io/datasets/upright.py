"""The world of a data set with its up axis among those that a scene may have."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from ...scene import Camera
from ..importing import moved, turned_up, up_of


def upright(source: Path, cameras: dict[str, Camera], up: str) -> tuple[dict[str, Camera], str, Floats, str]:
    """The cameras turned, their up axis, the turn (3,3), and a note of it; `up` "" is what the cameras hold up."""
    given = up or up_of(cameras.values())
    if not given:
        raise UserError(f"{source}: its cameras do not tell which axis is up: say --up x, y, z, -x, -y or -z")
    axis, turn = turned_up(given)
    turned = "" if np.trace(turn) == 3 else f", turned by half a turn to {axis}"
    return moved(cameras, 1.0, turn), axis, turn, f"up: {given}{'' if up else ' (told by the cameras)'}{turned}"
