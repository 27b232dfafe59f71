"""The order of the stages. This module alone knows it; `preparation` is what all frames need.

prepare   a person from sampled frames; colour models; each garment's template
track     every frame: pose and surface           segment, dress   where the scene names a garment
motion    once all are dressed: what flickers is smoothed over consecutive frames
fuse      then: the shape of the body under the garments, of every frame
inner     every frame: the body under the garments, and the garments out of it

Temporal state lives inside blocks of 50 absolute frame numbers and is dropped where a frame is missing or failed; workers
and shards take whole blocks. Results between passes lie in RUN/work, what the preparation made in RUN/prepared, each with
the identity of what it was made of: so a killed run goes on with the same bits, and what has changed redoes what depends on
it.
"""

from __future__ import annotations

import shutil
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..config import Config, changed, configured
from ..console import positive
from ..errors import UserError
from ..io.capture import Capture, check_capture, open_capture
from ..io.files import identity_of, load_record, naming, save_record
from ..io.holdout import apart, held
from ..io.layout import STORE
from ..io.locks import BUSY, abandoned, at_work, locked
from ..io.run import is_run
from ..io.run_folder import config_file, note_of, read_config, write_diagnostics
from ..io.run_writer import RunWriter
from ..io.status import Status
from ..measure.glimpse import Glimpse, glimpse, outlines
from ..measure.verdicts import judge
from ..scene import InnerShape, Segmented, Tracked
from ..stages.motion import scan_beside
from ..vision.segmenters.asked import scene_segmenter
from . import scanning
from .blocks import BlockJob, FrameFolders, Progress, blocks, check_shares, frame_numbers_of, run_job
from .fusing import fuse
from .manifest import check_folder, config_of, note_frame, request_of, try_again, write_request
from .outcome import Outcome, RunStores, again, diagnostics_of, outcome_of, recover
from .overlap import overlapped
from .preparation import kept, prepare, segmented, segmented_again
from .printing import slide
from .samples import as_labels_see, frame_of, points_of, sampled_frames
from .smoothing import load_layers, smooth
from .stopping import stoppable
from .template import check_templates
from .workers import everywhere

# of `register`, besides its settings
KEYWORDS = ("config", "frames", "progress", "workers", "shard", "retry", "verify", "scheduler", "frame_limit", "keep")


def register(
    capture: str | Path | Capture,
    run: str | Path,
    config: Config | None = None,
    frames: Iterable[int] | None = None,
    progress: Progress | None = None,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    retry: bool | str | Iterable[int] = False,
    verify: bool = False,
    scheduler: str | None = None,
    frame_limit: float | None = None,
    keep: bool = True,
    **settings: Any,
) -> Outcome:
    """Registers `frames` (numbers in any order; all by default) of a capture, its folder or opened, into the folder `run` and
    returns an Outcome.

    Settings are those that `toile settings` lists: `quality="draft"` names the preset that the others change, a stage's
    come as a dictionary, `dress={"contact": 0.01}`, or by dotted names, `**{"dress.contact": 0.01}`. With a `config` they
    change that one.

    `progress(stage, done, total)` is called along the way. The same call on a run that was killed goes on where it
    stood. What is not given stays as the run was asked for before: its frames, to which others are added, and its settings.
    What depends on a setting or a file that has changed is made again, and nothing else; what stands is replaced by what
    is whole. Files are compared by name, size and time, with `verify` by their contents. `workers` processes share the
    work, or those of a running dask `scheduler` (tcp://HOST:PORT). `shard` (i, n) takes every n-th block from the i-th on, on its own or beside other shards of the run; whichever
    ends last finishes the run. `retry` gives frames again: "failed" (or True), "wrong" those too that are judged wrong,
    "worst:20" the worst by their evidence, or frame numbers. A frame fails that takes longer than `frame_limit` [s], whether it ends or not: a
    process beside this one makes the frames then, where `workers` do not, and is ended with a stage that hangs. `keep`:
    what passes between the stages stays in RUN/work, so that a changed setting redoes only what depends on it. The bits
    depend on neither workers nor shards. UserError: no such setting (the message names the nearest), or the capture, or a run
    folder that holds something else, cannot be used; nothing is left behind.
    """
    run, progress = everywhere(Path(run), scheduler), progress or (lambda *_: None)
    check_shares(workers, shard, scheduler)
    positive("frame_limit", frame_limit)
    check_folder(run)
    config = _config(run, config, settings)
    capture = capture if isinstance(capture, Capture) else open_capture(everywhere(Path(capture), scheduler))
    capture = scanning.kept_in(run, capture)
    frames = _frames(run, capture, frames)
    check_templates(capture, config)
    if not config_file(run).exists():
        check_capture(capture, frames)
    if capture.scene.segmenter and capture.scene.garments:
        scene_segmenter(capture)
    fresh = not run.exists()
    try:
        parts = blocks(frames, held(config.holdout))[shard[0] - 1 :: shard[1]]
        own = [number for block in parts for number in block]
        scanning.load_libraries(capture, own, config)
        with _asked(run, capture, config, frames, own, verify) as request:
            crew = workers, shard, scheduler
            return _register(capture, run, config, request, own, progress, crew, retry, frame_limit, keep)
    except Exception:
        others = (run / BUSY).exists() and not abandoned(run)
        if fresh and not (others or (run / "work").exists() or is_run(run)):
            shutil.rmtree(run, ignore_errors=True)
        raise


