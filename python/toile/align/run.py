"""`toile align RUN RUN2`: a run whose garments have slid along their surfaces until their prints lie as in the anchors.

prepare   the reference print of each garment            match   every pictured frame, in chunks of 50 frame numbers
write     the new run, once all chunks are done           report  the textures before and after

Chunks share nothing but the reference, so that shards and workers may take any of them; results lie in RUN2/slides, so that
a killed alignment goes on with the same bits.
"""

from __future__ import annotations

import json
import shutil
import time
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..io.files import load_record, replace_file, save_record, write_text
from ..io.run import OK, PENDING, Status
from ..kernels import InputError, SolveError
from ..pipeline.blocks import Workers, locked
from ..pipeline.plan import blocks
from ..surface.layering import Layering
from ..surface.layers import capture_of, open_body, pictured_frames, read_layers
from .matching import Matched, Matcher
from .prints import Places, PrintReader, blended, camera_offsets
from .reference import Reference, anchors_and_samples, make_reference
from .report import write_report
from .settings import AlignSettings
from .sliding import SlidingSurface
from .smoothing import over_time

FRAME_ERRORS = (UserError, InputError, SolveError, OSError, np.linalg.LinAlgError)
NEAR = 10  # frame numbers within which a frame starts from the one before


@dataclass(frozen=True)
class Alignment:
    """Frames aligned by their own pictures, frames without pictures between them, frames whose pictures could not be used
    with why, frames that wait for other shards; whether the new run is whole."""

    matched: tuple[int, ...]
    between: tuple[int, ...]
    failed: dict[int, str]
    pending: tuple[int, ...]
    whole: bool


def align(run, out, settings=None, workers=1, shard=(1, 1), progress=None):
    """Aligns the garments of a registered run into the run `out`; returns an Alignment. UserError: it cannot be done.

    The same call on what was killed goes on where it stood. `shard` (i, n) takes every n-th chunk from the i-th on;
    whichever ends last writes the run. The bits depend on neither workers nor shards. `progress(stage, done, total)`."""
    run, out, settings = Path(run), Path(out), settings or AlignSettings()
    if workers < 1 or not 1 <= shard[0] <= shard[1]:
        raise UserError(f"workers {workers}, shard {shard[0]}/{shard[1]}: expected at least one worker and 1 <= i <= n")
    _check(run, out)
    open_aligned(run, out, settings)
    return _Align(run, out, settings, progress or (lambda *_: None), workers, shard).go()


def _check(run, out):
    body = open_body(run)
    if out.resolve() == run.resolve():
        raise UserError(f"{out}: the aligned run needs a folder of its own")
    if not body.store.attrs["scene"]["garments"]:
        raise UserError(f"{run}: the scene names no garment, there is nothing to align")
    if (body.store["done"][:] == PENDING).any():
        raise UserError(f"{run}: frames are pending, end its registration first")
    if not pictured_frames(run):
        raise UserError(f"{run}: no registered frame has pictures, prints cannot be aligned")


def open_aligned(run, out, settings):
    """Makes OUT with its config.toml, or checks that it is of the same run and settings."""
    import tomli_w

    from .. import __version__

    config = tomllib.loads((run / "config.toml").read_text(encoding="utf-8"))
    done = open_body(run).store["done"][:]
    asked = {
        "run": str(run.resolve()),
        "frames_ok": int((done == OK).sum()),
        "toile": __version__,
        "settings": settings.model_dump(mode="json"),
    }
    text, path = tomli_w.dumps(config | {"align": asked}), out / "config.toml"
    if (
        out.exists()
        and not path.exists()
        and any(not p.name.startswith((".lock", ".config.toml")) for p in out.iterdir())
    ):
        raise UserError(f"{out}: the folder is not empty and holds no run")
    with locked(out):
        if not path.exists():
            if (run / "status.jsonl").exists():
                shutil.copyfile(run / "status.jsonl", out / "status.jsonl")
            write_text(path, text)
        elif tomllib.loads(path.read_text(encoding="utf-8")) != tomllib.loads(text):
            raise UserError(f"{path}: this run was aligned from another run or with other settings")


def _worker(run, out, settings):
    return _Align(run, out, settings, lambda *_: None).opened()


