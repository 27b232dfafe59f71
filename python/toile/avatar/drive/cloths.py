"""Garments of a trained avatar measured as cloth, on the frames that it was trained on (docs/method/drape.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ... import kernels
from ...errors import UserError
from ...io.files import identity_of, save_record
from ...io.inputs import contents
from ...io.run import is_run, open_run
from ...surface.sampling import evenly
from ..model.checkpoint import read_facts
from .animate import DrivenAvatar
from .draping import Cloth, cloth_file
from .driver import held_out_span, stride_of

LEAD = 15  # frames in which cloth forgets how it began
CLEARANCE = 5  # percentile of the registered distances from the body: what the cloth keeps
LEAST_MARGIN = 0.001  # [m]
MEASURED = 10  # frames whose distances from the body are measured


def ensure_cloths(folder, run=None, progress=lambda stage, done, total: None):
    """Makes AVATAR/cloth.NAME.npz of every garment, unless they are there and made of this avatar as it is trained; `run`: where
    the run is now.

    Lengths: means of the registered edges. Margin: a low percentile of the registered distances from the body, at least
    LEAST_MARGIN. Residual: the mean over frames of registered less simulated vertices, both unposed; of a row of neighbours
    the first LEAD frames, at most half of them, are only simulated. No held-out frame is read.
    UserError: the avatar has no garment, or its run is gone.
    """
    facts = read_facts(folder)
    names = [layer["name"] for layer in facts["architecture"]["layers"] if layer["kind"] == "garment"]
    if not names:
        raise UserError(f"{folder}: no garment, nothing that could hang")
    identity = "".join(contents(Path(folder) / file) for file in ("avatar.json", "avatar.safetensors"))
    if all(identity_of(cloth_file(folder, name)) == identity for name in names):
        return
    path = Path(run or facts["run"])
    if not is_run(path):
        raise UserError(f"{folder}: its run {path} is not there, and cloth is measured on it")
    run, driven = open_run(path), DrivenAvatar(folder, path)
    frames = driven.motion.frames
    rows = np.flatnonzero(~np.isin(frames, held_out_span(facts["holdout"])))
    cloths = {name: _at_rest(run, driven, name, frames[rows]) for name in names}
    left = _left_over(run, driven, cloths, _stretches(rows, frames), progress)
    for name in names:
        save_record(cloth_file(folder, name), replace(cloths[name], residual=left[name]), identity)


def _at_rest(run, driven, name, frames):
    """Cloth of a garment without a residual."""
    garment, model = run.garments[name], driven.model
    i, j = kernels.unique_edges(garment.faces).T
    lengths = np.mean([np.linalg.norm(V[i] - V[j], axis=1) for V in map(garment.vertices.at, frames)], axis=0)
    clear = [
        kernels.signed_distance(garment.vertices.at(n), run.inner.vertices.at(n), model.skin_faces)
        for n in evenly(frames, MEASURED)
    ]
    margin = max(LEAST_MARGIN, float(np.percentile(np.concatenate(clear), CLEARANCE)))
    return Cloth(lengths, margin, np.zeros((garment.vertices.shape[1], 3)))


def _stretches(rows, frames):
    """Rows in pieces of neighbouring frames."""
    breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(frames[rows]) != (stride_of(frames[rows]) or 1))) + 1
    return np.split(rows, breaks)


@torch.no_grad()
def _left_over(run, driven, cloths, stretches, progress):
    """{garment: (n,3)} mean of registered less simulated vertices, unposed."""
    sums, count, done = dict.fromkeys(cloths, 0.0), 0, 0
    for rows in stretches:
        draping = driven.draped(cloths, rows)
        for k, row in enumerate(rows):
            batch = driven.unseen(row)
            draping.at(k, driven.geometry(row), batch)
            progress("cloth", done := done + 1, sum(map(len, stretches)))
            if k < min(LEAD, len(rows) // 2):
                continue
            transforms = driven.avatar.skeleton(batch["rotations"], batch["translation"])
            count += 1
            for name, V in draping.fallen.items():
                both = np.stack([run.garments[name].vertices.at(int(driven.motion.frames[row])), V])
                both = torch.as_tensor(both, dtype=torch.float32, device=driven.device)
                skin = driven.avatar.model(name).skin
                registered, simulated = (skin.unpose(x[None], *transforms)[0] for x in both)
                sums[name] = sums[name] + (registered - simulated).double().cpu().numpy()
    return {name: total / count for name, total in sums.items()}
