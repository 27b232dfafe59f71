"""Motions of other people on an avatar: limbs stay out of its trunk (docs/method/animation.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...frame_numbers import rate_of, stride_of
from ...io.motion import Motion, read_motion
from ...io.run import is_run
from ...io.run_folder import body_model_of
from ...surface.apart import Apart, keep_apart
from ...surface.limbs import Limbs
from ...surface.wrapping import wrapping
from ..model.assets import training_poses
from ..model.checkpoint import load_avatar, read_facts
from .driver import FILE, REACH, load_driver, stride_at


@dataclass(frozen=True)
class Taken:
    """A motion as an avatar takes it; `apart`: what was done to its limbs, None where they go as given."""

    motion: Motion
    apart: Apart | None = None


def take(folder, path, apart, garments=(), physics=False, frames=None, progress=lambda stage, done, total: None):
    """Taken of the motion at `path` for the avatar in `folder`. `apart`: limbs are kept out of the trunk and of one another, unless
    the motion is the run that taught the avatar, whose poses were seen; with room for the garments that it wears over one another,
    lent ones (`garments`) not counted; where only `frames` of it are shown, as far as these depend on it, see `rows_read`. UserError
    names the file and the field."""
    motion = motion_of(folder, path)
    if not apart or (is_run(Path(path)) and _taught(folder, motion)):
        return Taken(motion)
    avatar = load_avatar(folder)
    needed = None
    if frames is not None:
        needed = rows_read(folder, motion, dict(garments), physics, np.isin(motion.frames, list(frames)))
    skin, *worn = moving_layers(avatar, folder)
    limbs = Limbs(_body_model(folder, avatar), skin.rest, _joints(avatar), wrapping(skin.rest, skin.faces, worn))
    kept = keep_apart(limbs, motion.frames, motion.rotations, motion.translation, motion.fps, needed, progress)
    return Taken(replace(motion, rotations=kept.rotations), kept)


def _taught(folder, motion):
    """Whether a run's Motion is what taught the avatar in `folder`: it has the same poses in the same frames, to the bit. So it has if it
    was moved since, and if it is the one that the avatar's was aligned from."""
    rows = np.isin(motion.frames, read_facts(folder)["frames"])
    return np.array_equal(motion.rotations[rows], training_poses(folder)["rotations"])


def motion_of(folder, path):
    """The Motion at `path` for the avatar in `folder`, as it is given."""
    avatar, start = load_avatar(folder), training_poses(folder)["translation"].mean(0)
    model, scene = _body_model(folder, avatar), avatar.scene
    motion = read_motion(Path(path), model, _joints(avatar), scene.fps, start, scene.up)
    check_face(avatar, motion, path)
    return motion


def check_face(avatar, motion, source):
    """UserError, which names the `source`, where a Motion's facial keypoints are not the avatar's."""
    mean, face = getattr(avatar, "face_mean", None), motion.face
    if mean is not None and len(mean) and face is not None and face.shape[1:] != tuple(mean.shape):
        raise UserError(f"{source}: face is {face.shape}, expected {(len(face), *mean.shape)}")


def _body_model(folder, avatar):
    return body_model_of(read_facts(folder)["run"], avatar.scene.body_model, avatar.scene.up)


def _joints(avatar):
    return avatar.skeleton.J.numpy().astype(np.float64)


def moving_layers(avatar, folder):
    """Layers of what must not run through itself, the skin first: a single layer moves as the avatar that it is the baseline of, or
    without one as its own surface."""
    layers, above = avatar.layers, Path(folder).parent
    if all(layer.kind == "surface" for layer in layers) and (above / "avatar.json").is_file():
        layers = load_avatar(above).layers
    return sorted(layers, key=lambda layer: layer.kind == "garment")


def rows_read(folder, motion, garments, physics, shown):
    """(T,) bool: rows of a Motion that the codes of those `shown` (T,) are read from. A window looks back, smoothing over time both
    ways; a damped model and cloth by physics have seen all that was before. `garments` {name: folder of another avatar}."""
    ahead = int(REACH * rate_of(motion.frames, motion.fps))
    back = max(_rows_back(place, motion) for place in (folder, *garments.values()))
    back, needed = len(shown) if physics else back + ahead, np.zeros(len(shown), bool)
    for row in np.flatnonzero(shown):
        needed[max(row - back, 0) : row + ahead + 1] = True
    return needed


def _rows_back(folder, motion):
    """How many rows before its own the temporal model of an avatar's folder reads for a code."""
    if not (Path(folder) / FILE).exists():
        return 0
    driver, stride, _ = load_driver(folder)
    if driver.settings.model != "window":
        return len(motion)
    stride = stride_at(motion.fps, stride, load_avatar(folder).scene.fps)
    return (driver.settings.window - 1) * stride // (stride_of(motion.frames) or 1)
