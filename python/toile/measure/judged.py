"""What a verdict is given: surfaces with what was found of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class JudgedLayer:
    """A surface that a frame was registered as. `label`: of the scan's points that are its own; None for all of them."""

    name: str
    label: int | None
    vertices: np.ndarray  # (n,3) [m]
    faces: np.ndarray  # (m,3)
    confidence: np.ndarray  # (n,)
    looks: np.ndarray  # indices (k,) of the vertices that a scan can show
