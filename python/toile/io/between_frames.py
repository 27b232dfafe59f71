"""A motion's frames at the instants of another rate: turned and moved between the two that lie about each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..kernels.arrays import Anything, Floats

ROUNDED = 0.01  # of a frame: files round their frame time


@dataclass(frozen=True)
class BetweenFrames:
    """Instants between rows: a `share` (n,) of the way from rows `below` (n,) to rows `above` (n,), the same ones where it is 0."""

    below: Anything
    above: Anything
    share: Floats

    @classmethod
    def of(cls, instants: Floats, numbers: Anything) -> BetweenFrames:
        """Of instants (n,), in frames, among rows that are numbered so (T,)."""
        below = np.searchsorted(numbers, instants, side="right") - 1
        above = np.minimum(below + 1, len(numbers) - 1)
        gap = np.maximum(numbers[above] - numbers[below], 1)
        share, rounded = (instants - numbers[below]) / gap, ROUNDED / gap
        below = np.where(share > 1 - rounded, above, below)
        share = np.where((share > 1 - rounded) | (share < rounded), 0.0, share)
        return cls(below, np.where(share == 0, below, above), share)

    def moved(self, a: Floats, b: Floats) -> Floats:
        """Values (n,...) between those of both rows; those of `a` to the bit where the share is 0."""
        share = self.share.reshape(-1, *[1] * (a.ndim - 1))
        return np.where(share == 0, a, a + share * (b - a))

    def turned(self, a: Floats, b: Floats) -> Floats:
        """Rotation vectors (n,K,3) on the shortest turn from a to b; those of `a` to the bit where the share is 0."""
        from scipy.spatial.transform import Rotation

        rows, out = np.flatnonzero(self.share), a.copy()
        first, second = (Rotation.from_rotvec(x[rows].reshape(-1, 3)) for x in (a, b))
        share = np.repeat(self.share[rows], a.shape[1])[:, None]
        turn = Rotation.from_rotvec(share * (first.inv() * second).as_rotvec())
        out[rows] = (first * turn).as_rotvec().reshape(out[rows].shape)
        return out
