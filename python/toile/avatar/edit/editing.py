"""From an avatar to one with a changed garment, and the same change of its single-layer baseline: docs/method/animation.md."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...io.bounded import read_json
from ...io.files import copy_file, copy_folder, whole_folder, write_text
from ...io.image import read_rgba
from ...io.run import open_run
from ...io.run_folder import body_model_of
from ..drive.draping import carry_cloths
from ..measure.heldout import run_of
from ..model.checkpoint import load_avatar, read_facts
from ..model.edits import LUMA, load_edits, save_edits
from ..model.networks import resize
from . import paint
from .marking import edit_of_surface, mark

BRIGHTEST = 16.0  # factor of a colour
KEPT = ("avatar.json", "avatar.safetensors", "temporal.safetensors")  # of an avatar's folder, with assets/


@dataclass(frozen=True)
class Change:
    """What is asked of a garment's texture: exactly one of scale, checker, image, text; `at` and `size` go with the latter two."""

    garment: str
    scale: str | None = None  # "R,G,B"
    checker: int | None = None  # squares along a side of the UV square
    image: Path | None = None
    text: str | None = None
    at: str | None = None  # "U,V"
    size: float | None = None  # width, a share of the UV square's side

    def check(self):
        """UserError: not one change, or options that do not go with it."""
        given = [f"--{name}" for name in ("scale", "checker", "image", "text") if getattr(self, name) is not None]
        if len(given) != 1:
            found = "none is given" if not given else f"{' and '.join(given)} are given"
            raise UserError(f"edit: expected one of --scale, --checker, --image, --text: {found}")
        if given[0] in ("--scale", "--checker"):
            for option, value in (("--at", self.at), ("--size", self.size)):
                if value is not None:
                    raise UserError(f"{option} {value}: {given[0]} changes the whole garment, it has no place")
        if self.size is not None and not 0 < self.size <= 1:
            raise UserError(f"--size {self.size:g}: expected a share of the texture's side, above 0 and at most 1")


@dataclass(frozen=True)
class Edited:
    """What was made."""

    words: str
    baseline: bool
    measured: dict | None  # `sheet.compare`'s; None where no sheet was asked for


def edit(folder, out, change, frames=None, run=None, sheet=True, progress=lambda *_: None):
    """Writes the avatar `folder` with a Change into the new folder `out`, which appears once it is whole, and with
    `sheet` edit.png and edit.json: layered and baseline in some `frames` of its run.

    Whatever the avatar showed before, earlier edits included, is what is changed. Its baseline gets the same edit where
    the garment lies on it in the first trained frame. `run`: where the run is now, if it was moved. UserError: one
    line that names what is wrong.
    """
    change.check()
    folder, facts = Path(folder), read_facts(folder)
    if not facts["layered"]:
        raise UserError(f"{folder}: a single layer has no garment: edit the layered avatar, its baseline goes along")
    avatar, baseline = load_avatar(folder), (folder / "baseline" / "avatar.json").exists()
    layer = garment_of(avatar, change.garment)
    run = run_of(folder, facts, run) if sheet or baseline else Path(run or facts["run"])
    made = garment_edit(avatar, layer, change, run)
    marked = measured = None
    if baseline:
        (surface,) = load_avatar(folder / "baseline").layers
        marked = marked_baseline(surface, layer, run, facts["frames"][0])
    with whole_folder(out) as part:
        add_edit(folder, part, made)
        if marked is not None:
            add_edit(folder / "baseline", part / "baseline", edit_of_surface(made, surface, marked))
        if sheet:
            from .sheet import compare

            measured = compare(part, folder, layer, made, marked, frames, run, progress)
            write_text(part / "edit.json", json.dumps({"edit": made.words, "garment": layer.name} | measured, indent=1))
    return Edited(made.words, marked is not None, measured)


