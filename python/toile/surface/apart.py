"""Motions whose limbs stay out of the trunk and of one another, changed as little and as smoothly as can be.

The equations: docs/method/animation.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_diag, diags, eye, kron

from .. import kernels

MARGIN = 0.006  # [m] between skins, or what they wear, where limbs had run into something
LENGTH = 0.015  # [m] that a radian of change costs as much as
LAG = 0.15  # [s] over which a change comes and goes
AROUND = 0.5  # [s] before and after a collision that may change
ROUNDS = 20
STALE = 0.01  # [rad] that turns may change until contacts are looked for again
PUSH = 0.02  # [m] that a contact is pushed in a round, at most
STEP = 0.3  # [rad] largest change of a turn in a round
CHUNK = 256  # poses at a time


@dataclass(frozen=True)
class Apart:
    """A motion's rotations (T,K,3), changed; how far its most changed joint was turned (T,) [rad], 0 where nothing was; and pairs of
    faces of limbs and other parts (T,), see `Limbs.pairs`, as given and left."""

    rotations: np.ndarray
    angles: np.ndarray
    pairs_before: np.ndarray
    pairs_left: np.ndarray

    def facts(self, rows):
        """What was done to these rows, in numbers: frames whose poses were changed, the largest turn of a joint, pairs, and
        frames that keep some."""
        angles, before, left = self.angles[rows], self.pairs_before[rows], self.pairs_left[rows]
        return {
            "frames_changed": int((angles > 0).sum()),
            "largest_turn_deg": round(float(np.degrees(angles.max())), 1),
            "pairs_before": int(before.sum()),
            "pairs_left": int(left.sum()),
            "frames_left": int((left > 0).sum()),
        }


def keep_apart(limbs, frames, rotations, translation, fps, needed=None, progress=lambda stage, done, total: None):
    """A motion of rotation vectors (T,K,3) and translations (T,3) [m] with the limbs of a `Limbs`, and what they wear, out of its
    other parts -> Apart.

    `frames` (T,) numbers it at `fps` a second; where they leave a gap, what lies on either side is solved by itself. Only rows within
    AROUND of a collision change: a motion without one comes back as it is, bit for bit. `needed` (T,) bool: rows that are asked for;
    they come out the same as with all, and others stay as given but for stretches that hold one of them."""
    before, hit, found = np.zeros(len(rotations), int), np.zeros(len(rotations), bool), []
    needed = np.ones(len(frames), bool) if needed is None else needed
    steps = np.diff(frames)
    step = int(steps.min(initial=1 if len(steps) == 0 else steps.max()))
    rate = fps / step
    for rows in np.split(np.arange(len(frames)), np.flatnonzero(steps != step) + 1):
        around = int(np.ceil(AROUND * rate))
        say = lambda done, total: progress("collisions of limbs", int(rows[0]) + done, int(rows[0]) + total)
        before[rows], hit[rows] = _collided(limbs, rotations[rows], translation[rows], needed[rows], around, say)
        found += [
            (slice(rows[0] + first, rows[0] + end), (first == 0, end == len(rows)))
            for first, end in stretches(hit[rows], around)
            if needed[rows][first:end].any()
        ]
    out = Apart(rotations.copy(), np.zeros(len(rotations)), before, before.copy())
    done, total = 0, sum(rows.stop - rows.start for rows, _ in found)
    for rows, free in found:
        length = rows.stop - rows.start
        say = lambda share: progress("limbs apart", done + round(share * length), total)
        _solve(limbs, out, translation, rows, rate, free, say)
        done += length
        say(0)
    return out


def _collided(limbs, rotations, translation, needed, around, say):
    """Pairs (T,) of neighbouring rows and whether limbs collide there (T,), in the skin or in what they wear, looked at as far as a
    stretch that holds a needed row may reach; beyond nothing."""
    pairs, hit, known = np.zeros(len(needed), int), np.zeros(len(needed), bool), np.zeros(len(needed), bool)
    asked = _near(needed, 2 * around + 1)
    while (asked & ~known).any():
        for row in np.flatnonzero(asked & ~known):
            (pose,) = poses(limbs, rotations[[row]], translation[[row]])
            pairs[row] = limbs.pairs(*pose)
            hit[row] = pairs[row] > 0 or limbs.crowded(*pose)
            known[row] = True
            say(int(known.sum()), int(asked.sum()))
        for first, end in stretches(hit, around):
            if needed[first:end].any():
                asked[max(first - around - 1, 0) : end + around + 1] = True
    return pairs, hit


def collisions(limbs, rotations, translation):
    """Pairs (T,) by `Limbs.pairs`."""
    return np.array([limbs.pairs(*pose) for pose in poses(limbs, rotations, translation)], int)


def poses(limbs, rotations, translation):
    """The transforms of each row, see `Limbs.transforms`."""
    for i in range(0, len(rotations), CHUNK):
        yield from zip(*limbs.transforms(rotations[i : i + CHUNK], translation[i : i + CHUNK]))


def stretches(hit, around):
    """[(first, end)] of the rows that lie within `around` rows of one that is hit (T,) bool."""
    edges = np.flatnonzero(np.diff(np.r_[False, _near(hit, around), False]))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist()))


def _near(hit, around):
    """Rows (T,) bool within `around` rows of one that is hit."""
    return np.convolve(hit, np.ones(2 * around + 1), mode="full")[around : around + len(hit)] > 0.5


def _solve(limbs, out, translation, rows, rate, free, say):
    """Writes these rows of `out`."""
    given = out.rotations[rows].copy()
    c = corrections(limbs, given, translation[rows], rate, free, say)
    out.rotations[rows] = turned(limbs, given, c)
    out.angles[rows] = np.linalg.norm(c.reshape(len(c), -1, 3), axis=2).max(1)
    out.pairs_left[rows] = collisions(limbs, out.rotations[rows], translation[rows])


def corrections(limbs, rotations, translation, rate, free, say=lambda share: None):
    """Turns c (T,D) [rad] that minimise  sum w (margin - distance)+^2 + `smoothness`, by Gauss-Newton over all rows at once. `free`: may
    change at its (first, last) row, else comes from and goes to nothing. `say` hears the share of the rounds that is done."""
    T, D = len(rotations), len(limbs.stiff)
    c, at = np.zeros((T, D)), np.full((T, D), np.inf)
    H, g = np.zeros((T, D, D)), np.zeros((T, D))
    still, factor = smoothness(T, limbs.stiff * LENGTH, LAG * rate, free), kernels.CholeskyFactor()
    for turn in range(ROUNDS):
        say(turn / ROUNDS)
        stale = np.flatnonzero(np.abs(c - at).max(1) > STALE)
        if not len(stale):
            break
        now = turned(limbs, rotations[stale], c[stale])
        for t, pose in zip(stale, poses(limbs, now, translation[stale])):
            found = limbs.contacts(*pose, MARGIN)
            weighed = found.weight[:, None] * found.rows
            H[t] = found.rows.T @ weighed
            g[t] = weighed.T @ (np.minimum(MARGIN - found.distance, PUSH) + found.rows @ c[t])
        at[stale] = c[stale]
        wanted = factor.factorize(still + block_diag(list(H), format="csc")).solve(g.reshape(-1, 1)).reshape(T, D)
        step = wanted - c
        c = c + step * np.minimum(1, STEP / np.maximum(np.abs(step).max(1, keepdims=True), 1e-12))
    return c


def smoothness(T, cost, lag, free):
    """Sparse (T D, T D) of  sum_t |cost c_t|^2 + lag^4 |cost (c_t-1 - 2 c_t + c_t+1)|^2,  cost (D,) [m/rad], lag in rows, with c zero
    beyond the ends that are not `free`."""
    bend = diags([1.0, -2.0, 1.0], [-2, -1, 0], shape=(T + 2, T)).tocsr()
    bend = bend[2 * free[0] : T + 2 - 2 * free[1]]
    return kron(eye(T) + lag**4 * (bend.T @ bend), diags(cost**2)).tocsc()


def turned(limbs, rotations, c):
    """Rotations (T,K,3) with turns c (T,D) about the axes of the joints' parents added."""
    from scipy.spatial.transform import Rotation

    out, c = rotations.copy(), c.reshape(len(c), -1, 3)
    for k, turn in zip(limbs.turned, np.moveaxis(c, 1, 0)):
        rows = turn.any(1)
        more = Rotation.from_rotvec(turn[rows]) * Rotation.from_rotvec(rotations[rows, k])
        out[rows, k] = more.as_rotvec()
    return out