class _Align:
    def __init__(self, run, out, settings, progress, workers=1, shard=(1, 1)):
        self.run, self.out, self.settings, self.progress, self.shard = run, out, settings, progress, shard
        self.body, self.capture = open_body(run), capture_of(run)
        self.status = Status(out / "status.jsonl")
        self.frames = [int(n) for n in self.body.store["frames"][:][self.body.rows()]]
        self.pictured = pictured_frames(run)
        self.garments = [g["name"] for g in self.body.store.attrs["scene"]["garments"]]
        self.workers = Workers(workers, _worker, run, out, settings) if workers > 1 else None

    def go(self):
        try:
            if not self._whole():
                with locked(self.out):
                    self._prepare()
                own = blocks(self.pictured)[self.shard[0] - 1 :: self.shard[1]]
                total = sum(map(len, own))
                for i, _ in enumerate(self._each(own)):
                    self.progress("match", i + 1, total)
                with locked(self.out):
                    if not self._whole() and all(self._done(n) for n in self.pictured):
                        self._write()
            with locked(self.out):
                if self._whole() and not (self.out / "alignment.json").exists():
                    matched = [n for n in self.pictured if (self._folder(n) / "whole").exists()]
                    write_report(self.run, self.out, matched or self.pictured, self.progress)
            return self._outcome()
        finally:
            if self.workers:
                self.workers.close()

    def opened(self):
        self._prepare()
        return self

    def _whole(self):
        return (self.out / "registered.zarr").exists()

    def _each(self, own):
        if self.workers and len(own) > 1:
            yield from self.workers.each("chunk", own)
        else:
            for numbers in own:
                yield from self.chunk(numbers)

    # Preparation: one reference a garment ------------------------------------------------------------------------

    def _prepare(self):
        layers = read_layers(self.run)
        paths = {name: self.out / "reference" / f"{name}.npz" for name in self.garments}
        rests = {n: load_record(p, Reference).rest for n, p in paths.items() if p.exists()}
        layers = [_at_rest(layer, rests.get(layer.name)) for layer in layers]
        of = {layer.name: layer for layer in layers}
        surfaces = {
            n: SlidingSurface(of[n].rest, of[n].faces, of[n].loops.values(), self.settings.lattice_spacing)
            for n in self.garments
        }
        templates = {n: self._template(of[n]) for n in self.garments}
        sizes = [(n, s.faces, len(s.rest)) for n, s in surfaces.items()]
        self.layering = Layering(
            self.body.model.skin_faces, len(self.body.model.v_template), sizes, self.settings.margin
        )
        self.matchers = {n: Matcher(s, templates[n], self.settings) for n, s in surfaces.items()}
        places = {n: Places(of[n], s.lattice.face, s.lattice.bary) for n, s in surfaces.items()}
        self.reader = PrintReader(self.body, self.capture, layers, places)
        if any(not p.exists() for p in paths.values()):
            self._make_references(paths, of)
        self.references = {n: load_record(p, Reference) for n, p in paths.items()}
        self.onto = {n: self.matchers[n].target(r.values, r.weights) for n, r in self.references.items()}

    def _template(self, layer):
        """Vertices of the capture's template, whose lengths the cloth keeps."""
        mesh = self.capture.templates[layer.name]
        if not np.array_equal(mesh.faces, layer.faces):
            raise UserError(
                f"{self.capture.root}: the template of {layer.name} is not the one that {self.run} registered"
            )
        return mesh.vertices

    def _make_references(self, paths, layers):
        anchors, samples = anchors_and_samples(
            self.pictured, blocks(self.pictured)[0], self.settings.anchor_frames, self.settings.sample_frames
        )
        views = []
        for k, number in enumerate([*anchors, *samples]):
            views.append(self.reader.views(number))
            self.progress("reference", k + 1, len(anchors) + len(samples) + 1)
        for name, matcher in self.matchers.items():
            mine, points = [v[name] for v in views], len(matcher.surface.lattice)
            offsets = camera_offsets(mine, points)
            pyramids = [matcher.pyramid(*blended(v, offsets, points)) for v in mine]
            posed = [self.reader.vertices(number, name) for number in [*anchors, *samples]]
            values, weights = make_reference(matcher, pyramids, posed, len(anchors), self.settings.mean_rounds)
            save_record(paths[name], Reference(layers[name].rest, values, weights, offsets))
        self.progress("reference", len(views) + 1, len(views) + 1)

    # Every pictured frame ----------------------------------------------------------------------------------------

    def _folder(self, number):
        return self.out / "slides" / f"{number:06d}"

    def _done(self, number):
        return any((self._folder(number) / name).exists() for name in ("whole", "failed.json"))

    def chunk(self, numbers):
        """Matches one chunk's frames in their order; each starts from the one before it."""
        last = None
        for number in numbers:
            if not self._done(number):
                try:
                    self._match(number, last if last is not None and number - last <= NEAR else None)
                except FRAME_ERRORS as error:
                    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
                    write_text(self._folder(number) / "failed.json", json.dumps({"reason": reason}))
                    self.status.add(frame=number, stage="align", seconds=0.0, ok=False, reason=reason)
            if (self._folder(number) / "whole").exists():
                last = number
            yield number

    def _match(self, number, previous):
        start, views = time.perf_counter(), self.reader.views(number)
        for name, matcher in self.matchers.items():
            pyramid = matcher.pyramid(
                *blended(views[name], self.references[name].offsets, len(matcher.surface.lattice))
            )
            first = None if previous is None else self._matched(previous, name).d
            matched = matcher.match(pyramid, self.onto[name], self.reader.vertices(number, name), first)
            save_record(self._folder(number) / f"{name}.npz", matched)
        write_text(self._folder(number) / "whole", "")
        self.status.add(frame=number, stage="align", seconds=time.perf_counter() - start, ok=True)

    def _matched(self, number, name):
        return load_record(self._folder(number) / f"{name}.npz", Matched)

    # The new run -------------------------------------------------------------------------------------------------

    def _write(self):
        """A copy of the run's store in which the garments have slid; written whole."""
        import zarr

        def write(path):
            if path.exists():
                shutil.rmtree(path)
            shutil.copytree(self.run / "registered.zarr", path)
            group = zarr.open_group(str(path), mode="r+")
            for wanted in blocks(self.frames):
                slides = {name: self._slides(name, wanted) for name in self.garments}
                for k, number in enumerate(wanted):
                    self._write_frame(
                        group, self.reader.rows[number], {n: d[k] for n, d in slides.items() if d is not None}
                    )
                    self.progress("write", self.frames.index(number) + 1, len(self.frames))

        if (self.run / "diagnostics").exists():
            shutil.copytree(self.run / "diagnostics", self.out / "diagnostics", dirs_exist_ok=True)
        self._write_diagnostics()
        for left in self.out.glob(".registered.zarr.*.part"):
            shutil.rmtree(left)
        replace_file(self.out / "registered.zarr", write)

    def _slides(self, name, wanted):
        """Of one chunk's frames, None where none of them was matched."""
        known = [n for n in wanted if (self._folder(n) / "whole").exists()]
        slides = [self._matched(n, name).d for n in known]
        return over_time(known, slides, wanted, self.capture.scene.fps, self.settings)

    def _write_frame(self, group, row, slides):
        """Garments slid, and out of what lies under them where their triangles now meet it."""
        body = group["inner/vertices" if "inner/vertices" in group else "track/vertices"][row]
        cloth = {name: group[f"garment/{name}/vertices"][row] for name in self.garments}
        for name, d in slides.items():
            surface = self.matchers[name].surface
            face, bary = surface.slid(d)
            cloth[name] = surface.laid(cloth[name], face, bary)
            group[f"confidence/{name}"][row] = group[f"confidence/{name}"][row][surface.faces[face, bary.argmax(1)]]
        placed = self.layering.solve(body, cloth)
        for name, V in (placed.vertices if placed.intersections_before else cloth).items():
            if name in slides:
                group[f"garment/{name}/vertices"][row] = V

    def _write_diagnostics(self):
        for number in self.pictured:
            path = self.out / "diagnostics" / f"{number:06d}.json"
            stages = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
            if (self._folder(number) / "whole").exists():
                for name in self.garments:
                    m = self._matched(number, name)
                    slide = float(np.linalg.norm(m.d, axis=1).mean() * 1e3)
                    stages[f"align {name}"] = {
                        "misfit_before": m.before,
                        "misfit": m.after,
                        "compared": m.seen,
                        "slide_mm": slide,
                    }
            write_text(path, json.dumps(stages, indent=1))

    def _outcome(self):
        failed = {}
        for number in self.pictured:
            path = self._folder(number) / "failed.json"
            if path.exists():
                failed[number] = json.loads(path.read_text(encoding="utf-8"))["reason"]
        matched = tuple(n for n in self.pictured if (self._folder(n) / "whole").exists())
        between = tuple(n for n in self.frames if n not in set(self.pictured))
        pending = tuple(n for n in self.pictured if not self._done(n))
        return Alignment(matched, between, failed, pending, self._whole())


def _at_rest(layer, rest):
    """The layer with another rest shape, where one is given."""
    return layer if rest is None else replace(layer, rest=rest)
