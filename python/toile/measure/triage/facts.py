"""What the page, the CSV and the JSON say: the columns over all frames, what is out, which frames are worst and why."""

from __future__ import annotations

import shlex
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...frame_numbers import frame_ranges
from ...io.layout import DOUBTFUL, WRONG
from ...io.run_folder import capture_folder, config_file
from .advice import CONTACT, FAILURE, OUT, advice_of, of_garment, title_of, trouble_of
from .columns import Column, columns_of
from .measured import FAILED_STATE, PENDING_STATE, STATES, Row
from .outliers import levels, middle_and_edge

APART = 5  # frames between two that are shown for the same trouble, as long as there are others
DIGITS = 5


@dataclass(frozen=True)
class Values:
    """A column over the run: values (T,) in its unit, NaN where unknown; the median; where "out" begins and the verdict's
    limits, None without; the level (T,) of each value and how far it is on the way to "out" (T,), 1 there."""

    column: Column
    values: np.ndarray
    middle: float | None
    edge: float | None
    limits: tuple[float, float] | None
    level: np.ndarray
    times: np.ndarray


def values_of(rows: list[Row], settings: dict[str, Any]) -> list[Values]:
    """The columns of a run whose config has these `settings`; of those without a value, none."""
    states = np.array([row.state for row in rows])
    found = []
    for column in columns_of(key for row in rows for key in row.values):
        values = column.factor * np.array([row.values.get(column.key, np.nan) for row in rows])
        middle, edge = middle_and_edge(values, column)
        if middle is None:
            continue
        limits = _limits(settings, column)
        found.append(Values(column, values, middle, edge, limits, *levels(values, states, column, edge, limits)))
    return found


def _limits(settings, column):
    """The limits of a column, in its unit: its own or the verdict's."""
    if column.bounds is not None:
        return column.bounds
    pair = settings.get("verdict", {}).get(column.limit)
    sound = isinstance(pair, list) and len(pair) == 2 and all(isinstance(v, (int, float)) for v in pair)
    return tuple(column.factor * v for v in pair) if sound else None


def reasons_of(rows: list[Row], columns: list[Values]) -> list[list[str]]:
    """Why each frame is not simply good, the gravest first: the verdict's reasons, contact, and what is unlike the run."""
    found = []
    for i, row in enumerate(rows):
        said = list(row.reasons)
        if row.state < FAILED_STATE:
            touched = [key for key, value in row.values.items() if key.endswith(":unsupported_contact") and value]
            said += [f"{key.split(':')[0].removeprefix('dress ')}: hands touch the cloth" for key in touched]
            said += _beyond(i, columns) + _unlike(i, columns)
        found.append(said)
    return found


def _beyond(i, columns):
    """What lies beyond limits that no verdict asks for."""
    out = [c for c in columns if c.column.bounds is not None and c.level[i] and c.values[i] > c.limits[0]]
    return [
        f"{c.column.words}: {told(c.values[i], c.column.unit)} (at most {told(c.limits[0], c.column.unit)} is good)"
        for c in out
    ]


def _unlike(i, columns):
    """What is farthest from the run's median."""
    out = [c for c in columns if c.column.bounds is None and c.level[i] and c.times[i] > 1 and counted(c)]
    out = sorted(out, key=lambda c: -c.times[i])[:3]
    return [
        f"{c.column.words}: {told(c.values[i], c.column.unit)}, the run's median is {told(c.middle, c.column.unit)}"
        for c in out
    ]


def counted(values: Values) -> bool:
    """Does a value that is out say something of the frame? Slow frames may be good ones."""
    return values.column.group != "Seconds"


def told(value, unit):
    """A number and its unit."""
    number = f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{number} {unit}" if unit else number


