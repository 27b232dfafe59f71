"""Garments of other avatars on one: their networks, codes' drivers and textures, laid on its body (docs/method/animation.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from torch import nn

from ...errors import UserError
from ...surface.refit import Wearer, refit, strain_of
from ..model.assets import training_poses
from ..model.avatar import Avatar
from ..model.checkpoint import load_avatar
from .draping import worn_cloths
from .driver import hardly_foretold, load_driver, make_track, stride_at

TIGHT = 0.1  # 95th percentile of strain, of either sign, beyond which a garment is said to hardly fit


@dataclass(frozen=True)
class Lent:
    """A garment that an avatar wears of another."""

    name: str
    folder: Path
    lender: Avatar  # which reads the poses that its temporal model was taught with
    moved: np.ndarray  # (n,3) its rest vertices here less those there [m]
    strain: float  # 95 % of the edges at rest are stretched or shortened by less, a share of their lengths on the lender's body

    @property
    def poses(self):
        """Those that it was taught with, see `training_poses`."""
        return training_poses(self.folder)

    @cached_property
    def driver(self):
        """The lender's, see `load_driver`."""
        return load_driver(self.folder)

    @property
    def warnings(self):
        _, _, measured = self.driver
        doubts = [f"{self.name} of {self.folder}: {words}" for words in hardly_foretold(measured)]
        if self.strain <= TIGHT:
            return doubts
        words = f"one edge in twenty is longer or shorter by more than {100 * self.strain:.0f} %"
        return [f"{self.name} of {self.folder} hardly fits: {words}", *doubts]

    def cloth(self, physics):
        """{name: Cloth} as it lies on the wearer, or {}, see `worn_cloths`."""
        layer = self.lender.layers[self.lender.names.index(self.name)]
        cloths = worn_cloths(self.folder, [layer], physics).items()
        return {name: replace(cloth, residual=cloth.residual.moved(self.moved)) for name, cloth in cloths}

    @torch.no_grad()
    def latents(self, motion, face_mean):
        """Codes (T,Z) for a Motion of a person of mean face (q,3) or None. Poses of a window lie apart in time as nearly as in
        the lender's training; the face moves from the lender's mean as it does from the person's."""
        driver, stride, _ = self.driver
        face, mean = motion.face, getattr(self.lender, "face_mean", None)
        if face is not None and mean is not None:
            known = face_mean is not None and face_mean.shape == mean.shape
            face = face + (mean - face_mean).double().numpy() if known else None
        stride = stride_at(motion.fps, stride, self.lender.scene.fps)
        track = make_track(self.lender, motion.frames, motion.rotations, face, stride, motion.fps)
        return driver.latents(track)[self.name]


def lend(avatar, garments: Mapping[str, Path], folder, skin_faces):
    """Has an Avatar, read from `folder`, wear garments {name: folder of another avatar}, each in place of its own of that name
    or else under what the other wears over it. Returns a Lent each. `skin_faces`: those of the body that cloth can meet.
    UserError: an avatar without a body or that garment, with another body model, another up."""
    return [_put_on(avatar, name, Path(other), folder, skin_faces) for name, other in garments.items()]


def _put_on(avatar, name, folder, own_folder, skin_faces):
    option, lender = f"--garment {name}={folder}", load_avatar(folder)
    there = [layer.name for layer in lender.layers if layer.kind == "garment"]
    if name not in there:
        raise UserError(f"{option}: no garment {name} there: it has {', '.join(there) or 'none'}")
    wearer, owner = _body(avatar, own_folder), _body(lender, folder)
    _check_same_model(option, own_folder, (avatar, wearer), (lender, owner))
    layer, model = lender.layers[lender.names.index(name)], lender.model(name)
    bodies = (Wearer(body.rest, one.skeleton.J.double().numpy()) for one, body in ((lender, owner), (avatar, wearer)))
    rest = refit(layer, *bodies, skin_faces)
    strain = np.percentile(np.abs(strain_of(layer.faces, layer.rest, rest)), 95)
    model.rest.copy_(torch.tensor(rest))
    _wear(avatar, replace(layer, rest=rest), model, over=there[there.index(name) + 1 :])
    return Lent(name, folder, lender, rest - layer.rest, float(strain))


def _wear(avatar, layer, model, over):
    """The layer and its networks in place of the avatar's own of that name, or under the first of the names `over`."""
    layers, models, names = list(avatar.layers), list(avatar.models), avatar.names
    above = (i for i, worn in enumerate(names) if worn in over)
    at = names.index(layer.name) if layer.name in names else next(above, len(names))
    end = at + (layer.name in names)
    layers[at:end], models[at:end] = [layer], [model]
    avatar.layers, avatar.names, avatar.models = layers, [worn.name for worn in layers], nn.ModuleList(models)


def _body(avatar, folder):
    body = next((layer for layer in avatar.layers if layer.kind == "body"), None)
    if body is None:
        raise UserError(f"{folder}: an avatar of a single layer, which neither lends a garment nor changes one")
    return body


def _check_same_model(option, folder, wearer, owner):
    """`wearer` and `owner`: (Avatar, its body). UserError: not of one body model, or another axis is up."""
    (avatar, body), (lender, other) = wearer, owner
    arrays = ("faces", "skin_idx", "skin_val")
    same = all(np.array_equal(getattr(body, name), getattr(other, name)) for name in arrays)
    if not same or avatar.skeleton.parents != lender.skeleton.parents:
        words = [
            f"{one.scene.body_model}, {len(layer.rest)} vertices, {len(one.skeleton.J)} joints"
            for one, layer in (owner, wearer)
        ]
        raise UserError(f"{option}: its body model ({words[0]}) is another than that of {folder} ({words[1]})")
    if avatar.scene.up != lender.scene.up:
        raise UserError(f"{option}: up is {lender.scene.up} there, {avatar.scene.up} in {folder}")
