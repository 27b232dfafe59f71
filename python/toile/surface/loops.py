"""Open loops of a garment: their match to the openings of a labelled scan."""

from dataclasses import dataclass

import numpy as np

from .curves import resample, tangents


@dataclass(frozen=True)
class LoopMatch:
    """Where one loop should lie: `target` (k,3) [m] per loop vertex, `observed` (k,) whether an opening was seen there,
    `distance` (k,) [m] left between target and opening, NaN where none was seen, and the
    share `shown` within the usual reach, which verdicts count, where a wider search followed."""

    target: np.ndarray
    observed: np.ndarray
    distance: np.ndarray
    shown: float | None = None


def loop_length(points):
    return float(np.linalg.norm(np.roll(points, -1, 0) - points, axis=1).sum())


def astray(lengths, rank, share):
    """Which lengths (s,) of one loop, NaN where unknown, are shorter than this share of the one at that rank (0..1), or as
    much longer."""
    known = lengths[np.isfinite(lengths)]
    whole = np.quantile(known, rank, method="nearest") if len(known) else 0
    return (lengths < share * whole) | (lengths * share > whole)


def beside_loops(V, loops, reach):
    """Which of points V (n,3) lie within `reach` [m] of one of these loops, indices of them."""
    from scipy.spatial import cKDTree

    on = np.concatenate([V[loop] for loop in loops]) if len(loops) else np.zeros((0, 3))
    return cKDTree(on).query(V, distance_upper_bound=reach)[0] < reach


def relaid(at, match, false, instead, settings):
    """The LoopMatch of a loop at (k,3), of which the targets of the vertices `false` (k,) count as not seen: these are drawn to their
    places `instead` (k,3), and the loop is laid anew."""
    seen = match.observed & ~false
    move = np.where(false[:, None], instead, match.target) - at
    bending = settings.bending / 10**settings.bending_decades
    move = LoopInterpolation([len(at)], settings)(move, seen | false, at, bending, settings.stay_weight)
    return LoopMatch(at + move, seen, np.where(seen, match.distance, np.nan))


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
    own, start = _Loops([len(loop) for loop in loops]), np.concatenate(loops)
    at, interpolation = start.copy(), LoopInterpolation(own.sizes, s)
    for step in range(s.steps):
        fade = step / max(s.steps - 1, 1)
        reach = s.reach * (1 - fade) + s.final_reach * s.reach * fade
        bending = s.bending * 10 ** (-s.bending_decades * fade)
        target, observed, _ = _nearest_opening(own, at, P, T, reach, s)
        drawn = (np.bincount(own.owner, observed) >= 3)[own.owner]
        at = np.where(drawn[:, None], start + interpolation(target - start, observed & drawn, at, bending), at)
    _, observed, distance = _nearest_opening(own, at, P, T, s.matched_distance, s)
    used = cKDTree(at).query(P)[0] < s.claimed_distance
    matches = [LoopMatch(*of) for of in zip(own.split(at), own.split(observed), own.split(distance))]
    return matches, float(s.spacing * (~used).sum())


class _Loops:
    """Closed loops of `sizes` points each, one after the other: rows of the points before and after each, and its loop."""

    def __init__(self, sizes):
        self.sizes, self.ends = sizes, np.cumsum(sizes)
        first = self.ends - sizes
        self.owner = np.repeat(np.arange(len(sizes)), sizes)
        i, k, first = np.arange(self.ends[-1]), np.repeat(sizes, sizes), np.repeat(first, sizes)
        self.before, self.after = (first + (i - first + step) % k for step in (-1, 1))

    def split(self, values):
        return np.split(values, self.ends[:-1])

    def mean(self, values):
        """The mean (n,) over its loop of each of values (n,)."""
        return (np.bincount(self.owner, values) / self.sizes)[self.owner]

    def tangents(self, at):
        """Unit directions (n,3) along the loops."""
        d = at[self.after] - at[self.before]
        return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)