def garment_of(avatar, name):
    """The Layer of a garment."""
    garments = {layer.name: layer for layer in avatar.layers if layer.kind == "garment"}
    if name not in garments:
        raise UserError(f"--garment {name}: the avatar has {', '.join(garments) or 'no garment'}")
    return garments[name]


def garment_edit(avatar, layer, change, run):
    """The Edit of a garment's layer that a Change asks for."""
    decoded = avatar.settings.data.texture_size
    size = max(decoded, paint.FINE)
    if change.scale is not None:
        scale = numbers("--scale", change.scale, "three numbers R,G,B", 3)
        if not all(0 <= s <= BRIGHTEST for s in scale):
            raise UserError(f"--scale {change.scale}: expected factors from 0 to {BRIGHTEST:g}")
        return paint.scaled(layer, scale, decoded)
    if change.checker is not None:
        return paint.checkered(layer, change.checker, size)
    if change.image is not None:
        picture, name = read_rgba(change.image), Path(change.image).name
        if change.at is None and change.size is None:
            return paint.covering(layer, picture, name, size)
        return paint.placed(layer, picture, f"image {name}", place_of(avatar, layer, change, run), size)
    place = place_of(avatar, layer, change, run)
    return paint.placed(layer, paint.written(change.text, bright(avatar, layer)), f"text {change.text!r}", place, size)


def place_of(avatar, layer, change, run):
    """The Place that a Change asks for, or that on the garment's front."""
    up, width = avatar.up.numpy().astype(np.float64), change.size or paint.WIDTH
    if change.at is not None:
        at = numbers("--at", change.at, "two numbers U,V", 2)
        if not all(0 <= x <= 1 for x in at):
            raise UserError(f"--at {change.at}: expected numbers from 0 to 1")
        return paint.place_at(layer, at, width, up)
    roles = body_model_of(run, avatar.scene.body_model, avatar.scene.up).joint_roles
    return paint.place_in_front(layer, paint.front_of(avatar.skeleton.J.numpy(), roles, up), width, up)


def bright(avatar, layer):
    """Is what a garment usually shows, earlier edits included, nearer to white than to black?"""
    model = avatar.model(layer.name)
    shown = mean = model.mean_texture[None]
    if model.edits is not None:
        shown, _ = model.edits(mean, mean)
    luma = (resize(shown, mean.shape[-1])[0].numpy() * np.array(LUMA)[:, None, None]).sum(0)
    return bool(luma[model.valid[0].numpy() > 0].mean() > 0.5)


def marked_baseline(surface, layer, run, frame):
    """What of the baseline's UVs shows the garment in a frame of the run."""
    opened = open_run(run)
    if frame not in opened.ok or layer.name not in opened.garments:
        raise UserError(f"{run}: frame {frame} with the garment {layer.name} is not there: is it the avatar's run?")
    V, G = opened.track.at(frame), opened.garments[layer.name].at(frame)
    if len(V) != len(surface.rest) or len(G) != len(layer.rest):
        has = f"{len(surface.rest)} and {len(layer.rest)}"
        raise UserError(f"{run}: its surface and {layer.name} have {len(V)} and {len(G)} vertices, the avatar's {has}")
    return mark(surface, V, layer, G, paint.FINE)


def add_edit(folder, out, made):
    """A copy of an avatar's folder, what was trained, its assets and cloth alone, with one more edit."""
    edits, facts = [*load_edits(folder), made], read_json(folder / "avatar.json")
    copy_folder(folder / "assets", out / "assets")
    for name in KEPT:
        if (folder / name).exists():
            copy_file(folder / name, out / name)
    save_edits(out, edits)
    words = [f"{edit.garment}: {edit.words}" for edit in edits]
    write_text(out / "avatar.json", json.dumps(facts | {"edits": words}, indent=1))
    carry_cloths(folder, out)


def numbers(option, text, expected, count):
    """ "1,0.5,0" -> floats."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(map(math.isfinite, values)):
        raise UserError(f"{option} {text}: expected {expected}")
    return values
