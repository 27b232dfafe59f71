"""The order of the stages. This module alone knows it; `preparation` is what all frames need.

prepare   a person from sampled frames; colour models; each garment's template
track     every frame: pose and surface           segment, dress   where the scene names a garment
motion    once all are dressed: what flickers is smoothed over consecutive frames
fuse      then: the shape of the body under the garments, of every frame
inner     every frame: the body under the garments, and the garments out of it

Temporal state lives inside blocks of 50 absolute frame numbers and is dropped where a frame is missing or failed; workers
and shards take whole blocks. Results between passes lie in RUN/work until the run is whole, so a killed run goes on with
the same bits; what the preparation made stays in RUN/prepared, so that failed frames can be given again.
"""

from __future__ import annotations

import shutil
import time
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..config import Config, changed, configured
from ..errors import UserError
from ..io.capture import Capture, check_capture, open_capture
from ..io.files import load_record, save_record
from ..io.run import is_run, open_run
from ..io.run_folder import write_diagnostics
from ..io.run_writer import RunWriter
from ..io.status import Status
from ..measure.glimpse import Glimpse, glimpse
from ..measure.verdicts import judge
from ..scene import InnerShape, Segmented, Tracked
from . import scanning
from .blocks import BlockJob, FrameFolders, Progress, blocks, check_shares, run_job
from .fusing import fuse
from .labelling import scene_segmenter
from .manifest import begin_run, note_frame
from .outcome import Outcome, diagnostics_of, failed_frames, frames_left, is_whole, outcome_of, reopen, wrong_frames
from .overlap import overlapped
from .preparation import as_labels_see, frame_of, kept, points_of, prepare, segmented
from .printing import slide
from .smoothing import load_layers, smooth
from .template import check_templates
from .workers import everywhere

# of `register`, besides its settings
KEYWORDS = ("config", "frames", "progress", "workers", "shard", "retry", "verify", "scheduler")
RETRIES = ("failed", "wrong")  # which frames of a run are given again


def register(
    capture: str | Path | Capture,
    run: str | Path,
    config: Config | None = None,
    frames: Iterable[int] | None = None,
    progress: Progress | None = None,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    retry: bool | str = False,
    verify: bool = False,
    scheduler: str | None = None,
    **settings: Any,
) -> Outcome:
    """Registers `frames` (numbers; all by default) of a capture, its folder or opened, into the folder `run` and returns an
    Outcome.

    Settings are those that `toile settings` lists: `quality="draft"` names the preset that the others change, a stage's
    come as a dictionary, `dress={"contact": 0.01}`, or by dotted names, `**{"dress.contact": 0.01}`. With a `config` they
    change that one.

    `progress(stage, done, total)` is called along the way. The same call on a run that was killed goes on where it
    stood. `workers` processes share the work, or those of a running dask `scheduler` (tcp://HOST:PORT). `shard` (i, n) takes every n-th block from the i-th on, on its own or
    beside other shards of the run; whichever ends last finishes the run. `retry` "failed" (or True) gives failed
    frames again, whose files may have been mended, "wrong" those that are judged wrong too, with no temporal state of the
    frames that stand; nothing else is touched. Input files that have
    changed since the run read them are refused: by name, size and time, with `verify` by all their contents. The bits
    depend on neither workers nor shards. UserError: no such setting (the message names the nearest), or the capture, or a run
    folder that holds something else, cannot be used; nothing is left behind.
    """
    if config is not None and "quality" in settings:
        raise UserError(f"quality {settings['quality']}: a config is given too")
    config = configured(settings, KEYWORDS) if config is None else changed(config, settings, also=KEYWORDS)
    progress = progress or (lambda *_: None)
    check_shares(workers, shard, scheduler)
    run = everywhere(Path(run), scheduler)
    capture = capture if isinstance(capture, Capture) else open_capture(everywhere(Path(capture), scheduler))
    frames = tuple(capture.frames if frames is None else frames)
    capture = scanning.kept_in(run, capture)
    unknown = sorted(set(frames) - set(capture.frames))
    if unknown or not frames:
        raise UserError(f"{capture.root}/frames: no frame {unknown[0] if unknown else 'asked for'}")
    check_templates(capture, config)
    check_capture(capture, frames)
    if capture.scene.segmenter and capture.scene.garments:
        scene_segmenter(capture)
    fresh = not run.exists()
    results = FrameFolders(run / "work" / "frames", Status.of(run), "frame")
    title = "track, segment, dress" if capture.scene.garments else "track"
    job = BlockJob(run, results, prepare, (capture, run, config, frames), first_stages, 1, title)
    try:
        again = _again(run, frames, results, retry)
        begin_run(run, capture, config, frames, verify, again)
        if retry:
            reopen(run, again, results)
            scanning.forget(capture, again)
        damaged = open_run(run).damaged(frames) if is_run(run) else {}
        if damaged:
            reopen(run, tuple(damaged), results)
        last = partial(last_stages, run, frames, results, progress)
        left = partial(frames_left, run, frames)
        run_job(job, frames, partial(is_whole, run), last, workers, shard, left, progress, scheduler)
        notes = tuple(f"frame {number}: made again: {reason}" for number, reason in damaged.items())
        return replace(outcome_of(run, frames, results), notes=notes)
    except Exception:
        if fresh and not ((run / "work").exists() or is_run(run)):
            shutil.rmtree(run, ignore_errors=True)
        raise