def troubles(rows: list[Row], reasons: list[list[str]]) -> list[dict[str, Any]]:
    """Kinds of trouble, the gravest and most frequent first: {"title", "do", "state" (the gravest), "counts" [(state,
    frames)], "rows"}; a frame is in one kind, that of its first reason."""
    kinds: dict[str, dict[str, Any]] = {}
    for i, (row, said) in enumerate(zip(rows, reasons)):
        if row.state != PENDING_STATE and said:
            title, do = _kind(row, said)
            kinds.setdefault(title, {"title": title, "do": do, "rows": []})["rows"].append(i)
    for kind in kinds.values():
        counts = Counter(rows[i].state for i in kind["rows"])
        kind |= {"state": max(counts), "counts": sorted(counts.items(), reverse=True)}
    return sorted(kinds.values(), key=lambda kind: (-kind["state"], -len(kind["rows"])))


def _kind(row, said):
    if row.state == FAILED_STATE:
        return title_of(said[0]), FAILURE
    if row.state in (DOUBTFUL, WRONG):
        owner = of_garment(said[0])
        return (f"{owner}: " if owner else "") + title_of(said[0]), advice_of(said)
    kind = CONTACT if "hands touch" in said[0] else trouble_of(said[0]) or OUT
    return kind.title, kind.do


def ranking(rows: list[Row], columns: list[Values], reasons: list[list[str]]) -> list[int]:
    """Indices of the frames, worst first: by state, then contact, then by how far and how much of it is out."""
    score = np.array([float(row.state) if row.state != PENDING_STATE else -1.0 for row in rows]) * 1e6
    for i, (row, said) in enumerate(zip(rows, reasons)):
        score[i] += 1e3 * len(row.reasons) + (1e5 if any("hands touch" in reason for reason in said) else 0.0)
    for c in columns:
        if counted(c):
            score += np.minimum(c.times, 100.0) ** 2  # one that is far out outweighs many that are not
    return np.lexsort((np.arange(len(rows)), -score)).tolist()


def shown(order: list[int], rows: list[Row], reasons: list[list[str]], count: int) -> list[int]:
    """The worst `count` frames; near ones of the same trouble, and those that are simply good, only where no others are
    left."""
    bad, chosen = [i for i in order if reasons[i]], []
    for i in bad:
        alike = (k for k in chosen if _kind_of(rows, reasons, k) == _kind_of(rows, reasons, i))
        if len(chosen) < count and all(abs(rows[k].frame - rows[i].frame) > APART for k in alike):
            chosen.append(i)
    left = [i for i in (*bad, *order) if i not in set(chosen) and rows[i].state != PENDING_STATE]
    chosen += list(dict.fromkeys(left))[: count - len(chosen)]
    return sorted(chosen, key=order.index)


def _kind_of(rows, reasons, i):
    return _kind(rows[i], reasons[i])[0] if reasons[i] else None


def command(run, frames) -> str:
    """The command that gives frames of a run again from any folder, up to the option that names them; "" where there is none."""
    if "align" in run.config or "capture" not in run.config:
        return ""
    path = Path(run.path).absolute()
    try:
        capture = str(capture_folder(run.path).absolute())
    except UserError:
        capture = str(run.config["capture"])  # as it was named
    again = ["toile", "register", capture, str(path), "--config", str(config_file(path))]
    return shlex.join([*again, "--frames", frame_ranges(frames, between=",")])


def json_number(value):
    """A number of DIGITS digits, None for NaN."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def as_table(rows, columns, reasons):
    """The JSON beside the page: {"columns": [...], "frames": [{"frame", "verdict", "reasons", "values" {words: number}}]}."""
    told = [{"key": c.column.key, "words": c.column.words, "unit": c.column.unit, "meaning": c.column.meaning, "group": c.column.group,
             "bad": c.column.bad, "median": c.middle, "out_from": c.edge, "limits": c.limits} for c in columns]  # fmt: skip
    frames = []
    for i, row in enumerate(rows):
        values = {c.column.key: json_number(c.values[i]) for c in columns}
        frames.append({"frame": row.frame, "verdict": STATES[row.state], "reasons": reasons[i], "values": values})
    return {"columns": told, "frames": frames}
