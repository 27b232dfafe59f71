"""The aligned run: a copy of the run's store in which the garments have slid."""

from __future__ import annotations

from functools import partial
from itertools import count

import numpy as np

from ..io.holdout import held
from ..io.run_folder import read_diagnostics, write_diagnostics
from ..io.run_writer import RunWriter, copy_store
from ..pipeline.blocks import blocks
from ..prints.smoothing import over_time
from .matching import matched_in
from .surfaces import garments_at


def write(run, out, results, progress, span, prepared, pool) -> None:
    """The run `out`, whole: the diagnostics of every frame, then a copy of the run's store in which the garments have slid."""
    for number in run.frames.tolist():
        stages = read_diagnostics(run.path, number)
        if results.whole(number):
            stages |= {f"align {name}": _diagnostics(matched_in(results, number, name)) for name in run.garments}
        if stages:
            write_diagnostics(out, number, stages)
    copy_store(run, out, partial(_write_garments, results, progress, span, prepared))


def _write_garments(results, progress, span, prepared, writer: RunWriter):
    """The garments of every frame, block by block."""
    frames, written = prepared.run.ok, count(1)
    for block in blocks(frames, held(span)):
        slides = {name: _slides(prepared, results, name, block) for name in prepared.run.garments}
        with writer.together():
            for k, number in enumerate(block):
                _write_frame(prepared, writer, number, {n: d[k] for n, d in slides.items() if d is not None})
                progress("write", next(written), len(frames))


def _slides(prepared, results, name, block):
    """Displacements (w,g,2) [m] of a garment in the w frames of one block, None where none of them was matched."""
    known = [number for number in block if results.whole(number)]
    slides = [matched_in(results, number, name).d for number in known]
    return over_time(known, slides, block, prepared.run.capture.scene.fps, prepared.aligner.settings)


def _write_frame(prepared, writer, number, slides):
    """Garments slid by `slides` {garment: its displacement}, and out of what lies under them where their triangles now meet it."""
    run, cloth, confidence = prepared.run, garments_at(prepared.run, number), {}
    for name, d in slides.items():
        registered = run.garments[name].confidence.at(number)
        cloth[name], confidence[name] = prepared.aligner.slid(name, cloth[name], registered, d)
    placed = prepared.layering.solve(run.body.at(number), cloth)
    for name, V in (placed.vertices if placed.intersections_before else cloth).items():
        if name in slides:
            writer.write_garment(number, name, V, confidence[name])


def _diagnostics(matched):
    """What the diagnostics say of a garment's slide."""
    slide = float(np.linalg.norm(matched.d, axis=1).mean() * 1e3)
    return {"misfit_before": matched.before, "misfit": matched.after, "compared": matched.seen, "slide_mm": slide}
