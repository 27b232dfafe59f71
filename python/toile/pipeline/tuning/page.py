"""The page of a trial: what each quality shows and takes, and the same frames side by side."""

from __future__ import annotations

import html
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...console import duration
from ...io.files import write_text
from ...measure.page import document, figure, jpeg_figure, table
from ...measure.rendering import BODY, CLOTH, render
from ...measure.triage.pictures import pictures
from .trial import FIRST, TOGETHER, first_at_each_place
from .tune import Tried, Tuned

WORDS = (  # of what `evaluate` measures: (words, the way to it)
    ("scan to body, mean [mm]", ("evidence", "scan_to_surface_mm", "mean")),
    ("body to scan, mean [mm]", ("evidence", "surface_to_scan_mm", "mean")),
    ("keypoints, median [px]", ("evidence", "keypoint_px", "median")),
    ("silhouette and masks, overlap", ("evidence", "silhouette_iou")),
    ("true joints [mm]", ("joint_mm",)),
    ("true body under garments [mm]", ("inner", "hidden_mm")),
)
OF_GARMENT = (
    ("found on the scan, share", "observed"),
    ("true surface [mm]", "surface_mm"),
    ("true openings [mm]", "boundary_all_mm"),
)


def write_page(tuned: Tuned, path: Path) -> Path:
    """Writes the page of a trial."""
    fits = "".join(_fit(tuned, name) for name in tuned.said)
    told = "".join(f"<p class='why'>{html.escape(text)}</p>" for text in tuned.warnings)
    shown = first_at_each_place(tuned.frames)
    body = (
        f"<p class='soft'>{len(tuned.frames)} frames from {len(shown)} places, up to {FIRST} at the first and {TOGETHER} at each other."
        f"</p>{fits}{told}"
        f"<h2>The whole job</h2>{table(('quality', 'processes', 'frames', 'time', 'disk', 'memory'), list(jobs(tuned)))}"
        f"<h2>What it shows</h2>{table(('', *tuned.qualities), list(errors(tuned)))}"
        f"<p class='soft'>Held-out cameras: {html.escape(', '.join(tuned.cameras) or 'none')}. Their pictures, labels and "
        "masks were not shown to a second trial, whose layers are compared with them: what is wrong in a label image lowers the "
        "overlap too.</p>"
        f"<h2>Side by side</h2>{''.join(_frame(tuned, number) for number in shown)}"
    )
    write_text(path, document(f"{tuned.capture.scene.name}: trial before the job", body))
    return path


def jobs(tuned: Tuned) -> Iterator[tuple[str, ...]]:
    """Rows of the table of forecasts."""
    for quality, tried in tuned.qualities.items():
        for i, job in enumerate(tried.forecasts):
            where = "1, this machine's cores" if i == 0 else f"{job.workers}, one core each"
            disk = f"{size(job.disk)} and {size(job.passing)} of RUN/work"
            yield quality, where, str(job.frames), duration(job.seconds), disk, size(job.memory)


def errors(tuned: Tuned) -> Iterator[tuple[Any, ...]]:
    """Rows of the table of errors: words, and a value a quality."""
    tried = list(tuned.qualities.values())
    rows = [(words, [_at(one.errors, way) for one in tried]) for words, way in WORDS]
    for name in tuned.said:
        found = [one.errors.get("garment", {}).get(name, {}) for one in tried]
        rows += [(f"{name}: {words}", [of.get(key) for of in found]) for words, key in OF_GARMENT]
        rows.append((f"{name}: openings to those seen [mm]", [_openings(one, name) for one in tried]))
    for name in dict.fromkeys(n for one in tried for n in one.heldout):
        rows.append((f"{name}: overlap in held-out cameras", [one.heldout.get(name) for one in tried]))
    verdicts = [one.errors["verdicts"] or {} for one in tried]
    for name in dict.fromkeys(n for of in verdicts for n in of):
        rows.append((f"frames judged {name}", [of.get(name) for of in verdicts]))
    for words, values in rows:
        if any(value is not None for value in values):
            yield words, *values


def size(count: float) -> str:
    """Bytes as "3.2 GB"."""
    for unit, factor in (("TB", 1e12), ("GB", 1e9)):
        if count >= factor:
            return f"{count / factor:.2g} {unit}"
    return f"{count / 1e6:.0f} MB"


def _at(values, way):
    for key in way:
        values = (values or {}).get(key)
    return values


def _openings(tried: Tried, name):
    off = [fit.off_mm for fit in tried.loops.get(name, ()) if fit.off_mm is not None]
    return float(np.mean(off)) if off else None


def _fit(tuned, name):
    """A garment's loops against its template's, with the template laid beside what was registered."""
    finest = list(tuned.qualities.values())[-1]
    rows = [(fit.name, fit.ratio, fit.seen, fit.off_mm) for fit in finest.loops[name]]
    said = "".join(f"<p class='why'>{html.escape(text)}</p>" for text in tuned.said[name])
    head = ("loop", "length over the template's", "share seen", "to the opening seen [mm]")
    garment, mesh, up = finest.run.garments[name], tuned.capture.templates.get(name), tuned.capture.scene.up
    first = finest.run.ok[0]
    worn = [(finest.run.body.at(first), finest.run.body.faces, BODY), (garment.at(first), garment.faces, CLOTH[0])]
    shown = figure(render(worn, 0, up), "as it was registered")
    if mesh is not None:
        shown = figure(render([(mesh.vertices, mesh.faces, CLOTH[0])], 0, up), "the template's file") + shown
    fine = said or "<p>The template fits.</p>"
    return f"<h2>Template of {html.escape(name)}</h2>{fine}{table(head, rows)}<div class='frame'><div class='row'>{shown}</div></div>"


def _frame(tuned, number):
    """Each quality of one frame: over captured pictures, and beside the scan."""
    rows = []
    for quality, tried in tuned.qualities.items():
        shown = "".join(jpeg_figure(made, caption) for caption, made in pictures(tried.run, number))
        rows.append(f"<p class='soft'>{quality}</p><div class='row'>{shown}</div>")
    return f"<section class='frame'><h3>frame {number}</h3>{''.join(rows)}</section>"
