"""`toile align RUN RUN2`: a run whose garments have slid along their surfaces until their prints lie as in the anchors.

prepare   the reference print of each garment            match   every pictured frame, in blocks of 50 frame numbers
write     the new run, once all blocks are done           report  the textures before and after

Blocks share nothing but the reference, so that shards and workers may take any of them; results lie in RUN2/slides, so that
a killed alignment goes on with the same bits.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..io.files import copy_file, load_record, save_record
from ..io.holdout import agreed, apart, held, words_of
from ..io.layout import PENDING
from ..io.locks import locked
from ..io.registration import registration
from ..io.run import Run, is_run, open_run
from ..io.run_folder import capture_folder, read_diagnostics, write_diagnostics
from ..io.run_writer import RunWriter, copy_store
from ..io.status import Status
from ..pipeline.blocks import BLOCK, BlockJob, FrameFolders, Progress, blocks, check_shares, run_job
from ..pipeline.manifest import check_own, claim, place_of
from ..pipeline.printing import references
from ..pipeline.workers import everywhere
from ..prints.aligner import PrintAligner, PrintedLayer, Target
from ..prints.lengths import true_lengths
from ..prints.matching import Matched
from ..prints.reference import NEAR, Reference
from ..prints.smoothing import over_time
from ..scene import GarmentTemplate
from ..surface.layering import Layering
from ..surface.layers import Layer, read_layers
from .report import torn, write_report
from .settings import AlignSettings
from .surfaces import garments_at, layers_at, pictures


@dataclass(frozen=True)
class Alignment:
    """Frames aligned by their own pictures, frames without pictures that slide as those of their block, frames whose pictures
    could not be used with why, frames that wait for other shards; whether the new run is whole; what should be known of it."""

    matched: tuple[int, ...]
    between: tuple[int, ...]
    failed: dict[int, str]
    pending: tuple[int, ...]
    whole: bool
    warnings: tuple[str, ...] = ()


def align(
    run: Path | str,
    out: Path | str,
    settings: AlignSettings | None = None,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    progress: Progress | None = None,
    scheduler: str | None = None,
    holdout: str | None = None,
) -> Alignment:
    """Aligns the garments of a registered run into the run `out`; returns an Alignment. UserError: it cannot be done.

    The same call on what was killed goes on where it stood. `shard` (i, n) takes every n-th block from the i-th on;
    whichever ends last writes the run. The bits depend on neither workers nor shards. `progress(stage, done, total)`. `scheduler`: of
    running dask workers, which do the work. `holdout`, "A-B": the frames that others take nothing of, which are those of the run."""
    out, settings, progress = (
        everywhere(Path(out), scheduler),
        settings or AlignSettings(),
        progress or (lambda *_: None),
    )
    check_shares(workers, shard, scheduler)
    run = open_run(everywhere(Path(run), scheduler))
    _check(run, out)
    span = agreed(holdout, run.holdout, run.path)
    if span != run.holdout:
        raise UserError(f"--holdout {words_of(span)}: {run.path} was registered without, register it with the same")
    if not apart(run.pictured, span):
        raise UserError(f"--holdout {words_of(span)}: no pictured frame is left to align by")
    _begin(run, out, settings)
    results = FrameFolders(out / "slides", Status.of(out), "align")
    job = BlockJob(out, results, prepare, (run, out, settings, span), match, NEAR, "match", held(span))
    last = partial(write, run, out, results, progress, span)
    run_job(job, run.pictured, partial(is_run, out), last, workers, shard, progress=progress, scheduler=scheduler)
    with locked(out):
        if is_run(out) and not (out / "alignment.json").exists():
            matched = [number for number in run.pictured if results.whole(number)]
            write_report(run, open_run(out), matched or run.pictured, progress)
    return _outcome(run, out, results, span)


def _check(run, out):
    if out.resolve() == run.path.resolve():
        raise UserError(f"{out}: the aligned run needs a folder of its own")
    check_own(out)
    if not run.garments:
        raise UserError(f"{run.path}: the scene names no garment, there is nothing to align")
    if (run.done == PENDING).any():
        raise UserError(f"{run.path}: frames are pending, end its registration first")
    if not run.pictured:
        raise UserError(f"{run.path}: no registered frame has pictures, prints cannot be aligned")


def _begin(run, out, settings):
    """Makes OUT with its config.toml and the run's status lines, or checks that it is of the same run and settings."""
    from .. import __version__

    asked = {
        "run": str(run.path.resolve()),
        "frames_ok": len(run.ok),
        "registration": registration(run, run.ok, run.garments.values()),
        "toile": __version__,
        "settings": settings.model_dump(mode="json"),
    }
    place = place_of(out, capture_folder(run.path, check=False))
    other = "this run was aligned from another run, from another registration of it, or with other settings"
    claim(out, run.config | place | {"align": asked}, other)
    with locked(out):
        if run.status.path.exists() and not Status.of(out).path.exists():
            copy_file(run.status.path, Status.of(out).path)