@contextmanager
def _asked(run, capture, config, frames, own, verify):
    """What is asked for, once it is kept in RUN/config.toml and this process says that it works there: of two that begin at once
    and ask for different things the second is refused."""
    with ExitStack() as busy:
        with locked(run):
            sample = partial(sampled_frames, capture, config.preparation_frames)
            request = request_of(run, capture, config, frames, own, sample, verify)
            refusal = (
                f"{run}: another process works at it, and something else is asked for now: {'; '.join(request.notes)}"
            )
            busy.enter_context(at_work(run, request.other, refusal))
            recover(run)
            write_request(run, capture, config, request)
        yield request


def _config(run, config, settings):
    """What is given, above what the run was asked for before."""
    if not isinstance(config, Config | None):
        raise UserError(f"config: expected a Config as toile.config.preset gives, came {type(config).__name__}")
    if config is not None and "quality" in settings:
        raise UserError(f"quality {settings['quality']}: a config is given too")
    config = config or (None if "quality" in settings else config_of(run))
    return configured(settings, KEYWORDS) if config is None else changed(config, settings, also=KEYWORDS)


def _frames(run, capture, frames):
    """Numbers of frames, rising and each once: those asked for and those of the run."""
    known = tuple(read_config(run).get("frames", ())) if config_file(run).exists() else ()
    asked = tuple(capture.frames if not known else ()) if frames is None else frame_numbers_of("frames", frames)
    unknown = sorted(set(asked) - set(capture.frames) - set(known))
    if unknown or not (asked or known):
        raise UserError(f"{capture.root}/frames: no frame {unknown[0] if unknown else 'asked for'}")
    if not known:
        return asked
    return known if set(asked) <= set(known) else tuple(sorted({*known, *asked}))


def _register(capture, run, config, request, own, progress, crew, retry, frame_limit, keep):
    workers, shard, scheduler = crew
    frames, identities = request.frames, request.identities
    stored = RunStores(run, frames, identities)
    first = "dress" if capture.scene.garments else "track"
    results = FrameFolders(run / "work" / "frames", Status.of(run), "frame", partial(identities.of, first))
    with locked(run):
        try_again(run, again(stored, own, results, retry, config.verdict))
        damaged = stored.reopen_damaged(own)
    title = "track, segment, dress" if capture.scene.garments else "track"
    arguments = capture, run, config, identities
    job = BlockJob(run, results, prepare, arguments, first_stages, 1, title, held(config.holdout), frame_limit)
    last = partial(last_stages, stored, results, progress, keep, frame_limit)
    run_job(job, frames, lambda: stored.whole, last, workers, shard, stored.left, progress, scheduler)
    notes = *request.notes, *(f"frame {number}: made again: {reason}" for number, reason in damaged.items())
    return replace(outcome_of(stored, results), notes=notes)


# Every frame: track, segment, dress -----------------------------------------------------------------------------------


