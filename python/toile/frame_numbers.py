"""Frame numbers: few in place of many, in words, and the time from one to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Item = TypeVar("Item")


def evenly(items: Sequence[Item], count: int) -> list[Item]:
    """At most `count` of the items, evenly spaced, the first and the last among them (for one, the first)."""
    return [items[i] for i in np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int))]


def frame_ranges(numbers: Sequence[int], most: int | None = None, between: str = ", ") -> str:
    """Ascending numbers in words, [1, 2, 3, 7] -> "1-3, 7"; of many runs the first `most`."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    shown = [f"{a}" if a == b else f"{a}-{b}" for a, b in runs]
    return between.join(shown[:most]) + (f"{between}..." if most is not None and len(shown) > most else "")


def stride_of(frames: npt.ArrayLike) -> int:
    """The commonest step from one frame number to the next; 0 for a single frame."""
    steps, counts = np.unique(np.diff(frames), return_counts=True)
    return int(steps[counts.argmax()]) if len(steps) else 0


def rate_of(frames: npt.ArrayLike, fps: float) -> float:
    """Pictures a second of a film of these frames, whose numbers count at `fps`: a step of 5 leaves a fifth. A gap is no pause."""
    return fps / (stride_of(frames) or 1)
