"""From a run to an avatar: hold-out, data, networks, training, and the single-layer baseline under the same conditions."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from lightning_fabric import Fabric
from lightning_fabric.strategies import DDPStrategy

from ...errors import UserError
from ...frame_numbers import evenly, frame_ranges
from ...io.holdout import agreed, held, words_of
from ...io.locks import locked
from ...io.run import Run, open_run
from ...vision.unwrapping import pinhole
from ..model.avatar import Avatar
from ..model.checkpoint import ALIGNED, BASELINE, asked_before, begin, save_assets, save_avatar, topology
from ..settings import AvatarSettings
from .baseline import train_baseline
from .data import AvatarData, registration_of, shown
from .training import Training, draw

HELD_OUT = 0.1  # of the pictured frames, the last ones
BEGUN = (
    ALIGNED,
    "cache",
    "evaluation",
    BASELINE,
)  # what may lie in AVATAR before it, begun or shared, beside hidden files
ASSETS = (
    "layers", "J", "parents", "cameras", "scene", "mean_texture", "valid", "face_mean", "head", "poses", "light", "mean_light",
)  # fmt: skip
FITTED = 50  # frames that the crop is fitted to
MARGIN = 4  # about the person in the crop [px of the capture]


@dataclass
class Request:
    """What is asked of a training."""

    run: Path
    settings: AvatarSettings
    minutes: float | None = None  # for the layered avatar, once it is aligned; the baseline takes as many steps
    holdout: str | None = None  # "A-B", inclusive frame numbers, or "none"; None: the last tenth
    progress: Callable = lambda stage, done, total, note: None
    say: Callable = print
    still: Callable = lambda run, folder: run  # gives the Run to learn of the one that is asked for, perhaps aligned
    warn: Callable = print


def make_avatar(request, folder, baseline=False):
    """Trains AVATAR, and with `baseline` AVATAR/baseline; goes on where a killed training stood."""
    folder, fabric = Path(folder), start_fabric()
    run = open_run(request.run)
    refuse_other(folder)
    left_out = left_out_frames(request.holdout, folder, run)
    frames = [number for number in run.pictured if number not in left_out]
    if not frames:
        raise UserError(f"{request.run}: the hold-out leaves no pictured frame to train on")
    for words in filter(None, (run.judgement, run.outdated)):
        request.say(words)
    registered, run = run, request.still(run, folder)
    begun = time.monotonic()
    if left_out and not run.holdout:
        read = "registration" if run is registered else "registration, and aligning it,"
        request.say(f"{registered.path}: its {read} has read the frames held out, {frame_ranges(left_out)}")
    seconds = None if request.minutes is None else 60 * request.minutes
    settings = request.settings
    if settings.fit_crop:
        data = settings.data.model_copy(update={"pixel_scale": fitting_scale(run, settings.data, frames)})
        settings = settings.model_copy(update={"data": data})
    waits = partial(request.say, f"{folder}: another process trains it: this one goes on when that ends")
    with locked(folder, waits) if fabric.is_global_zero else nullcontext(), deterministic(fabric):
        job = TrainingJob(run, request, fabric, frames, left_out)
        job.train(folder, settings, begun=begun, seconds=seconds)
        if baseline:
            train_baseline(job, folder)


def refuse_other(folder):
    """UserError where `folder` holds something that is no avatar, nor one that was begun."""
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    other = [name for name in names if name not in BEGUN and not name.startswith(".")]
    if other and "avatar.json" not in names:
        raise UserError(f"{folder}: holds {min(other)} and no avatar: take another folder")


@dataclass
class TrainingJob:
    """Trainings on the same frames."""

    run: Run
    request: Request
    fabric: Fabric
    frames: list[int]
    held: list[int]
    known: list[int] | None = None  # frames whose cache is shared, by default these

    def train(self, folder, settings, title="", layered=True, cache=None, begun=None, seconds=None, **notes):
        """One avatar, layered or of one surface, in `seconds` from `begun` on where they are given."""
        fabric, request = self.fabric, self.request

        def progress(stage, *args):
            request.progress(f"{title} {stage}".strip(), *args)

        with fabric.rank_zero_first():
            place = cache or folder / "cache"
            shared = {"known": self.known, "left_out": self.held}
            data = AvatarData(self.run, settings.data, place, self.frames, layered, **shared)
        torch.manual_seed(draw(settings.seed, "weights"))
        avatar = Avatar(settings, **{name: getattr(data, name) for name in ASSETS})
        facts = {
            "scene": data.scene.name,
            "run": str(self.run.path.resolve()),
            "topology": topology(data.layers, data.scene, data.cameras),
            "frames": list(self.frames),
            "holdout": list(self.held),
            "layered": layered,
            "settings": settings.model_dump(mode="json"),
            "registration": registration_of(self.run, self.frames),
            "pictures": asked_before(folder).get("pictures", data.pictures),  # those that the training began with
        }
        with fabric.rank_zero_first():
            unfinished = begin(folder, facts)
        if layered and fabric.is_global_zero:  # the baseline's pictures are the same
            for words in data.warnings + changed_pictures(folder, facts, data):
                request.warn(words)
        if not unfinished:
            return request.say(f"{folder}: already trained")
        share = data.light_explains
        if share is not None and share <= 0:
            request.say(
                "light: how texels change is not explained by how they turn: drawn as if it came evenly from everywhere"
            )
        if fabric.is_global_zero:
            save_assets(folder, data)
        phases = list(settings.phases(layered))
        training = Training(folder, avatar, data, settings, phases, fabric, progress, request.say, begun, seconds)
        steps = training.run()
        if fabric.is_global_zero:
            found = {"architecture": avatar.describe(), "steps": steps, "light_explains": share}
            save_avatar(folder, avatar, facts | notes | found)
        fabric.barrier()


def changed_pictures(folder, facts, data):
    """What a user should know where a training in `folder` began with other pictures than those of `data`."""
    if facts["pictures"] == data.pictures:
        return []
    told = f"pictures, masks or labels have other sizes or times than when {folder} began to learn them"
    return [f"{data.capture.root}: {told}: if they show something else, train into another folder"]


def left_out_frames(text, folder, run):
    """The frames held out of the training of AVATAR `folder`: as asked by `text`; where that is None those of the run, and of one
    that holds none out those that the avatar was asked for before, or by default. UserError: the run has no pictures, or as `held_out` says."""
    if not run.pictured:
        raise UserError(f"{run.path}: no registered frame has pictures, and an avatar is trained on them")
    earlier = asked_before(folder).get("holdout")
    if text is None and not run.holdout and earlier is not None:
        return earlier
    return held_out(text, run.pictured, run.holdout, run.path)


def held_out(text, frames, own=(), of="the run"):
    """The frames of "A-B" among the pictured ones of a run `of`; for None those of the span that it was registered with, or of
    one without the last tenth, at least one of several. UserError: it has its `own`, and another is asked for."""
    if text is None and not own:
        return frames[len(frames) - max(round(len(frames) * HELD_OUT), 1) :] if len(frames) > 1 else []
    span = agreed(text, own, of)
    found = [number for number in frames if number in held(span)]
    if span and not found:
        there = f"none of the run's pictured frames {frames[0]}-{frames[-1]} lies there"
        raise UserError(f"--holdout {words_of(span)}: {there}")
    return found


def fitting_scale(run, settings, frames):
    """Pixels of the capture along one of the crop's, at least those of the settings, so that it holds the person, its
    garments or head, in every picture of (a spread of) the frames."""
    rows, scale = run.rows(frames), settings.pixel_scale
    for row in evenly(rows, FITTED):
        V = shown(run, settings, row)
        for camera in run.capture.cameras.values():
            uv, depth = pinhole(camera).project(V)
            uv = np.clip(uv[depth > 0], 0, [camera.width, camera.height])
            if len(uv):
                width, height = np.ptp(uv, axis=0) + 2 * MARGIN
                scale = max(scale, height / settings.image[0], width / settings.image[1])
    return math.ceil(100 * scale - 1e-6) / 100  # asked again of what it gave, it gives the same


def start_fabric():
    """One device, or as many as torchrun started processes. Which products are rounded is the Objective's choice: a Fabric of
    mixed precision would round batches too, vertices by millimetres."""
    local, world = int(os.environ.get("LOCAL_WORLD_SIZE", 1)), int(os.environ.get("WORLD_SIZE", 1))
    fabric = Fabric(
        accelerator="cuda" if torch.cuda.is_available() else "cpu",
        devices=local,
        num_nodes=world // local,
        strategy=DDPStrategy(find_unused_parameters=True) if world > 1 else "auto",
    )
    fabric.launch()
    return fabric


@contextmanager
def deterministic(fabric):
    """On the CPU the same bits from run to run: torch's parallel sums of gradients are otherwise in no order."""
    from torch.utils import deterministic as extra

    before = torch.are_deterministic_algorithms_enabled(), extra.fill_uninitialized_memory
    torch.use_deterministic_algorithms(before[0] or fabric.device.type == "cpu", warn_only=True)
    extra.fill_uninitialized_memory = False  # nothing is read here before it is written, and filling costs a sixth
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before[0])
        extra.fill_uninitialized_memory = before[1]
