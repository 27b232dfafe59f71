"""Open loops of a garment: their match to the openings of a labelled scan."""

from dataclasses import dataclass

import numpy as np

from .curves import Curve, resample, tangents


@dataclass(frozen=True)
class LoopMatch:
    """Where one loop should lie: `target` (k,3) [m] per loop vertex, `observed` (k,) whether an opening was seen there,
    `distance` (k,) [m] left between target and opening, NaN where none was seen."""

    target: np.ndarray
    observed: np.ndarray
    distance: np.ndarray


def loop_length(points):
    return float(np.linalg.norm(np.roll(points, -1, 0) - points, axis=1).sum())


def match_loops(loops, curves, settings):
    """Moves closed loops [(k,3)] onto openings [Curve], both with the garment on their left.

    Each step pulls every loop vertex towards the nearest opening point that runs its way and is nearer to this loop than
    to any other; a closed spline of decreasing stiffness fills the gaps. Returns a LoopMatch a loop, and the length
    of opening that no loop claimed [m]. `settings` are LoopSettings.
    """
    from scipy.spatial import cKDTree

    s = settings
    openings = [resample(c, s.spacing) for c in curves if c.length > s.min_length]
    if not openings:
        return [LoopMatch(l, np.zeros(len(l), bool), np.full(len(l), np.nan)) for l in loops], 0.0
    P, T = np.concatenate([r.points for r in openings]), np.concatenate([tangents(r) for r in openings])
    at, interpolations = [loop.copy() for loop in loops], [LoopInterpolation(len(loop), s) for loop in loops]
    owner = np.concatenate([np.full(len(l), i) for i, l in enumerate(loops)])
    for step in range(s.steps):
        fade = step / max(s.steps - 1, 1)
        reach = s.reach * (1 - fade) + s.final_reach * s.reach * fade
        bending = s.bending * 10 ** (-s.bending_decades * fade)
        claimed = owner[cKDTree(np.concatenate(at)).query(P)[1]]
        for i, loop in enumerate(loops):
            target, observed, _ = _nearest_opening(at[i], P[claimed == i], T[claimed == i], reach, s)
            if observed.sum() >= 3:
                at[i] = loop + interpolations[i](target - loop, observed, at[i], bending)
    matches, used = [], np.zeros(len(P), bool)
    claimed = owner[cKDTree(np.concatenate(at)).query(P)[1]]
    for i in range(len(loops)):
        _, observed, distance = _nearest_opening(at[i], P[claimed == i], T[claimed == i], s.matched_distance, s)
        matches.append(LoopMatch(at[i], observed, distance))
    used = cKDTree(np.concatenate(at)).query(P)[0] < s.claimed_distance
    return matches, float(s.spacing * (~used).sum())


def _nearest_opening(at, P, T, reach, settings):
    """Per loop vertex the nearest of opening points P with directions T: target (k,3), found (k,), distance (k,)."""
    from scipy.spatial import cKDTree

    k = len(at)
    if len(P) == 0:
        return at, np.zeros(k, bool), np.full(k, np.nan)
    way, turn = tangents(Curve(at, True)), settings.turn
    _, j = cKDTree(np.concatenate([P, turn * T], 1)).query(np.concatenate([at, turn * way], 1))
    d = np.linalg.norm(P[j] - at, axis=1)
    found = (d < reach) & (np.einsum("ki,ki->k", way, T[j]) > settings.min_cosine)
    target = np.where(found[:, None], P[j], at)
    # loop vertices beyond the end of an open curve all find its last point, which itself belongs to one of them
    _, back = cKDTree(np.concatenate([at, turn * way], 1)).query(np.concatenate([P, turn * T], 1)[j])
    edge = loop_length(at) / k
    found &= np.linalg.norm(at[back] - at, axis=1) < edge
    found &= np.abs(np.einsum("ki,ki->k", target - at, way)) < np.maximum(
        settings.max_slant * d, settings.max_slide * edge
    )
    return target, found, np.where(found, d, np.nan)


class LoopInterpolation:
    """Displacements of a closed curve of k points from those that are known; the places of the matrix' entries are kept.
    `settings` are LoopSettings."""

    def __init__(self, k, settings):
        i, c = np.arange(k), np.arange(3)
        beside = (i[:, None] + np.arange(-2, 3)) % k
        along = np.broadcast_to(3 * i[:, None, None] + c, (k, 5, 3)), 3 * beside[..., None] + c
        blocks = (
            np.broadcast_to(3 * i[:, None, None] + c[:, None], (k, 3, 3)),
            np.broadcast_to(3 * i[:, None, None] + c, (k, 3, 3)),
        )
        # the loop folded flat: its matrix is a band, though the curve is closed
        fold = np.where(i < (k + 1) // 2, 2 * i, 2 * (k - 1 - i) + 1)
        self.place, self.k, self.settings = (3 * fold[:, None] + c).ravel(), k, settings
        row, column = (self.place[np.concatenate([a.ravel(), b.ravel()])] for a, b in zip(along, blocks))
        self.upper = row <= column
        row, column = row[self.upper], column[self.upper]
        self.width = int((column - row).max())
        self.entry = (self.width + row - column) * 3 * k + column

    def __call__(self, wanted, known, at, bending, hold=1e-6):
        """argmin_d sum_known |P (d - wanted)|^2 + bending sum |d''|^2 + stretch sum |d'|^2 for wanted, at, d (k,3).

        P takes away all but a trace of what runs along the curve `at`: a loop slides along its opening until its own length
        is spread evenly, so that seen parts do not drain the unseen ones. Points that are not known
        are held where they are by the weight `hold`."""
        from scipy.linalg import solveh_banded

        way, s = tangents(Curve(at, True)), self.settings
        P = known[:, None, None] * (np.eye(3) - (1 - s.slide) * way[:, :, None] * way[:, None, :])
        stretch = s.stretch + s.stretch_share * bending
        stencil = bending * np.array([1, -4, 6, -4, 1]) + stretch * np.array([0, -1, 2, -1, 0])
        values = np.concatenate([np.tile(np.repeat(stencil, 3), self.k), (P + hold * np.eye(3)).ravel()])
        size = 3 * self.k
        band = np.bincount(self.entry, values[self.upper], (self.width + 1) * size).reshape(-1, size)
        right = np.empty(size)
        right[self.place] = np.einsum("kij,kj->ki", P, wanted).ravel()
        return solveh_banded(band, right)[self.place].reshape(-1, 3)
