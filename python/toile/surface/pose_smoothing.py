"""Poses of consecutive frames, smoothed over time.

A pose is smoothed by small turns and moves d that minimise

    sum_t w_t |d_t|^2 + strength sum_t |D3 (y + d)_t|^2,     D3 x_t = x_{t+3} - 3 x_{t+2} + 3 x_{t+1} - x_t,

a Whittaker smoother (Eilers, A perfect smoother, 2003) of third differences: bodies are moved by forces, which do not jump (Flash
and Hogan, The coordination of arm movements, 1985), and a limb that swings keeps its reach better than with second differences. All joints and the root
have one strength, because errors of neighbouring joints cancel, and go on doing so under one filter."""

from __future__ import annotations

import numpy as np

from ..kernels.arrays import Floats

STRENGTHS = 10.0 ** np.arange(-5, 4.1, 0.5)  # among which a sequence chooses
NOISE = 0.05  # [m] that a registered joint may be off; what foretells no better tells no noise
WORSE = 1.1  # times the least error so far: stronger ones are not looked at any more
GAP, EVERY = 3, 4  # frames that are left out together, of how many such stretches
THIRD = np.array([-1.0, 3.0, -3.0, 1.0])


def foretelling_strength(missed: Floats, left_out: float) -> float:
    """Of STRENGTHS the one that leaves the least error, see `foretelling_errors`, before it rises again; 0 where the weakest does, where
    NOISE is exceeded, or nothing was left out. Frames too far apart to foretell one another would be best told by their mean."""
    best = 0
    for i, error in enumerate(missed):
        if error > WORSE * missed[best]:
            break
        best = i if error < missed[best] else best
    told = best > 0 and missed[best] <= NOISE**2 * left_out
    return float(STRENGTHS[best]) if told else 0.0


def turn_differences(turns: Floats) -> Floats:
    """Second differences (T-2,K,3) of rotation vectors (T,K,3): those of the turns from frame to frame."""
    from scipy.spatial.transform import Rotation

    at, later = (Rotation.from_rotvec(x.reshape(-1, 3)) for x in (turns[:-1], turns[1:]))
    return np.diff((at.inv() * later).as_rotvec().reshape(-1, *turns.shape[1:]), axis=0)


def smooth_poses(turns: Floats, moves: Floats, weight: Floats, strength: float) -> tuple[Floats, Floats]:
    """Rotation vectors (T,K,3) and translations (T,3) smoothed; `weight` (T,) of the frames."""
    from scipy.spatial.transform import Rotation

    if len(turns) < len(THIRD) or not strength:
        return turns, moves
    jerks = np.diff(turn_differences(turns).reshape(len(turns) - 2, -1), axis=0)
    d = _evened(weight, strength, jerks).reshape(-1, 3)
    turned = Rotation.from_rotvec(turns.reshape(-1, 3)) * Rotation.from_rotvec(d)
    return turned.as_rotvec().reshape(turns.shape), moves + _evened(weight, strength, np.diff(moves, 3, axis=0))


def foretelling_errors(places: Floats, weight: Floats) -> tuple[Floats, float]:
    """(STRENGTHS,) sums of weighted squares [m^2] of how far places (T,K,3) that are left out lie from where the others, smoothed by
    each strength, put them, and the sum of their weights; `weight` (T,). Stretches of GAP frames are left out, since errors of
    neighbouring frames are alike; zeros where none lies between others."""
    T, K = places.shape[:2]
    at, missed = np.arange(T), np.zeros(len(STRENGTHS))
    if T < 3 * GAP:
        return missed, 0.0
    third, between = np.diff(places.reshape(T, -1), 3, axis=0), (at >= GAP) & (at < T - GAP)
    for fold in range(EVERY):
        left_out = between & (at // GAP % EVERY == fold)
        kept = np.where(left_out, 0.0, weight)
        for i, strength in enumerate(STRENGTHS):
            off = (_evened(kept, strength, third)[left_out] ** 2).sum(1)
            missed[i] += (weight[left_out] * off).sum()
    return missed, float(K * weight[between].sum())


def _evened(weight, strength, third):
    """d (T,c), the argmin of this module's head, from weights (T,) and third differences (T-3,c)."""
    from scipy.linalg import solveh_banded

    T, order = len(weight), len(THIRD)
    bands, pull = np.zeros((order, T)), np.zeros((T, third.shape[1]))
    bands[0] = weight
    for j, a in enumerate(THIRD):  # of D3'D3, and D3' of the differences
        pull[j : j + T - 3] += a * third
        for k, b in enumerate(THIRD[j:]):
            bands[k, j : j + T - 3] += strength * a * b
    return solveh_banded(bands, -strength * pull, lower=True, check_finite=False)
