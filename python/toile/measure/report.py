"""`toile report RUN`: one self-contained page for triage, and its table as CSV and JSON beside it."""

from __future__ import annotations

import csv
import html
import io
import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..io.files import output_file, write_text
from ..io.run import open_run
from .page import HEAT, STYLE, cards, flatten
from .triage import facts
from .triage.columns import columns_of
from .triage.measured import STATES, measured
from .triage.pictures import HEAT_MM, OUTLINES, as_text, pictures

WORST = 20  # frames shown with pictures
PAGE = Path(__file__).parent / "triage" / "page"
MAKE = """const $ = id => document.getElementById(id);
const make = (tag, fields = {}, ...inside) => { const e = Object.assign(document.createElement(tag), fields); e.append(...inside); return e; };
const data = JSON.parse($('data').textContent);
"""


def write_report(run: Path | str, out: Path | str | None = None, more: str = "", progress=None) -> Path:
    """Writes the page of a run (default RUN/report.html), its table beside it as .csv and .json, and returns the page's path.

    `more`: HTML that stands after the frames, such as the section of an avatar made from the run. `progress(stage, done,
    total)`. UserError where there is no run, or the page's name is the table's.
    """
    opened = open_run(run)
    path = output_file(out or opened.path / "report.html")
    beside = {suffix: path.with_suffix(suffix) for suffix in (".csv", ".json")}
    if path in beside.values():
        raise UserError(f"{path}: the page's table is written there: name the page .html")
    opened.capture  # noqa: B018  refused where it is gone, before an hour of measuring
    rows, result = measured(opened, progress)
    columns = facts.values_of(rows, opened.config.get("settings", {}))
    reasons = facts.reasons_of(rows, columns)
    order = facts.ranking(rows, columns, reasons)
    worst = facts.shown(order, rows, reasons, WORST)
    made, lost = [], []
    for k, i in enumerate(worst):
        made.append((i, pictures(opened, rows[i].frame, lost.append)))
        if progress is not None:
            progress("pictures", k + 1, len(worst))
    table = facts.as_table(rows, columns, reasons)
    write_text(beside[".json"], json.dumps(table | {"all": result.get("all", {})}, allow_nan=False))
    write_text(beside[".csv"], as_csv(rows, columns, reasons))
    write_text(path, page(opened, rows, columns, reasons, order, made, result, more, tuple(dict.fromkeys(lost))))
    return path


def as_csv(rows, columns, reasons) -> str:
    """A line a frame; the head's words are the page's."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    units = [f" [{c.column.unit}]" if c.column.unit else "" for c in columns]
    titles = [f"{c.column.group}: {c.column.words}{unit}" for c, unit in zip(columns, units)]
    writer.writerow(["frame", "verdict", "reasons", *titles])
    for i, row in enumerate(rows):
        values = [facts.json_number(c.values[i]) for c in columns]
        texts = [_inert(text) for text in (STATES[row.state], "; ".join(reasons[i]))]
        writer.writerow([row.frame, *texts, *("" if value is None else f"{value:g}" for value in values)])
    return out.getvalue()


def _inert(text):
    """A text that a spreadsheet does not take for a formula."""
    return f"'{text}" if text[:1] in "=+-@\t\r" and text else text


def page(run, rows, columns, reasons, order, made, result, more, lost=()) -> str:
    """The HTML; all that comes from files is escaped, or data that the script puts into text alone."""
    shown, blocks = [], []
    for i, found in made:
        names = [(caption, f"p{rows[i].frame}-{k}") for k, (caption, _) in enumerate(found)]
        shown.append({"row": i, "shown": names})
        blocks += [
            f"<script type='text/plain' id='{id}'>{as_text(data)}</script>" for (_, id), (_, data) in zip(names, found)
        ]
    data = {
        "path": shlex.quote(str(run.path.absolute())), "states": STATES, "frames": [row.frame for row in rows], "state": [row.state for row in rows],
        "reasons": reasons, "order": order, "columns": [_column(c) for c in columns],
        "troubles": facts.troubles(rows, reasons), "pictures": shown,
        "command": facts.command(run, [row.frame for row in rows]),
    }  # fmt: skip
    layers = ", ".join(["body", *run.garments])
    found = {
        "title": html.escape(_title(run, rows)),
        "about": html.escape(f"{run.path}. Layers: {layers}. A row a frame, worst first; colours mark only what is truly out."),
        "style": STYLE + (PAGE / "triage.css").read_text(encoding="utf-8"),
        "warnings": _warnings([*run.status.warnings(), *result.get("warnings", []), *lost]),
        "legend": _legend(run),
        "more": _means(result) + more + _settings(run),
        "data": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
        "script": MAKE + "".join((PAGE / name).read_text(encoding="utf-8") for name in ("table.js", "triage.js")),
        "pictures": "\n".join(blocks),
    }  # fmt: skip
    return re.sub(r"@(\w+)@", lambda m: found[m[1]], (PAGE / "triage.html").read_text(encoding="utf-8"))


def _title(run, rows) -> str:
    counts = [sum(row.state == state for row in rows) for state in range(len(STATES))]
    told = [f"{count:,} {name}" for count, name in zip(counts[::-1], STATES[::-1]) if count and name != "good"]
    good = f"{counts[0]:,} of {len(rows):,} frames good"
    return f"{run.scene.name}: {', '.join([good, *told])}"


def _column(c: facts.Values) -> dict[str, Any]:
    return {
        "words": c.column.words, "unit": c.column.unit, "group": c.column.group, "meaning": c.column.meaning, "bad": c.column.bad,
        "own": c.column.bounds is not None, "middle": c.middle, "edge": c.edge, "limits": c.limits, "values": [facts.json_number(v) for v in c.values],
        "level": "".join(map(str, np.asarray(c.level).tolist())),
    }  # fmt: skip


def _warnings(told) -> str:
    if not told:
        return ""
    items = "".join(f"<li>{html.escape(warning)}</li>" for warning in told)
    many = f"{len(told)} warnings of the whole run" if len(told) > 1 else "A warning of the whole run"
    return f"<details class='warnings'{' open' if len(told) <= 4 else ''}><summary>{many}</summary><ul>{items}</ul></details>"


def _legend(run) -> str:
    """The colours of the pictures."""
    stops = ", ".join(f"rgb{colour}" for colour in HEAT)
    lines = "".join(
        f"<span class='swatch' style='background: rgb{OUTLINES[k % len(OUTLINES)]}'></span>{html.escape(name)}"
        for k, name in enumerate(["body", *run.garments])
    )
    return (
        f"<p class='soft'>Scans are coloured by their distance to what was registered: 0<span class='scale' style='background: "
        f"linear-gradient(to right, {stops})'></span>{HEAT_MM:g} mm and more. Outlines over captured pictures:{lines}.</p>"
    )


def _means(result) -> str:
    """The means of `evaluate` in words, where there is a truth."""
    if "all" not in result:
        return ""
    found = {f"truth:{name}": value for name, value in flatten(result["all"]).items() if value is not None}
    shown = {f"{c.words}{f' [{c.unit}]' if c.unit else ''}": c.factor * found[c.key] for c in columns_of(found)}
    return f"<h2>Against the truth, mean of all frames</h2>{cards(shown)}"


def _settings(run) -> str:
    settings = html.escape(json.dumps(run.config, indent=1))
    return f"<h2>Settings and versions</h2><details><summary>as the run was asked for</summary><pre>{settings}</pre></details>"
