"""Changes of a layer's texture, applied to what its decoder gives (docs/method/animation.md, Editing).

With m the decoded texture of no view in particular and r what the view adds to it, an edit of cover A (0..1 a texel) makes
  scale s:  m <- (1 + A (s - 1)) m,   r <- (1 + A (s - 1)) r
  paint C:  m <- (1 - A) m + A C q,   q = brightness of the decoded texture over that of the mean texture, both smoothed
and the layer shows m + r under its quasi-shadow. Geometry, codes and every other layer stay as they were.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from ...errors import UserError
from ...io.files import load_record, save_record
from .networks import resize

LUMA = (0.299, 0.587, 0.114)  # of red, green, blue in brightness (ITU-R BT.601)
CELLS = 64  # along a side of the smoothed textures, three of which each is a mean over: some 5 cm of a shirt
SHADE = (0.25, 4.0)  # bounds of q


@dataclass(frozen=True)
class Edit:
    """One change of one layer. S, the side of its maps, is a power of two."""

    layer: str
    garment: str  # whose edit it is: the layer itself, or what the baseline's surface shows of it
    words: str  # "scale 1,0.5,0.5": what was asked
    cover: np.ndarray  # (S,S) uint8 in 255ths
    scale: np.ndarray | None = None  # (3,)
    colour: np.ndarray | None = None  # (S,S,3) uint8; either this or `scale`


class LayerEdits(nn.Module):
    """The edits of one layer in the order they were asked for; no parameters, nothing that is saved."""

    def __init__(self, edits, mean_texture, valid):
        """`mean_texture` (3,T,T) and `valid` (1,T,T) of the layer; T and all S are powers of two."""
        super().__init__()
        size = max(mean_texture.shape[-1], *(len(edit.cover) for edit in edits))
        self.size, self.paints = size, any(edit.colour is not None for edit in edits)
        self.register_buffer("known", valid.clone()[None], persistent=False)
        self.register_buffer("usual", self._smoothed(mean_texture[None]), persistent=False)
        self.steps = nn.ModuleList(_Step(edit, size) for edit in edits)

    def forward(self, mean, seen):
        """Decoded textures (B,3,T,T) of no view and of the camera's -> the edited ones (B,3,S,S), S the finest size."""
        shade = resize(self._shade(mean), self.size) if self.paints else None
        m, r = resize(mean, self.size), resize(seen - mean, self.size)
        for step in self.steps:
            m, r = step(m, r, shade)
        return m, m + r

    def _shade(self, mean):
        """q (B,1,T,T)."""
        coarse = (self._smoothed(mean) / self.usual.clamp(min=1e-3)).clamp(*SHADE)
        return F.interpolate(coarse, size=mean.shape[-2:], mode="bilinear", align_corners=False)

    def _smoothed(self, texture):
        """Brightness (B,1,CELLS,CELLS), the mean over valid texels nearby: folds stay, prints that slip hardly do; 1 where no
        texel is."""
        luma = sum(weight * colour for weight, colour in zip(LUMA, texture.split(1, 1)))
        cell = max(texture.shape[-1] // CELLS, 1)
        total, weight = (F.avg_pool2d(F.avg_pool2d(x, cell), 3, 1, 1) for x in (luma * self.known, self.known))
        return (total / weight.clamp(min=1e-9)).masked_fill(weight <= 0, 1.0)


class _Step(nn.Module):
    """One edit at the size of the finest."""

    def __init__(self, edit, size):
        super().__init__()
        colour = None if edit.colour is None else resize(_map(edit.colour), size)
        scale = None if edit.scale is None else torch.as_tensor(np.asarray(edit.scale, np.float32))[:, None, None]
        for name, value in (("cover", resize(_map(edit.cover[..., None]), size)), ("colour", colour), ("scale", scale)):
            self.register_buffer(name, value, persistent=False)

    def forward(self, m, r, shade):
        if self.colour is None:
            factor = 1 + self.cover * (self.scale - 1)
            return m * factor, r * factor
        return m + self.cover * (self.colour * shade - m), r


def _map(picture):
    """(S,S,C) uint8 -> (1,C,S,S) of 0..1."""
    return torch.as_tensor(np.asarray(picture, np.float32) / 255).permute(2, 0, 1)[None]


def save_edits(folder, edits):
    """AVATAR/assets/edit0.npz and so on, in order."""
    for i, edit in enumerate(edits):
        save_record(Path(folder) / "assets" / f"edit{i}.npz", edit)


def load_edits(folder):
    """The edits of an avatar's folder in order; [] for one that was never edited."""
    paths = sorted((Path(folder) / "assets").glob("edit*.npz"), key=lambda path: int(path.stem[4:]))
    return [_load(path) for path in paths]


def _load(path):
    try:
        edit = load_record(path, Edit)
        sizes = [edit.cover.shape, *([] if edit.colour is None else [edit.colour.shape[:2]])]
    except Exception as error:
        raise UserError(f"{path}: not an edit: {error}") from None
    side = len(edit.cover)
    if (
        (edit.scale is None) == (edit.colour is None)
        or any(size != (side, side) for size in sizes)
        or side & (side - 1)
    ):
        raise UserError(f"{path}: not an edit: its maps do not fit one another")
    return edit


def apply_edits(avatar, edits):
    """Has an avatar show `edits`, instead of those that it showed before. UserError: of a layer that it lacks."""
    for edit in edits:
        if edit.layer not in avatar.names:
            raise UserError(f"edit {edit.words}: the avatar has no layer {edit.layer}")
    for model in avatar.models:
        mine = [edit for edit in edits if edit.layer == model.name]
        model.edits = LayerEdits(mine, model.mean_texture, model.valid) if mine else None
