"""Surfaces of frames that no scan shows, from those of the scanned frames beside them in time."""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import Floats


def between_scans(y: Floats, scanned: np.ndarray, reach: int) -> Floats:
    """Displacements y (T,n,3) of consecutive frames from their posed model, those of frames that are not `scanned` (T,) replaced.

    A frame t takes those of the last scan before it and of the next, k frames apart, by the shares

        h(1 - |t - scan| / min(k, reach)),     h(u) = u^2 (3 - 2 u) in [0, 1],

    and its own by what is left of 1: by nothing between scans within `reach` frames of one another, by all where none lies
    within `reach`. So nothing jumps, and no share depends on frames farther than `reach`."""
    scans, filled = np.flatnonzero(scanned), y.copy()
    if not len(scans):
        return filled
    for t in np.flatnonzero(~scanned):
        beside, share = _shares(scans, t, reach)
        filled[t] = (1 - share.sum()) * y[t] + np.einsum("k,kni->ni", share, y[beside])
    return filled


def told_by(scanned: np.ndarray, reach: int) -> np.ndarray:
    """(T,) the frame that gives a frame at least half of what `between_scans` puts there: itself, or a scan."""
    scans, told = np.flatnonzero(scanned), np.arange(len(scanned))
    for t in np.flatnonzero(~scanned) if len(scans) else ():
        beside, share = _shares(scans, t, reach)
        if share.max() >= 0.5:
            told[t] = beside[share.argmax()]
    return told


def _shares(scans, t, reach):
    """The scanned frames beside the frame t, and their shares."""
    i = np.searchsorted(scans, t)
    beside = scans[max(i - 1, 0) : i + 1]
    span = min(np.ptp(beside) or reach, reach)  # one scan alone: at the ends
    return beside, _smoothstep(1 - np.abs(t - beside) / span)


def _smoothstep(u):
    u = np.clip(u, 0, 1)
    return u * u * (3 - 2 * u)