# Preparation: one reference a garment ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class PreparedAlignment:
    """What the frames are matched with."""

    run: Run
    layers: list[Layer]
    aligner: PrintAligner
    targets: dict[str, Target]
    layering: Layering

    def views(self, number):
        """What the pictures of a frame show of every garment."""
        return self.aligner.views(pictures(self.run, number), *layers_at(self.run, self.layers, number))


def prepare(run, out, settings, span, progress=lambda *_: None) -> PreparedAlignment:
    """Makes the references that OUT/reference does not hold yet, of frames that are not held out, and loads all."""
    paths = {name: out / "reference" / f"{name}.npz" for name in run.garments}
    rests = {name: load_record(path, Reference).rest for name, path in paths.items() if path.exists()}
    layers = [replace(x, rest=rests[x.name]) if x.name in rests else x for x in read_layers(run, apart(run.ok, span))]
    aligner = PrintAligner([_printed(run, layer) for layer in layers], run.capture.cameras, settings)
    body, garments = run.body_model, [layer for layer in layers if layer.kind == "garment"]
    sizes = [(garment.name, garment.faces, len(garment.rest)) for garment in garments]
    layering = Layering(body.skin_faces, len(body.v_template), sizes, settings.margin)
    prepared = PreparedAlignment(run, layers, aligner, {}, layering)
    if any(not path.exists() for path in paths.values()):
        read = lambda number: (prepared.views(number), garments_at(run, number))
        for name, reference in references(aligner, apart(run.pictured, span), read, progress).items():
            save_record(paths[name], reference)
    loaded = {name: load_record(path, Reference) for name, path in paths.items()}
    return replace(prepared, targets=aligner.targets(loaded))


def _printed(run, layer):
    """A Layer of the run as a PrintedLayer; all garments slide."""
    template = _template(run, layer) if layer.kind == "garment" else None
    return PrintedLayer(layer.name, layer.label, layer.rest, layer.faces, tuple(layer.loops.values()), template)


def _template(run, layer):
    """Vertices of the template, whose lengths the cloth keeps; where the run cut one from the capture, the run's own."""
    prepared, mesh = run.path / "prepared" / f"template.{layer.name}.npz", run.capture.templates.get(layer.name)
    own = load_record(prepared, GarmentTemplate, ("loops",)).rest if prepared.exists() else None
    cut = layer.name in run.config.get("settings", {}).get("template_from_scan", ())
    found = true_lengths(None if cut else mesh, own, layer.faces)
    if found is None:
        raise UserError(f"{run.capture.root}: the template of {layer.name} is not the one that {run.path} registered")
    return found


# Every pictured frame -------------------------------------------------------------------------------------------------