def first_stages(prepared, number, previous, results) -> Iterator[None]:
    """Makes a frame's Tracked, Segmented and Dressed, a step each; the frame `previous` gives temporal state. What is there
    of an earlier try and made of the same stays."""
    capture, folder, identities = prepared.capture, results.folder(number), prepared.identities
    before = None if previous is None else results.folder(previous)
    if not note_of(identities.run, number).exists():
        note_frame(identities.run, capture, number)
    clock = Clock()
    asked = partial(identities.step, frame=number, previous=previous)
    stands = lambda stage: identity_of(folder / f"{stage}.npz", whole=True) == asked(stage)
    scanning.make_scan(capture, number, prepared.config, results.status, identities)
    frame = frame_of(capture, prepared.config, number)
    if stands("track"):
        yield
        tracked = load_record(folder / "track.npz", Tracked)
    else:
        points = clock.timed("reconstruct", lambda: points_of(capture, prepared.config, frame))
        yield
        last = None if before is None else load_record(before / "track.npz", Tracked)
        tracked = clock.timed("track", lambda: prepared.tracker.track(frame, points, last))
        save_record(folder / "track.npz", tracked, asked("track"))
    yield
    shown, labels, outlined = frame, None, outlines(frame)
    frame = None  # its pictures are large
    if prepared.templates:
        shown = as_labels_see(shown, prepared.config)
        if stands("segment"):
            found = clock.timed("segment", lambda: segmented_again(prepared, shown, tracked, folder / "segment.npz"))
        else:
            last = None if before is None else _load_segmented(before / "segment.npz")
            found = clock.timed("segment", lambda: segmented(prepared, prepared.colours, shown, tracked, last))
            save_record(folder / "segment.npz", found[0], asked("segment"))
        yield
        for template, dresser in zip(prepared.templates, prepared.dressers):
            dressed = clock.timed("dress", lambda: dresser.dress(shown, tracked, *found))
            save_record(folder / f"dress.{template.name}.npz", dressed)
        labels = found[0].scan_faces
    save_record(folder / "seen.npz", glimpse(shown, labels, outlined))
    clock.tell(results.status, number)


class Clock:
    """The seconds of a frame's stages."""

    def __init__(self):
        self.seconds = {}

    def timed(self, stage, make):
        start = time.perf_counter()
        result = make()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
        return result

    def tell(self, status, number):
        """A line of the status for each stage of the frame."""
        for stage, seconds in self.seconds.items():
            status.add(frame=number, stage=stage, seconds=seconds, ok=True)


def _load_segmented(path):
    """What later frames and stages ask of a frame's Segmented."""
    return load_record(path, Segmented, only=("vertices", "diagnostics"))


# Once all are dressed: smoothing, the inner layer, and the store ------------------------------------------------------


def last_stages(stored, results, progress, keep, limit, prepared, pool) -> None:
    """The body under the garments, the garments out of it, and every frame's arrays to the store."""
    run, scene, frames = stored.run, prepared.capture.scene, stored.frames
    good = [number for number in frames if results.whole(number)]
    if stored.left():
        if any(garment.prints for garment in scene.garments):
            slide(partial(_load_dressed, results), good, _slid(results, prepared), prepared, pool, progress)
        if prepared.config.motion.temporal:
            smooth(partial(_load_slid, results), good, _smoothed(results, prepared), prepared, pool, progress)
        if scene.garments:
            fused = partial(_fuse, run, good, results, prepared, pool, progress)
            kept(prepared.folder / "inner.npz", InnerShape, fused, prepared.identities.stages["inner"])
    with naming(stored.folder / STORE):
        writer = _store(stored, prepared)
        left = [number for number in frames if number not in stored.behind(stored.folder)]
        for i, _ in enumerate(pool.each(partial(_finish, stored, results, limit), writer.groups(left))):
            progress("inner" if scene.garments else "store", len(frames) - len(left) + i + 1, len(frames))
        writer.write_diagnostics(diagnostics_of(run, frames, results.status))
        stored.install()
    if not keep:
        shutil.rmtree(run / "work", ignore_errors=True)


def _store(stored, prepared):
    """The writer of the store that takes the frames, which is not whole from now on."""
    folder = stored.folder
    if is_run(folder) and RunWriter.of(folder).identity != stored.shared:
        shutil.rmtree(folder / STORE)  # it grew for what was asked for once, and was never whole
    if not is_run(folder):
        scene, made = prepared.capture.scene, (prepared.model, prepared.person, prepared.templates)
        RunWriter.create(folder, stored.frames, scene, *made, stored.shared, prepared.config.holdout)
    writer = RunWriter.of(folder)
    writer.begin()
    return writer


