"""Which values are truly out: beyond a limit of the verdict, or far from the run's middle by more than means nothing."""

from __future__ import annotations

import numpy as np

from .columns import HIGH, LOW

SPREADS = 6.0  # robust standard deviations from the middle
LEAST_FRAMES = 8  # fewer values have no middle
FINE, OUT, GRAVE = 0, 1, 2


def middle_and_edge(values, column) -> tuple[float | None, float | None]:
    """The median of values (T,) in the column's unit, NaN where unknown, and where "out" begins on its bad side: SPREADS
    robust standard deviations of that side away (1.4826 times the median distance to the median; Hampel 1974), and at
    least the column's floor. None where there are too few, or where no value can be out: none is below 0."""
    known = values[np.isfinite(values)]
    if not len(known):
        return None, None
    middle = float(np.median(known))
    if len(known) < LEAST_FRAMES or column.bad not in (HIGH, LOW):
        return middle, None
    side = 1.0 if column.bad == HIGH else -1.0
    away = side * (known - middle)
    beyond = away[away > 0]
    spread = 1.4826 * float(np.median(beyond)) if len(beyond) > len(known) // 4 else 0.0
    edge = middle + side * max(SPREADS * spread, column.floor)
    return middle, edge if edge > 0 else None


def levels(values, states, column, edge, limits):
    """FINE, OUT or GRAVE of each value (T,), and how far it is on the way from the median to where "out" begins (T,): 1
    there, 0 on the good side.

    `limits`: (doubtful from, wrong from) in the column's unit, or None. Beyond those of the verdict no value is said to be
    worse than its frame is judged (`states` (T,)): pictures may have excused it.
    """
    side = -1.0 if column.bad == LOW else 1.0
    level, times = np.zeros(len(values), np.int8), np.zeros(len(values))
    known = np.where(np.isfinite(values), side * values, -np.inf)
    if edge is not None:
        middle = np.nanmedian(values)
        level[known > side * edge] = OUT
        times = np.maximum((known - side * middle) / max(abs(edge - middle), 1e-12), 0.0)
    if limits is not None:
        for rank, limit in zip((OUT, GRAVE), limits):
            beyond = (known > side * limit) & ((states >= rank) | (column.bounds is not None))
            level = np.where(beyond, np.maximum(level, rank), level)
    return level, times
