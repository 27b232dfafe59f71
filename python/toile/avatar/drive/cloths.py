"""Garments of a trained avatar measured as cloth, on the frames that it was trained on (docs/method/drape.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ... import kernels
from ...errors import UserError
from ...frame_numbers import evenly, stride_of
from ...io.files import identity_of, save_record
from ...io.holdout import kept_apart
from ...io.run import is_run, open_run
from ..model.checkpoint import read_facts
from ..settings import ClothSettings
from ..train.data import check_registration
from .animate import DrivenAvatar
from .draping import Cloth, cloth_file, made_of
from .driver import unseen_codes
from .residual import Residual, teach
from .teaching import DECODED


def ensure_cloths(folder, run=None, progress=lambda stage, done, total: None, settings=None):
    """Makes AVATAR/cloth.NAME.npz of every garment, unless they are there and made of this avatar as it is trained, by these
    ClothSettings, or with None by any; `run`: where the run is now.

    Lengths: means of the registered edges. Margin: a low percentile of the registered distances from the body. Residual:
    taught by registered and simulated vertices of the pictured frames, unposed; of a row of neighbours the first `lead` frames, at
    most half of them, are only simulated, and so are frames without pictures. A garment is simulated over those under it as they are
    shown unasked: as cloth where that helps, else by codes. Beside them lie the shapes of codes that the temporal model gives to frames that it was not
    taught, where it knows some. No held-out frame is read.
    UserError: the avatar has no garment, or its run is gone or registered anew.
    """
    facts = read_facts(folder)
    names = [layer["name"] for layer in facts["architecture"]["layers"] if layer["kind"] == "garment"]
    if not names:
        raise UserError(f"{folder}: no garment, nothing that could hang")
    identity = made_of(folder, settings)
    if all(identity_of(cloth_file(folder, name)).startswith(identity) for name in names):
        return
    settings = settings or ClothSettings()
    path = Path(run or facts["run"])
    if not is_run(path):
        raise UserError(f"{folder}: its run {path} is not there, and cloth is measured on it")
    run = open_run(path)
    check_registration(run, folder, facts)
    driven = DrivenAvatar(folder, path)
    frames = driven.motion.frames
    rows = np.flatnonzero(~np.isin(frames, kept_apart(run.holdout, facts["holdout"])))
    shown = rows[np.isin(frames[rows], run.pictured)]  # between them garments are only guessed
    cloths = {name: _at_rest(run, driven, name, frames[shown], settings) for name in names}
    stretches = _stretches(rows, frames)
    settled = np.concatenate([rows[min(settings.lead, len(rows) // 2) :] for rows in stretches])
    settled = settled[np.isin(settled, shown)]
    teachers = evenly(settled if len(settled) else shown, settings.taught)
    under = {}  # those that hang unasked
    for name in names:
        poses, hung, worn = _left_over(run, driven, under, name, cloths[name], stretches, teachers, progress)
        residual = teach(poses, hung, worn, _by_unseen_codes(folder, driven, name, frames[teachers]))
        cloth = replace(cloths[name], residual=residual)
        save_record(cloth_file(folder, name), cloth, made_of(folder, settings))
        if cloth.helps:
            under[name] = cloths[name]


def ensure_worn(folder, garments, progress=lambda stage, done, total: None, settings=None):
    """`ensure_cloths` of all that AVATAR `folder` wears: its own, and `garments` {name: folder of another avatar}."""
    own = {layer["name"] for layer in read_facts(folder)["architecture"]["layers"] if layer["kind"] == "garment"}
    folders = [folder] if own - set(garments) or not garments else []
    for one in dict.fromkeys([*folders, *garments.values()]):
        ensure_cloths(one, progress=progress, settings=settings)


def _at_rest(run, driven, name, frames, settings):
    """Cloth of a garment without a residual."""
    garment, model = run.garments[name], driven.model
    i, j = kernels.unique_edges(garment.faces).T
    lengths = np.mean([np.linalg.norm(V[i] - V[j], axis=1) for V in map(garment.vertices.at, frames)], axis=0)
    clear = [
        kernels.signed_distance(garment.vertices.at(n), run.inner.vertices.at(n), model.skin_faces)
        for n in evenly(frames, settings.measured)
    ]
    margin = max(settings.least_margin, float(np.percentile(np.concatenate(clear), settings.clearance)))
    return Cloth(lengths, margin, Residual.none(garment.vertices.shape[1]), settings.model_dump())


def _stretches(rows, frames):
    """Rows in pieces of neighbouring frames."""
    breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(frames[rows]) != (stride_of(frames[rows]) or 1))) + 1
    return np.split(rows, breaks)


@torch.no_grad()
def _by_unseen_codes(folder, driven, name, frames):
    """(F,n,3) unposed shapes of a garment by the codes of a temporal model that was not taught the frame, NaN where there is none; None
    where there is none at all."""
    known, codes = unseen_codes(folder)
    rows = [known.index(n) if n in known else -1 for n in frames.tolist()]
    if max(rows, default=-1) < 0:
        return None
    shapes = [driven.avatar.unposed_by(name, part.to(driven.device)).cpu() for part in codes[name].split(DECODED)]
    shapes = torch.cat(shapes).double().numpy()[rows]
    shapes[np.array(rows) < 0] = np.nan
    return shapes


@torch.no_grad()
def _left_over(run, driven, under, name, cloth, stretches, teachers, progress):
    """Poses (F,P) of the rows `teachers` of these, and (F,n,3) unposed vertices of garment `name`, simulated as `cloth` over the cloths
    `under` it {garment: Cloth}, and registered."""
    poses, hung, worn, done = [], [], [], 0
    skin = driven.avatar.model(name).skin
    for rows in stretches:
        draping = driven.draped(under | {name: cloth}, rows)
        for k, row in enumerate(rows):
            batch = driven.unseen(row)
            draping.at(k, driven.geometry(row), batch)
            progress("cloth", done := done + 1, sum(map(len, stretches)))
            if row not in teachers:
                continue
            transforms = driven.avatar.skeleton(batch["rotations"], batch["translation"])
            poses.append(draping.poses[name][k])
            both = np.stack([draping.fallen[name], run.garments[name].vertices.at(int(driven.motion.frames[row]))])
            both = torch.as_tensor(both, dtype=torch.float32, device=driven.device)
            for kept, x in zip((hung, worn), both):
                kept.append(skin.unpose(x[None], *transforms)[0].cpu().numpy())
    return np.stack(poses), np.stack(hung).astype(np.float64), np.stack(worn).astype(np.float64)
