"""Few points in place of many."""

from __future__ import annotations

import numpy as np

from .. import kernels


def spread_points(V, count):
    """Indices (k,), rising, of at most `count` of the points (n,3): number 0, then each the farthest from those before it
    (Gonzalez 1985)."""
    chosen, distance = [0], np.linalg.norm(V - V[0], axis=1)
    while len(chosen) < min(count, len(V)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(V - V[chosen[-1]], axis=1))
    return np.sort(chosen)


def by_area(V, F, count):
    """Faces (count,) that equal steps of area fall on, some more than once, and the area of a step: even samples of a
    surface without a draw."""
    area = np.cumsum(kernels.face_areas(V, F))
    step = float(area[-1]) / count
    return np.searchsorted(area, (np.arange(count) + 0.5) * step).clip(max=len(F) - 1), step