def _again(run, frames, results, retry):
    """The frames that `retry` gives again."""
    if retry not in (False, True, *RETRIES):
        raise UserError(f"retry {retry}: expected one of {', '.join(RETRIES)}")
    failed = failed_frames(run, frames, results) if retry else ()
    return (*failed, *wrong_frames(run, frames)) if retry == "wrong" else failed


# Every frame: track, segment, dress -----------------------------------------------------------------------------------


def first_stages(prepared, number, previous, results) -> Iterator[None]:
    """Makes a frame's Tracked, Segmented and Dressed, a step each; the frame `previous` gives temporal state."""
    capture, folder = prepared.capture, results.folder(number)
    before = None if previous is None else results.folder(previous)
    seconds: dict[str, float] = {}

    def timed(stage, make):
        start = time.perf_counter()
        result = make()
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
        return result

    note_frame(prepared.folder.parent, capture, number)
    scanning.make_scan(capture, number, prepared.config, results.status)
    frame = frame_of(capture, prepared.config, number)
    points = timed("reconstruct", lambda: points_of(capture, prepared.config, frame))
    yield
    last = None if before is None else load_record(before / "track.npz", Tracked)
    tracked = timed("track", lambda: prepared.tracker.track(frame, points, last))
    save_record(folder / "track.npz", tracked)
    yield
    shown, labels = frame, None
    if prepared.templates:
        shown = as_labels_see(frame, prepared.config)
        last = None if before is None else _load_segmented(before / "segment.npz")
        found = timed("segment", lambda: segmented(prepared, prepared.colours, shown, tracked, last))
        save_record(folder / "segment.npz", found[0])
        yield
        for template, dresser in zip(prepared.templates, prepared.dressers):
            dressed = timed("dress", lambda: dresser.dress(shown, tracked, *found))
            save_record(folder / f"dress.{template.name}.npz", dressed)
        labels = found[0].scan_faces
    save_record(folder / "seen.npz", glimpse(replace(shown, masks=frame.masks), labels))
    for stage, value in seconds.items():
        results.status.add(frame=number, stage=stage, seconds=value, ok=True)


def _load_segmented(path):
    """What later frames and stages ask of a frame's Segmented."""
    return load_record(path, Segmented, only=("vertices", "diagnostics"))


# Once all are dressed: smoothing, the inner layer, and the store ------------------------------------------------------


def last_stages(run, frames, results, progress, prepared, pool) -> None:
    """The body under the garments, the garments out of it, and every frame's arrays to the store."""
    scene, good = prepared.capture.scene, [number for number in frames if results.whole(number)]
    if any(garment.prints for garment in scene.garments):
        slide(partial(_load_dressed, results), good, _slid(results), prepared, pool, progress)
    if prepared.config.motion.temporal:
        smooth(partial(_load_slid, results), good, _smoothed(results), prepared, pool)
    if scene.garments:
        kept(prepared.folder / "inner.npz", InnerShape, lambda: _fuse(run, frames, results, prepared, pool))
    if not is_run(run):
        RunWriter.create(run, frames, scene, prepared.model, prepared.person, prepared.templates)
    left = frames_left(run, frames)
    for i, _ in enumerate(pool.each(partial(_finish, run, results), RunWriter.of(run).groups(left))):
        progress("inner" if scene.garments else "store", len(frames) - len(left) + i + 1, len(frames))
    RunWriter.of(run).write_diagnostics(diagnostics_of(run, frames, results.status))
    shutil.rmtree(run / "work", ignore_errors=True)


