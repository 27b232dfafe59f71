"""Cameras out of step by parts of a frame, told by how far detections lie along their motion from where the others say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...kernels.arrays import Array, Floats
from .rays import SURE, Sighting, meet

CAMERAS = 4  # of fewer, a step of one looks like steps of the others
BLOCKS = 8  # of time, each of which is asked by itself
LONGEST = 4  # frames of a block, at least
LEAST = 0.15  # frames: smaller steps are not named
CHANCE = 1e-3  # that a camera in step is named
ROUNDS = 5  # of reweighting


def fractions(sighting: Sighting) -> dict[int, float]:
    """{camera: frames, 0.15 to 1, by which its pictures are behind the others' (ahead: negative)}, of cameras in step to the
    frame; the largest first, each time with those before put in step. Empty where the motion does not suffice to tell."""
    found: dict[int, float] = {}
    if len(sighting.cameras) < CAMERAS or sighting.uv.shape[1] < 2 * LONGEST + 2:
        return found
    for _ in range(len(sighting.cameras) // 2):
        told = {i: _fraction(sighting, i) for i in range(len(sighting.cameras)) if i not in found}
        sure = {i: step for i, (step, unsure) in told.items() if max(LEAST, unsure) < abs(step) <= 1}
        if not sure:
            break
        i = max(sure, key=lambda k: abs(sure[k]))
        found[i] = sure[i]
        sighting = _moved_by(sighting, i, sure[i])
    return found


def _fraction(sighting: Sighting, i: int) -> tuple[float, float]:
    """(frames by which camera i is behind, by how much a camera in step is not): what is left of its detections, r = -s v of what
    the others say they move a frame, v, regressed point by point about their means, so that no constant offset counts. The second
    is Student's, of the mean over blocks of time, as few of them tell little of their own spread; infinite where nothing is known."""
    from scipy.stats import t as student

    others = sighting.only([k for k in range(len(sighting.cameras)) if k != i])
    points = meet(others).points
    at, depth = sighting.cameras[i].project(np.nan_to_num(points))
    at[~(np.isfinite(points).all(-1) & (depth > 0))] = np.nan
    off, v = (sighting.uv[i] - at)[1:-1], (at[2:] - at[:-2]) / 2
    known = np.isfinite(off).all(-1) & np.isfinite(v).all(-1) & (sighting.weight[i, 1:-1] > SURE)
    count = min(BLOCKS, len(known) // LONGEST)
    blocks = [_regressed(o, m, k) for o, m, k in zip(*(np.array_split(x, count) for x in (off, v, known)))]
    steps, weights = np.array(blocks).T
    if (weights > 0).sum() < 2:
        return 0.0, np.inf
    times = float(student.isf(CHANCE / 2, (weights > 0).sum() - 1))
    mean = float(np.average(steps, weights=weights))
    share = weights / weights.sum()
    spread = float(np.sum(share**2 * (steps - mean) ** 2)) ** 0.5
    return mean, times * spread * float(np.sqrt(1 / max(1 - np.sum(share**2), 1e-9)))


def _regressed(off: Floats, v: Floats, known: Array) -> tuple[float, float]:
    """(s, weight) of off = -s v, both (t,K,2), over what is known (t,K), reweighted by what is left (Cauchy)."""
    weight, step, strength = known.astype(float), 0.0, 0.0
    off, v = (np.where(known[..., None], x, 0.0) for x in (off, v))
    for _ in range(ROUNDS):
        total = np.maximum(weight.sum(0), 1e-12)[:, None]
        r, m = (x - (weight[..., None] * x).sum(0) / total for x in (off, v))
        strength = float((weight[..., None] * m * m).sum())
        step = -float((weight[..., None] * r * m).sum()) / max(strength, 1e-12)
        left = np.linalg.norm(r + step * m, axis=-1)
        if not known.any():
            return 0.0, 0.0
        scale = 1.5 * float(np.median(left[known])) + 1e-9
        weight = known / (1 + (left / scale) ** 2)
    return step, strength / scale**2


def _moved_by(sighting: Sighting, i: int, step: float) -> Sighting:
    """With a camera's detections at `step` frames later, between two frames; without weight where one of these lacks it."""
    T = sighting.uv.shape[1]
    before = np.floor(np.arange(T) + step).astype(int)
    share = np.arange(T) + step - before
    a, b = (np.clip(before + k, 0, T - 1) for k in (0, 1))
    uv, weight = sighting.uv.copy(), sighting.weight.copy()
    uv[i] = (1 - share)[:, None, None] * sighting.uv[i, a] + share[:, None, None] * sighting.uv[i, b]
    inside = ((before >= 0) & (before + 1 < T))[:, None]
    weight[i] = np.where(inside, np.minimum(sighting.weight[i, a], sighting.weight[i, b]), 0.0)
    return replace(sighting, uv=uv, weight=weight)