def match(prepared, number, previous, results) -> None:
    """Matches a frame's prints to the references, from the slides of the frame `previous` if there is one."""
    start, run = time.perf_counter(), prepared.run
    before = None if previous is None else {name: _matched(results, previous, name) for name in run.garments}
    matched = prepared.aligner.match(number, prepared.views(number), garments_at(run, number), prepared.targets, before)
    for name, slide in matched.items():
        save_record(results.folder(number) / f"{name}.npz", slide)
    blind = [name for name, slide in matched.items() if slide.blind]
    results.status.add(frame=number, stage="align", seconds=time.perf_counter() - start, ok=True, blind=blind)


def _matched(results, number, name):
    return load_record(results.folder(number) / f"{name}.npz", Matched)


# The new run ----------------------------------------------------------------------------------------------------------


def write(run, out, results, progress, span, prepared, pool) -> None:
    """A copy of the run's store in which the garments have slid, with its diagnostics; written whole."""
    frames, written = run.ok, count(1)

    def slide(writer: RunWriter):
        for wanted in blocks(frames, held(span)):
            slides = {name: _slides(prepared, results, name, wanted) for name in run.garments}
            with writer.together():
                for k, number in enumerate(wanted):
                    _write_frame(prepared, writer, number, {n: d[k] for n, d in slides.items() if d is not None})
                    progress("write", next(written), len(frames))

    for number in run.frames.tolist():
        stages = read_diagnostics(run.path, number)
        if results.whole(number):
            stages |= {f"align {name}": _measured(_matched(results, number, name)) for name in run.garments}
        if stages:
            write_diagnostics(out, number, stages)
    copy_store(run, out, slide)


def _slides(prepared, results, name, wanted):
    """Of one block's frames, None where none of them was matched."""
    known = [number for number in wanted if results.whole(number)]
    slides = [_matched(results, number, name).d for number in known]
    return over_time(known, slides, wanted, prepared.run.capture.scene.fps, prepared.aligner.settings)


def _write_frame(prepared, writer, number, slides):
    """Garments slid, and out of what lies under them where their triangles now meet it."""
    run, cloth, confidence = prepared.run, garments_at(prepared.run, number), {}
    for name, d in slides.items():
        registered = run.garments[name].confidence.at(number)
        cloth[name], confidence[name] = prepared.aligner.slid(name, cloth[name], registered, d)
    placed = prepared.layering.solve(run.body.at(number), cloth)
    for name, V in (placed.vertices if placed.intersections_before else cloth).items():
        if name in slides:
            writer.write_garment(number, name, V, confidence[name])


def _measured(matched):
    """What the diagnostics say of a garment's slide."""
    slide = float(np.linalg.norm(matched.d, axis=1).mean() * 1e3)
    return {"misfit_before": matched.before, "misfit": matched.after, "compared": matched.seen, "slide_mm": slide}


def _outcome(run, out, results, span):
    pictured = set(run.pictured)
    failed = {number: why for number in run.pictured if (why := results.reason(number)) is not None}
    matched = tuple(number for number in run.pictured if results.whole(number))
    pending = tuple(number for number in run.pictured if not results.done(number))
    told, between, left = {*matched, *pending}, [], []
    for block in blocks(run.ok, held(span)):
        kind = between if told.intersection(block) else left
        kind += [number for number in block if number not in pictured]
    words = (
        f"frames {frame_ranges(left, 4)} lie as they were registered: no picture of their blocks of {BLOCK} was matched"
    )
    warnings = (*([words] if left else []), *_blind(run, results), *torn(out))
    return Alignment(matched, tuple(between), failed, pending, is_run(out), warnings)


def _blind(run, results):
    """What to say of frames whose pictures show nothing of a garment."""
    told = {line.get("frame"): line.get("blind", ()) for line in results.status.lines() if line.get("stage") == "align"}
    for name in run.garments:
        if frames := sorted(number for number, blind in told.items() if name in blind):
            words = f"frames {frame_ranges(frames, 4)}: the pictures show nothing of garment {name}, as where masks are empty"
            yield f"{words}: it slides as in the frames beside them"
