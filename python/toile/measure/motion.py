"""Registered motion against the true one, a frame at a time: how its errors jitter, and whether it is as smooth."""

from __future__ import annotations

import numpy as np

from ..kernels import SurfaceIndex

ON_SURFACE = 0.02  # m: a vertex farther from the true surface has no place on it


class MotionError:
    """Sums of the lengths of second differences over time, of places and of their errors, over consecutive frames."""

    def __init__(self):
        self.last, self.sums, self.count = {}, np.zeros(3), 0

    def add(self, number, V, place):
        """Vertices (n,3) and their true places in the next frame."""
        self.last = {n: x for n, x in self.last.items() if n >= number - 2} | {number: np.stack([V, place, V - place])}
        if number - 1 in self.last and number - 2 in self.last:
            bend = self.last[number - 2] - 2 * self.last[number - 1] + self.last[number]
            self.sums += np.linalg.norm(bend, axis=2).sum(1)
            self.count += len(V)

    def measures(self):
        """jitter_mm: mean length of the error's second differences; acceleration: of those of the places, as a share of
        the true ones. None where no three frames follow one another."""
        if not self.count:
            return {"jitter_mm": None, "acceleration": None}
        found, true, error = self.sums
        return {"jitter_mm": float(1e3 * error / self.count), "acceleration": float(found / true) if true else None}


class Followed:
    """Vertices of the body whose places on the true one, of another topology, are those nearest to them in one frame."""

    def __init__(self, V, shown, true_V, true_F):
        """`shown` (n,): vertices that are worth following."""
        face, _, bary, distance = SurfaceIndex(true_V, true_F).closest(V)
        self.at = np.flatnonzero(shown & (distance < ON_SURFACE))
        self.corners, self.bary = true_F[face[self.at]], bary[self.at]

    def places(self, true_V):
        """(k,3), of the vertices `at`."""
        return np.einsum("kc,kci->ki", self.bary, true_V[self.corners])
