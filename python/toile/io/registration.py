"""What tells one registration of a capture from another, whatever folder it lies in."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from itertools import product

from .run import RegisteredSurface, Run


def registration(run: Run, frames: Sequence[int], surfaces: Collection[RegisteredSurface]) -> str:
    """A digest of these frames' poses in a Run, and of its `surfaces` in each of them."""
    rows = run.rows(frames)
    digest = hashlib.sha256(run.pose.rotations[rows].tobytes() + run.pose.translation[rows].tobytes())
    for number, surface in product(frames, surfaces):
        digest.update(surface.at(number).tobytes())
    return digest.hexdigest()
