"""How sure a difference of errors is: the circular block bootstrap over frames (Politis and Romano 1992), since neighbouring
frames err alike. A block is as long as the square root of the number of frames. Of few frames, or of runs of like errors as
long as a block, intervals are somewhat too narrow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

DRAWS = 2000
LEVEL = 0.95


def resampled(count: int, generator: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    """(draws, count) places of frames in their order, drawn in blocks of neighbours that go on at the beginning."""
    length = max(round(count**0.5), 1)
    starts = generator.integers(count, size=(draws, -(-count // length)))
    return ((starts[..., None] + np.arange(length)) % count).reshape(draws, -1)[:, :count]


def mean_change(subjects: Sequence[Sequence[tuple[np.ndarray, np.ndarray]]], seed: int = 0) -> dict[str, float] | None:
    """{change, low, high}: the mean over subjects and their seeds of sum(a) / sum(b) - 1, and its 95 % interval. A seed is
    (a (F,), b (F,)), squared errors summed over the pixels of each frame; the seeds of a subject have the same frames, which
    are drawn alike. None where a sum is 0."""
    if not subjects or any(b.sum() == 0 for seeds in subjects for _, b in seeds):
        return None
    generator, found, whole = np.random.default_rng(seed), [], []
    for seeds in subjects:
        rows = resampled(len(seeds[0][0]), generator)
        for a, b in seeds:
            below = b[rows].sum(1)
            found.append(np.divide(a[rows].sum(1), below, out=np.full(len(rows), np.nan), where=below > 0) - 1)
            whole.append(a.sum() / b.sum() - 1)
    low, high = np.nanquantile(np.mean(found, axis=0), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return {"change": float(np.mean(whole)), "low": float(low), "high": float(high)}