def _fuse(run, good, results, prepared, pool, progress):
    """The InnerShape of all frames that are whole and not held out."""
    good = apart(good, prepared.config.holdout)
    if not good:
        return InnerShape(prepared.person.rest, {})
    results.status.forget("inner")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load, folder = partial(_load_results, results), run / "work" / "fusion"
        shape = fuse(blocks(good), load, folder, prepared, pool, results.status, progress)
    for warning in caught:
        results.status.add(stage="inner", ok=False, warning=str(warning.message))
    return shape


def _smoothed(results, prepared):
    """The folders of the frames as `smooth` leaves them."""
    identity = partial(prepared.identities.of, "motion")
    return FrameFolders(results.root.parent / "smoothed", results.status, "motion", identity)


def _slid(results, prepared):
    """The folders of the printed garments as `slide` leaves them."""
    identity = partial(prepared.identities.of, "prints")
    return FrameFolders(results.root.parent / "slid", results.status, "prints", identity)


def _load_dressed(results, prepared, number):
    """A frame as the first stages made it."""
    tracked, dressed = load_layers(results.folder(number), prepared.templates)
    return tracked, _load_segmented(results.folder(number) / "segment.npz"), dressed


def _load_slid(results, prepared, number):
    """A frame's layers, printed garments slid."""
    return load_layers(results.folder(number), prepared.templates, _slid(results, prepared).folder(number))


def _load_results(results, prepared, number):
    """A frame as the last stages take it: smoothed, where that is asked for; its labels are of the frame that gave its surfaces."""
    if prepared.config.motion.temporal:
        tracked, dressed = load_layers(_smoothed(results, prepared).folder(number), prepared.templates)
    else:
        tracked, dressed = _load_slid(results, prepared, number)
    labelled = results.folder(number + scan_beside(tracked)) / "segment.npz"
    return tracked, _load_segmented(labelled) if prepared.templates else None, dressed


def _finish(stored, results, limit, prepared, numbers):
    """Solves the inner layer of these frames and writes them to the store, each file once; yields each number. Those that
    the run's own store has are taken over from there."""
    run, writer, made = stored.run, RunWriter.of(stored.folder), {}
    there = stored.behind(run) if stored.folder != run else frozenset()
    layers = prepared.inner if prepared.templates else None  # made before the clock starts
    with results.status.timing(len(numbers), stage="store") as ends, stoppable():
        with writer.together():
            for number in (number for number in numbers if number in there):
                writer.copy(number, RunWriter.of(run))
                yield number
            numbers = [number for number in numbers if number not in there]
            alone = results.fail_late(numbers, limit) is False
            make = partial(_last_stage, prepared, layers, results, made)
            begin = partial(_begin_last, results, limit, make)
            for number, error in overlapped(begin, numbers, threads=1 if alone else None):
                if error is not None:
                    results.fail(number, error)
                _write(stored, writer, results, number, made.pop(number, None))
                ends()
                yield number
        ends()


def _begin_last(results, limit, make, number, _before):
    return results.timed(number, limit, partial(make, number))


def _write(stored, writer, results, number, made):
    """A frame to the store, and what is said of it; None: it failed."""
    if made is None:
        write_diagnostics(stored.run, number, {"reason": results.reason(number)})
        writer.fail(number, stored.identity(number))
        return
    found, (measures, level, reasons) = made
    words = {"evidence": measures, "verdict": level, "reasons": reasons}
    write_diagnostics(stored.run, number, _measured(*found) | words)
    writer.write(number, *found, verdict=level, identity=stored.identity(number))


def _last_stage(prepared, layers, results, made, number) -> Iterator[None]:
    """(Tracked, Segmented, {garment: Dressed}, Inner) of a frame, only the first without garments, and what is judged of it,
    into `made`; nothing of a frame that failed."""
    if not results.whole(number) or results.reason(number) is not None:
        return
    found, clock = _load_results(results, prepared, number), Clock()
    if layers is not None:
        body = clock.timed("inner", lambda: layers.body(*found))
        yield
        found = (*found, clock.timed("inner", lambda: layers.layered(body, *found)))
        yield
    else:
        found = found[:1]
    made[number] = found, clock.timed("verdict", lambda: _judged(prepared, number, results, *found))
    clock.tell(results.status, number)


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
