"""The order of the stages. This module alone knows it.

prepare   a person from sampled frames; colour models; each garment's template; the fused inner shape
track     every frame: pose and surface           segment, dress   where the scene names a garment
inner     every frame, once all are dressed: the body under the garments, and the garments out of it

Temporal state lives inside blocks of 50 absolute frame numbers and is dropped where a frame is missing or failed; workers
and shards take whole blocks. Results between passes lie in RUN/work until the run is whole, so a killed run goes on with
the same bits; what the preparation made stays in RUN/prepared, so that failed frames can be given again.
"""

from __future__ import annotations

import json
import shutil
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..config import Config, changed, configured
from ..errors import UserError
from ..io.body import load_body_model
from ..io.capture import check_capture, open_capture
from ..io.files import load_record, save_record, write_text
from ..io.run import FAILED, OK, PENDING, Registered, Status, create_store, frame_arrays
from ..kernels import InputError, SolveError
from ..scene import Dressed, GarmentTemplate, InnerShape, Person, Segmented, Tracked
from ..stages import dress, inner, reconstruct, segment, track
from ..surface.curves import Curve
from ..surface.sampling import evenly
from ..vision.colours import ColourModel
from .blocks import Workers, locked
from .manifest import open_run
from .plan import blocks

Progress = Callable[[str, int, int], None]
KEYWORDS = ("config", "frames", "progress", "workers", "shard", "retry")  # of `register`, besides its settings
FRAME_ERRORS = (UserError, InputError, SolveError, OSError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Outcome:
    """How a run ended: frames registered; frames failed with their reasons; registered frames in which hands touch cloth
    in a way that the layers cannot represent; what the garments' preparation warned of; frames that wait for other shards.
    """

    ok: tuple[int, ...]
    failed: dict[int, str]
    unsupported_contact: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    pending: tuple[int, ...] = ()


def register(
    capture: str | Path,
    run: str | Path,
    config: Config | None = None,
    frames: Iterable[int] | None = None,
    progress: Progress | None = None,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    retry: bool = False,
    **settings: Any,
) -> Outcome:
    """Registers `frames` (numbers; all by default) of a capture into the folder `run` and returns an Outcome.

    Settings are those that `toile settings` lists: `quality="draft"` names the preset that the others change, a stage's
    come as a dictionary, `dress={"contact": 0.01}`, or by dotted names, `**{"dress.contact": 0.01}`. With a `config` they
    change that one.

    `progress(stage, done, total)` is called along the way. The same call on a run that was killed goes on where it
    stood. `workers` processes share the work. `shard` (i, n) takes every n-th block from the i-th on, on its own or
    beside other shards of the run; whichever ends last finishes the run. `retry` gives failed frames again, whose files
    may have been mended, with no temporal state of the frames that stand; nothing else is touched. The bits depend on
    neither workers nor shards. UserError: no such setting (the message names the nearest), or the capture, or a run
    folder that holds something else, cannot be used; nothing is left behind.
    """
    if config is not None and "quality" in settings:
        raise UserError(f"quality {settings['quality']}: a config is given too")
    config = configured(settings, KEYWORDS) if config is None else changed(config, settings, also=KEYWORDS)
    if workers < 1 or not 1 <= shard[0] <= shard[1]:
        asked = f"workers {workers}, shard {shard[0]}/{shard[1]}"
        raise UserError(f"{asked}: expected at least one worker and 1 <= i <= n")
    capture = open_capture(capture)
    frames = tuple(capture.frames if frames is None else frames)
    unknown = sorted(set(frames) - set(capture.frames))
    if unknown or not frames:
        raise UserError(f"{capture.root}/frames: no frame {unknown[0] if unknown else 'asked for'}")
    check_capture(capture, frames)
    run, fresh = Path(run), not Path(run).exists()
    open_run(run, capture, config, frames, retry)
    try:
        return _Run(capture, run, config, frames, progress or (lambda *_: None), workers, shard).go(retry)
    except FRAME_ERRORS:
        if fresh and not any((run / name).exists() for name in ("work", "registered.zarr")):
            shutil.rmtree(run, ignore_errors=True)
        raise


def _load_segmented(path):
    """JSON turned the openings' ids into strings and their curves into plain dictionaries."""
    segmented = load_record(path, Segmented)
    openings = {int(k): [Curve(np.array(c["points"]), c["closed"]) for c in v] for k, v in segmented.openings.items()}
    return replace(segmented, openings=openings)


def _worker(root, run, config, frames):
    """The _Run of a worker process: it loads what the run has prepared."""
    own = _Run(open_capture(root), run, config, frames, lambda *_: None)
    own._prepare()
    return own


class _Run:
    """One run over its frames; every result goes through RUN/work, so that it is made once."""

    def __init__(self, capture, run, config, frames, progress, workers=1, shard=(1, 1)):
        self.capture, self.run, self.config, self.frames, self.progress = capture, run, config, frames, progress
        self.scene, self.work, self.prepared, self.shard = capture.scene, run / "work", run / "prepared", shard
        name = self.scene.body_model
        self.model = load_body_model(capture.root / name if name.endswith(".npz") else name, up=self.scene.up)
        self.status = Status(run / "status.jsonl")
        self.store = run / "registered.zarr"
        self.workers = Workers(workers, _worker, capture.root, run, config, frames) if workers > 1 else None

    def go(self, retry=False):
        try:
            with locked(self.run):
                if retry:
                    self._give_again()
                if self._whole():
                    return self._outcome()
                self._prepare()
            self._first_pass()
            with locked(self.run):
                if not self._whole() and all(self._first_done(number) for number in self._left()):
                    self._complete()
                return self._outcome()
        finally:
            if self.workers:
                self.workers.close()

    def _whole(self):
        return self.store.exists() and Registered(self.store).whole

    def _complete(self):
        """Once the first pass is behind every frame of the run, whichever process made it."""
        if self.scene.garments:
            self._fuse()
        self._last_pass()
        self._write_diagnostics(Registered(self.store))
        shutil.rmtree(self.work, ignore_errors=True)

    def _give_again(self):
        """Failed frames become pending."""
        if self._whole():
            shutil.rmtree(self.work, ignore_errors=True)
        for failed in self.work.glob("frames/*/failed.json"):
            failed.unlink()
        if self.store.exists():
            Registered(self.store).reopen()

    def _left(self):
        """Frames that the store does not have."""
        if not self.store.exists():
            return self.frames
        registered = Registered(self.store)
        return tuple(f for f in self.frames if registered.done(f) == PENDING)

    def _each(self, method, items):
        """Frame numbers as `method(item)`, which yields them, has done them, here or in the workers."""
        if self.workers and len(items) > 1:
            yield from self.workers.each(method, items)
        else:
            for item in items:
                yield from getattr(self, method)(item)

    def _kept(self, name, kind, make, tuples=()):
        """The record RUN/prepared/NAME.npz, made when it is not there."""
        path = self.prepared / f"{name}.npz"
        if not path.exists():
            save_record(path, make())
        return load_record(path, kind, tuples)

    # Preparation ------------------------------------------------------------------------------------------------

    def _prepare(self):
        self.progress("prepare", 0, 1)
        self.person = self._kept("person", Person, self._make_person)
        self.tracker = track.Tracker(self.model, self.person, self.config.track)
        self.templates, self.colours = (), None
        if self.scene.garments:
            self._prepare_garments()
        self.progress("prepare", 1, 1)

    def _samples(self):
        """Frames spread evenly over the run that can be read, with their keypoints in space."""
        chosen = evenly(self.frames, self.config.preparation_frames)
        samples, reasons = [], []
        for number in chosen:
            try:
                frame = self.capture.frame(number)
                samples.append((frame, self._points(frame)))
            except FRAME_ERRORS as error:
                reasons.append(str(error))
        if not samples:
            raise UserError(reasons[0])
        return samples

    def _points(self, frame):
        if frame.keypoints is None:
            return None
        return reconstruct.triangulate(frame.keypoints, self.capture.cameras, self.config.reconstruct)

    def _make_person(self):
        return track.prepare(self.model, self._samples(), self.config.track)

    def _prepare_garments(self):
        names = [g.name for g in self.scene.garments]
        paths = [self.prepared / "colours.npz", *(self.prepared / f"template.{n}.npz" for n in names)]
        if not all(p.exists() for p in paths):
            samples = [(f, self.tracker.track(f, points)) for f, points in self._samples()]
            for warning in self.capture.warnings:
                self.status.add(stage="dress", ok=False, warning=warning)
            colours = segment.prepare(self.scene, self.capture.cameras, samples, self.model.f, self.config.segment)
            save_record(paths[0], colours)
            fitted = dress.fit_samples(samples, self.config.dress)
            labelled = [(f, t, *self._segment(colours, f, t, None)) for f, t in fitted]
            for garment, path in zip(self.scene.garments, paths[1:]):
                mesh, label, over = (
                    self.capture.templates[garment.name],
                    self.scene.labels[garment.label],
                    self._over(garment.name),
                )
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    template = dress.prepare(
                        self.model, self.person, garment, label, mesh, labelled, self.config.dress, over
                    )
                for warning in caught:
                    self.status.add(stage="dress", ok=False, warning=str(warning.message))
                save_record(path, template)
        self.colours = load_record(paths[0], segment.SegmentModel, colours=ColourModel)
        self.templates = tuple(load_record(p, GarmentTemplate, ("loops",)) for p in paths[1:])
        self.dressers = {
            t.name: dress.Dresser(self.model, self.person, t, self.config.dress, self._over(t.name))
            for t in self.templates
        }

    def _over(self, name):
        """Label ids of the garments that are worn over a garment."""
        names = [g.name for g in self.scene.garments]
        return [self.scene.labels[g.label] for g in self.scene.garments[names.index(name) + 1 :]]

    def _segment(self, colours, frame, tracked, previous):
        """(Segmented, Evidence) of a frame."""
        settings, faces = self.config.segment, self.model.f
        evidence = segment.evidence(frame, self.capture.cameras, colours, tracked, faces, settings)
        return segment.segment(self.scene, evidence, colours, tracked, faces, settings, previous), evidence

    # Every frame: track, segment, dress -------------------------------------------------------------------------

    def _first_pass(self):
        own = blocks(self.frames)[self.shard[0] - 1 :: self.shard[1]]
        stage, total = "track, segment, dress" if self.templates else "track", sum(map(len, own))
        for i, _ in enumerate(self._each("first_block", own)):
            self.progress(stage, i + 1, total)

    def first_block(self, numbers):
        """The first stages of one block's frames, in their order; frames that the store has are passed over."""
        left, last = set(self._left()), None
        for number in numbers:
            if number in left and not self._first_done(number):
                self._first_stages(number, last if number - 1 == last else None)
            last = number
            yield number

    def _first_done(self, number):
        return any((self._folder(number) / name).exists() for name in ("whole", "failed.json"))

    def _folder(self, number):
        return self.work / "frames" / f"{number:06d}"

    def _first_stages(self, number, previous):
        """Makes a frame's Tracked, Segmented and Dressed; `previous` names the frame whose results give temporal state."""
        folder = self._folder(number)
        try:
            known = previous is not None and (self._folder(previous) / "whole").exists()
            before = self._load_first_stages(self._folder(previous)) if known else None
            self._make_first_stages(number, before, folder)
        except FRAME_ERRORS as error:
            self._fail(number, error)
        else:
            write_text(folder / "whole", "")

    def _make_first_stages(self, number, before, folder):
        frame, seconds = self.capture.frame(number), {}

        def timed(stage, make):
            start = time.perf_counter()
            result = make()
            seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
            return result

        points = timed("reconstruct", lambda: self._points(frame))
        tracked = timed("track", lambda: self.tracker.track(frame, points, before and before[0]))
        save_record(folder / "track.npz", tracked)
        if self.templates:
            previous = before and before[1]
            segmented, evidence = timed("segment", lambda: self._segment(self.colours, frame, tracked, previous))
            save_record(folder / "segment.npz", segmented)
            for name, dresser in self.dressers.items():
                dressed = timed("dress", lambda: dresser.dress(frame, tracked, segmented, evidence))
                save_record(folder / f"dress.{name}.npz", dressed)
        for stage, value in seconds.items():
            self.status.add(frame=number, stage=stage, seconds=value, ok=True)

    def _load_first_stages(self, folder):
        tracked = load_record(folder / "track.npz", Tracked)
        if not self.templates:
            return tracked, None, {}
        dressed = {t.name: load_record(folder / f"dress.{t.name}.npz", Dressed) for t in self.templates}
        return tracked, _load_segmented(folder / "segment.npz"), dressed

    def _fail(self, number, error):
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        write_text(self._folder(number) / "failed.json", json.dumps({"reason": reason}))
        self.status.add(frame=number, stage="frame", seconds=0.0, ok=False, reason=reason)

    # Inner layer and the store ----------------------------------------------------------------------------------

    def _fuse(self):
        def make():
            good = [n for n in self.frames if (self._folder(n) / "whole").exists()]
            if not good:
                return InnerShape(self.person.rest, {})
            chosen = evenly(good, self.config.preparation_frames)
            samples = [self._load_first_stages(self._folder(n)) for n in chosen]
            return inner.prepare(self.model, self.person, samples, self.templates, self.config.inner)

        self._kept("inner", InnerShape, make)

    @cached_property
    def inner(self):
        shape = load_record(self.prepared / "inner.npz", InnerShape)
        return inner.InnerLayer(self.model, self.person, shape, self.templates, self.config.inner)

    def _last_pass(self):
        if not self.store.exists():
            create_store(self.store, self.frames, self.scene, self.model, self.person, self.templates)
        left = [(number,) for number in self._left()]
        for i, _ in enumerate(self._each("last_frames", left)):
            self.progress(
                "inner" if self.templates else "store", len(self.frames) - len(left) + i + 1, len(self.frames)
            )

    def last_frames(self, numbers):
        """The inner layer of these frames, and their arrays to the store: a chunk a frame, so each process writes its own."""
        registered = Registered(self.store)
        for number in numbers:
            self._finish(registered, number)
            yield number

    def _finish(self, registered, number):
        folder, values, diagnostics = self._folder(number), None, {}
        if (folder / "whole").exists():
            try:
                values, diagnostics = self._values(number, *self._load_first_stages(folder))
            except FRAME_ERRORS as error:
                self._fail(number, error)
        if values is None:
            diagnostics = json.loads((folder / "failed.json").read_text(encoding="utf-8"))
        write_text(self.run / "diagnostics" / f"{number:06d}.json", json.dumps(diagnostics, indent=1))
        registered.write(number, values or {}, FAILED if values is None else OK)

    def _write_diagnostics(self, registered):
        """What every stage measured of itself, and its seconds, a frame."""
        table = {}
        for number in self.frames:
            stages = json.loads((self.run / "diagnostics" / f"{number:06d}.json").read_text(encoding="utf-8"))
            table[number] = {} if "reason" in stages else {stage.replace(" ", "."): v for stage, v in stages.items()}
        for line in self.status.lines():
            if line.get("ok") and line.get("frame") in table:
                table[line["frame"]].setdefault("seconds", {})[line["stage"]] = line["seconds"]
        registered.write_diagnostics(table)

    def _values(self, number, tracked, segmented, dressed):
        """The store's arrays of one frame, and its diagnostics by stage."""
        if not self.templates:
            return frame_arrays(self.scene, tracked)
        start = time.perf_counter()
        layer = self.inner.solve(tracked, segmented, dressed)
        self.status.add(frame=number, stage="inner", seconds=time.perf_counter() - start, ok=True)
        return frame_arrays(self.scene, tracked, segmented, dressed, layer)

    def _outcome(self):
        failed, contact, pending = {}, [], self._left()
        for number in self.frames:
            reason = self._folder(number) / "failed.json"
            if reason.exists():
                failed[number] = json.loads(reason.read_text(encoding="utf-8"))["reason"]
            elif number not in pending:
                diagnostics = json.loads((self.run / "diagnostics" / f"{number:06d}.json").read_text(encoding="utf-8"))
                if "reason" in diagnostics:
                    failed[number] = diagnostics["reason"]
                elif any(stage.get("unsupported_contact") for stage in diagnostics.values()):
                    contact.append(number)
        pending = tuple(f for f in pending if f not in failed)
        ok = tuple(f for f in self.frames if f not in failed and f not in pending)
        return Outcome(ok, failed, tuple(contact), tuple(self.status.warnings()), pending)
