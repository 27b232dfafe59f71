"""Motions of other people on an avatar: limbs stay out of its trunk (docs/method/animation.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...surface.apart import keep_apart
from ...surface.limbs import Limbs
from ..model.checkpoint import load_avatar


def limbs_apart(motion, folder, avatar, model, J):
    """(Motion with limbs out of the trunk and of one another, Apart) of an Avatar, read from `folder`, with joints `J` (K,3) of the
    BodyModel `model`. A single layer moves as the avatar that it is the baseline of, or without one by its own surface."""
    layers, above = avatar.layers, Path(folder).parent
    if all(layer.kind == "surface" for layer in layers) and (above / "avatar.json").is_file():
        layers = load_avatar(above).layers
    rest = next(layer.rest for layer in layers if layer.kind != "garment")
    found = keep_apart(Limbs(model, rest, J), motion.frames, motion.rotations, motion.translation, motion.fps)
    return replace(motion, rotations=found.rotations), found
