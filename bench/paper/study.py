"""The paper's comparisons: captures -> runs -> avatars -> driven avatars -> errors, ablations, pictures, one page.

Everything lies in one folder, and what lies there is not made again: what was stopped goes on, and several processes may
work on different captures in one folder.
    OUT/captures/NAME         made by the studio where no capture is named
    OUT/NAME/{run, aligned}   OUT/NAME/cache   samples that all avatars of the subject share
    OUT/NAME/seed0/           the avatar, its baseline/, its temporal model, its cloth; reconstruction.json, driven.json (by codes alone,
                              as the paper drives), shown.json (as `toile animate` shows it); a trained avatar that lies there, or that a
                              link there leads to, is taken as it is
    OUT/NAME/figures/         of the first seed: cloth moved out of the body, edits
    OUT/NAME/ablations/ROW/   the same without one part, trained for as many steps
    OUT/{index.html, paper.json, tables.md}
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from toile.avatar.settings import AvatarSettings, TemporalSettings, preset
from toile.avatar.train.make import held_out
from toile.io.holdout import span_of
from toile.io.run import is_run, open_run
from toile.io.run_folder import capture_folder

from .made import facts_seed, finished, link, once, studio_options, threads, toile, training_seconds
from .page import write
from .results import ALIGNED, DAMPED, FULL, SWITCHES, UNALIGNED, changed, read, slug

LINKED = (
    "avatar.json",
    "avatar.safetensors",
    "assets",
    "cache",
    "evaluation",
)  # of an avatar that another model drives


@dataclass(frozen=True)
class Paper:
    """What is measured."""

    out: Path
    captures: tuple[Path, ...]  # or runs of them
    seeds: tuple[int, ...] = (0,)
    settings: AvatarSettings = field(default_factory=AvatarSettings)  # whose seed is replaced
    temporal: TemporalSettings = field(default_factory=TemporalSettings)
    registration: str = "standard"
    frames: str | None = None  # of each capture, as in `toile register --frames`
    holdout: str | None = None  # "A-B"
    minutes: float | None = None  # of each layered training; everything else takes as many steps
    align: str = "none"  # which runs are aligned by their textures: "none", those of the "ablation", or "all"
    ablated: str | None = None  # name of the capture that is ablated
    ablation_steps: tuple[int, int, int] | None = None  # body, garment, joint; those of the full avatar by default
    windows: tuple[int, ...] = (1, 3, 8, 15, 30)
    qualities: tuple[str, ...] = ()
    quality_minutes: float = 30.0
    workers: int = 1
    say: Callable = print
    progress: Callable = lambda stage, done, total, note="": None
    ready: Callable = lambda capture: None  # waits for one that is being made

    def run(self):
        """All of it; the page is written anew after each avatar."""
        names = [capture.name for capture in self.captures]
        for name in names:
            if names.count(name) > 1:
                raise SystemExit(
                    f"{name}: several captures have this name, which is that of their folder in {self.out}"
                )
        for seed in self.seeds:
            for capture in self.captures:
                self.ready(capture)
                subject = Subject(self, capture)
                run = subject.registered()
                subject.avatar(subject.folder / f"seed{seed}", run, changed(self.settings, seed=seed), baseline=True)
                write(self.out)
                if seed == self.seeds[0]:
                    subject.figures(subject.folder / f"seed{seed}")
                    write(self.out)
                if capture.name == self.ablated and seed == self.seeds[0]:
                    for _ in subject.ablations():
                        write(self.out)
        return write(self.out)


class Subject:
    """One capture's part of the study, in OUT/NAME."""

    def __init__(self, paper, capture):
        given = Path(capture)
        self.paper, self.folder = paper, paper.out / given.name
        self.folder.mkdir(parents=True, exist_ok=True)
        self.given_run = is_run(given)
        self.run = given if self.given_run else self.folder / "run"
        self.capture = capture_folder(given) if self.given_run else given

    def registered(self):
        """The run that avatars are trained on."""
        once(self.folder / "run.json", self._register, self.paper.say)
        return self._aligned() if self.paper.align == "all" else self.run

    def _register(self):
        """Registers the capture unless a run was given; what both are."""
        from toile.config import preset as config
        from toile.console import frame_numbers
        from toile.io.capture import open_capture
        from toile.pipeline.run import register

        paper, opened = self.paper, open_capture(self.capture)
        if not self.given_run:
            numbers = frame_numbers(paper.frames, opened.frames)
            span = span_held_out(paper.holdout, [n for n in numbers if opened.pictured(n)])
            settings = changed(config(paper.registration), holdout=span)
            register(self.capture, self.run, settings, numbers, paper.progress, paper.workers)
        run, camera = open_run(self.run), next(iter(opened.cameras.values()))
        return {
            "capture": str(self.capture), "run": str(self.run), "registered": len(run.ok),
            "failed": len(run.frames) - len(run.ok), "fps": opened.scene.fps, "cameras": len(opened.cameras),
            "held_out": list(run.holdout), "pixels": [camera.height, camera.width], "quality": None if self.given_run else paper.registration,
            "studio": studio_options(self.capture),
        }  # fmt: skip

    def _aligned(self):
        aligned = self.folder / "aligned"

        def make():
            toile("align", self.run, aligned, "--workers", self.paper.workers)
            return {"garments": read(aligned / "alignment.json")}

        once(self.folder / "aligned.json", make, self.paper.say)
        return aligned

    def avatar(self, folder, run, settings, baseline=False, steps=None, minutes=None):
        """Trains and drives an avatar, and evaluates it on the held-out frames."""
        from toile.avatar.drive.teaching import train_temporal
        from toile.avatar.measure.evaluation import evaluate_avatar
        from toile.avatar.train.make import Request, make_avatar

        paper = self.paper
        for part in (folder, folder / "baseline") if baseline else (folder,):
            self._share_cache(part)
        if steps is not None:
            settings = changed(settings, **dict(zip(("body_steps", "garment_steps", "joint_steps"), steps)))
        minutes = paper.minutes if minutes is None and steps is None else minutes

        def train():
            there = finished(folder) and (finished(folder / "baseline") or not baseline)
            if not there:
                make_avatar(Request(run, settings, minutes, paper.holdout, paper.progress, paper.say), folder, baseline)
            facts = read(folder / "avatar.json")
            told = {"frames": len(facts["frames"]), "held_out": facts["holdout"], "minutes": minutes}
            took = {"seconds": training_seconds(folder)} if there else {}
            return {name: facts[name] for name in ("steps", "settings")} | told | took

        def drive():
            settings = paper.temporal.model_copy(update={"seed": facts_seed(folder)})
            tell = lambda *at: paper.progress("temporal", *at)
            single = {"baseline": train_temporal(folder / "baseline", settings, tell)} if baseline else {}
            return train_temporal(folder, settings, tell) | single

        once(folder / "trained.json", train, paper.say)
        if not settings.data.window:
            once(folder / "temporal.json", drive, paper.say)
        self._driven(folder, baseline)
        if baseline:
            once(folder / "cloth.json", lambda: self._cloth(folder), paper.say)
            self._shown(folder)
            once(folder / "reconstruction.json", lambda: evaluate_avatar(folder, progress=paper.progress), paper.say)

    def _driven(self, folder, baseline=False):
        """By codes alone, as the paper drives. What has a baseline is drawn as it is shown instead."""
        from toile.avatar.measure.evaluation import evaluate_avatar

        how = dict(progress=self.paper.progress, driven=True, physics=False, sheets=not baseline)
        once(folder / "driven.json", lambda: evaluate_avatar(folder, **how), self.paper.say)

    def _cloth(self, folder):
        """Measures garments as cloth; {garment: whether it hangs unasked}."""
        from toile.avatar.drive.cloths import ensure_cloths
        from toile.avatar.drive.draping import worn_cloths
        from toile.avatar.model.checkpoint import load_avatar

        ensure_cloths(folder, progress=self.paper.progress)
        layers = [layer for layer in load_avatar(folder).layers if layer.kind == "garment"]
        hung = worn_cloths(folder, layers, None)
        return {"hangs": {layer.name: layer.name in hung for layer in layers}}

    def _shown(self, folder):
        """As `toile animate` shows it unasked: garments hang as cloth where that lay nearer in training frames left out."""
        from toile.avatar.measure.evaluation import evaluate_avatar

        how = dict(progress=self.paper.progress, driven=True, physics=None)
        once(folder / "shown.json", lambda: evaluate_avatar(folder, **how), self.paper.say)

    def _share_cache(self, folder):
        folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "cache").mkdir(exist_ok=True)
        for name in ("cache", "evaluation"):
            link(folder / name, self.folder / "cache")

    def figures(self, avatar):
        """OUT/NAME/figures/*.png of a trained avatar."""
        from .figures import draw

        out = self.folder / "figures"
        once(out / "figures.json", lambda: draw(avatar, out), self.paper.say)

    def ablations(self):
        """Trains and evaluates one row after another; yields its name."""
        paper, place = self.paper, self.folder / "ablations"
        settings, run = changed(paper.settings, seed=paper.seeds[0]), self.registered()
        full, steps = self.folder / f"seed{paper.seeds[0]}", paper.ablation_steps
        once(place / "of.json", lambda: {"seed": paper.seeds[0]}, lambda text: None)
        if steps is None:
            taken = read(full / "avatar.json")["steps"]
            steps = [taken.get(phase, 0) for phase in ("body", "garment", "joint")]
        else:
            full = place / FULL
            self.avatar(full, run, settings, steps=steps)
            yield FULL
        for row in self._window_rows(full, place):
            yield row
        for row, switch in SWITCHES.items():
            self.avatar(place / slug(row), run, switch(settings, paper.temporal.window), steps=steps)
            yield row
        if paper.align != "none":
            row, other = (UNALIGNED, self.run) if paper.align == "all" else (ALIGNED, self._aligned())
            self.avatar(
                place / slug(row), other, settings, baseline=True, steps=steps
            )  # a pair of which neither is, or both are
            yield row
        self._zooms(full, place)
        yield from self._qualities(place, run)

    def _window_rows(self, full, place):
        """The full avatar driven by other temporal models."""
        from toile.avatar.drive.teaching import train_temporal

        paper = self.paper
        models = {f"L{length}": {"window": length} for length in paper.windows} | {DAMPED: {"model": DAMPED}}
        for row, change in models.items():
            folder = place / row
            folder.mkdir(parents=True, exist_ok=True)
            for name in LINKED:
                link(folder / name, full / name)
            settings = changed(paper.temporal, seed=facts_seed(full), kriged=False, **change)
            once(folder / "temporal.json", lambda: train_temporal(folder, settings), paper.say)
            self._driven(folder)
            yield row

    def _zooms(self, full, place):
        """PLACE/zooms/ROW.png: the full avatar and each that lacks a part, in one view, close up at the garment's loops."""
        from .pictures import zooms

        rows = [slug(row) for row in (*SWITCHES, UNALIGNED, ALIGNED) if (place / slug(row) / "driven.json").exists()]
        out, folders = place / "zooms", {row: place / row for row in rows}
        once(out / "zooms.json", lambda: zooms(full, folders, out), self.paper.say)

    def _qualities(self, place, run):
        """Quality presets, each trained for the same time."""
        from ..avatar_speed import measure

        for quality in self.paper.qualities:
            folder = place / f"quality {quality}"
            settings = changed(preset(quality), seed=self.paper.seeds[0])
            self.avatar(folder, run, settings, minutes=self.paper.quality_minutes)
            size = settings.data.image[0]
            once(folder / "speed.json", lambda: measure(folder, size, threads()), self.paper.say)
            yield quality


def span_held_out(asked, pictured):
    """First and last number of the frames that registration holds out: "A-B" as asked, or the last tenth of those with pictures."""
    if asked is not None:
        return span_of(asked)
    held = held_out(None, pictured)
    return (held[0], held[-1]) if held else ()