def _nearest_opening(own, at, P, T, reach, settings):
    """Per loop vertex the nearest of opening points P with directions T that are nearest to its loop: target (n,3), found
    (n,), distance (n,)."""
    from scipy.spatial import cKDTree

    apart = 1e3  # [m] puts loops so far from one another that none finds another's points
    claimed = own.owner[cKDTree(at).query(P)[1]]
    way, turn = own.tangents(at), settings.turn
    loops = np.concatenate([at, turn * way, apart * own.owner[:, None]], 1)
    openings = np.concatenate([P, turn * T, apart * claimed[:, None]], 1)
    _, j = cKDTree(openings).query(loops)
    d = np.linalg.norm(P[j] - at, axis=1)
    found = (claimed[j] == own.owner) & (d < reach) & (np.einsum("ki,ki->k", way, T[j]) > settings.min_cosine)
    target = np.where(found[:, None], P[j], at)
    # loop vertices beyond the end of an open curve all find its last point, which itself belongs to one of them
    _, back = cKDTree(loops).query(openings[j])
    edge = own.mean(np.linalg.norm(at[own.after] - at, axis=1))
    found &= np.linalg.norm(at[back] - at, axis=1) < edge
    found &= np.abs(np.einsum("ki,ki->k", target - at, way)) < np.maximum(
        settings.max_slant * d, settings.max_slide * edge
    )
    return target, found, np.where(found, d, np.nan)


class LoopInterpolation:
    """Displacements of closed curves of `sizes` points each, one after the other, from those that are known; the places of
    the matrix' entries are kept. `settings` are LoopSettings."""

    def __init__(self, sizes, settings):
        self.own, c = _Loops(sizes), np.arange(3)
        self.size, self.settings = 3 * self.own.ends[-1], settings
        i, before, after = np.arange(self.own.ends[-1]), self.own.before, self.own.after
        beside = np.stack([before[before], before, i, after, after[after]], 1)
        along = np.broadcast_to(3 * i[:, None, None] + c, (len(i), 5, 3)), 3 * beside[..., None] + c
        blocks = (
            np.broadcast_to(3 * i[:, None, None] + c[:, None], (len(i), 3, 3)),
            np.broadcast_to(3 * i[:, None, None] + c, (len(i), 3, 3)),
        )
        # each loop folded flat: the matrix is a band, though the curves are closed
        self.place = (
            3 * np.concatenate([end - k + _folded(k) for k, end in zip(sizes, self.own.ends)])[:, None] + c
        ).ravel()
        row, column = (self.place[np.concatenate([a.ravel(), b.ravel()])] for a, b in zip(along, blocks))
        self.upper = row <= column
        row, column = row[self.upper], column[self.upper]
        self.width = int((column - row).max())
        self.entry = (self.width + row - column) * self.size + column

    def __call__(self, wanted, known, at, bending, hold=1e-6):
        """argmin_d sum_known |P (d - wanted)|^2 + bending sum |d''|^2 + stretch sum |d'|^2 for wanted, at, d (n,3).

        P takes away all but a trace of what runs along the curve `at`: a loop slides along its opening until its own length
        is spread evenly, so that seen parts do not drain the unseen ones. Points that are not known
        are held where they are by the weight `hold`."""
        from scipy.linalg import solveh_banded

        way, s = self.own.tangents(at), self.settings
        P = known[:, None, None] * (np.eye(3) - (1 - s.slide) * way[:, :, None] * way[:, None, :])
        stretch = s.stretch + s.stretch_share * bending
        stencil = bending * np.array([1, -4, 6, -4, 1]) + stretch * np.array([0, -1, 2, -1, 0])
        values = np.concatenate([np.tile(np.repeat(stencil, 3), len(at)), (P + hold * np.eye(3)).ravel()])
        band = np.bincount(self.entry, values[self.upper], (self.width + 1) * self.size).reshape(-1, self.size)
        right = np.empty(self.size)
        right[self.place] = np.einsum("kij,kj->ki", P, wanted).ravel()
        return solveh_banded(band, right)[self.place].reshape(-1, 3)


def _folded(k):
    """Places (k,) of a closed curve's points where neighbours are at most two places apart."""
    i = np.arange(k)
    return np.where(i < (k + 1) // 2, 2 * i, 2 * (k - 1 - i) + 1)