def _fuse(run, frames, results, prepared, pool):
    """The InnerShape of all frames that are whole."""
    good = blocks([number for number in frames if results.whole(number)])
    if not good:
        return InnerShape(prepared.person.rest, {})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        shape = fuse(good, partial(_load_results, results), run / "work" / "fusion", prepared, pool)
    for warning in caught:
        results.status.add(stage="inner", ok=False, warning=str(warning.message))
    return shape


def _smoothed(results):
    """The folders of the frames as `smooth` leaves them."""
    return FrameFolders(results.root.parent / "smoothed", results.status, "motion")


def _slid(results):
    """The folders of the printed garments as `slide` leaves them."""
    return FrameFolders(results.root.parent / "slid", results.status, "prints")


def _load_dressed(results, prepared, number):
    """A frame as the first stages made it."""
    tracked, dressed = load_layers(results.folder(number), prepared.templates)
    return tracked, _load_segmented(results.folder(number) / "segment.npz"), dressed


def _load_slid(results, prepared, number):
    """A frame's layers, printed garments slid."""
    return load_layers(results.folder(number), prepared.templates, _slid(results).folder(number))


def _load_results(results, prepared, number):
    """A frame as the last stages take it: smoothed, where that is asked for."""
    if prepared.config.motion.temporal:
        tracked, dressed = load_layers(_smoothed(results).folder(number), prepared.templates)
    else:
        tracked, dressed = _load_slid(results, prepared, number)
    segmented = _load_segmented(results.folder(number) / "segment.npz") if prepared.templates else None
    return tracked, segmented, dressed


def _finish(run, results, prepared, numbers):
    """Solves the inner layer of these frames and writes them to the store, each file once; yields each number."""
    writer, made = RunWriter.of(run), {}
    with writer.together():
        for number, error in overlapped(lambda number, _: _last_stage(prepared, number, results, made), numbers):
            if error is not None:
                results.fail(number, error)
            if number in made:
                found, (measures, level, reasons) = made.pop(number)
                words = {"evidence": measures, "verdict": level, "reasons": reasons}
                write_diagnostics(run, number, _measured(*found) | words)
                writer.write(number, *found, verdict=level)
            else:
                write_diagnostics(run, number, {"reason": results.reason(number)})
                writer.fail(number)
            yield number


def _last_stage(prepared, number, results, made) -> Iterator[None]:
    """(Tracked, Segmented, {garment: Dressed}, Inner) of a frame, only the first without garments, and what is judged of it,
    into `made`; nothing of a frame that failed."""
    if not results.whole(number):
        return
    found = _load_results(results, prepared, number)
    if prepared.templates:
        start = time.perf_counter()
        body = prepared.inner.body(*found)
        seconds = time.perf_counter() - start
        yield
        start = time.perf_counter()
        layer = prepared.inner.layered(body, *found)
        seconds += time.perf_counter() - start
        results.status.add(frame=number, stage="inner", seconds=seconds, ok=True)
        found = (*found, layer)
        yield
    else:
        found = found[:1]
    start = time.perf_counter()
    made[number] = found, _judged(prepared, number, results, *found)
    results.status.add(frame=number, stage="verdict", seconds=time.perf_counter() - start, ok=True)


def _measured(tracked, segmented=None, dressed=None, layer=None):
    """A frame's diagnostics {stage: {name: number}}."""
    if layer is None:
        return {"track": tracked.diagnostics}
    garments = {f"dress {name}": dressed[name].diagnostics for name in layer.garments}
    stages = {"track": tracked, "segment": segmented, "inner": layer}
    return {stage: made.diagnostics for stage, made in stages.items()} | garments


def _judged(prepared, number, results, tracked, segmented=None, dressed=None, layer=None):
    """({measure: number}, verdict, reasons) of a frame, from what it shows of its layers."""
    seen = load_record(results.folder(number) / "seen.npz", Glimpse)
    templates = {template.name: template for template in prepared.templates}
    worn = [(templates[name], V, dressed[name]) for name, V in layer.garments.items()] if layer else []
    capture, model, settings = prepared.capture, prepared.model, prepared.config.verdict
    pairs = layer.intersections_left if layer else 0
    return judge(seen, capture.cameras, model, prepared.person, tracked, worn, settings, pairs)
