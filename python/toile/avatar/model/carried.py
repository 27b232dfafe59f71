"""What moves a garment: a pose as the places to which the skeleton alone would carry its cloth.

Joint angles tell the same in numbers of which most concern fingers, feet and face, and each of which counts alike whether
it moves a sleeve or nothing. Here every number is a length: two poses are as far from one another as they move the cloth.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import nn

from ...surface.sampling import spread_points
from .skinning import Skin

POINTS = 256  # of each garment
COMPONENTS = 32  # principal components that models read
SPREAD = 3.0  # standard deviation of all components together: what AdamW's usual steps are made for
LEAST = 1e-6  # of the first component's variance: those with less are left out
CHUNK = 256  # poses at a time


class Carried(nn.Module):
    """Features of poses (B,P) [m]: per garment POINTS of its mean shape, skinned, then brought as near to that shape as a
    rigid motion can; where up is, seen from there; facial keypoints in the head's frame.

    Squared distances are means over the points, so that garment, tilt (times the garment's radius) and face compare.
    Where the person stands, and which way they face, changes nothing.
    """

    def __init__(self, garments, skeleton, up, face_mean=None):
        """`garments`: layers; `skeleton`: the Skeleton that poses them; `up` (3,); `face_mean` (q,3) or None."""
        super().__init__()
        self.pose_of = skeleton
        self.register_buffer("up", up, persistent=False)
        self.register_buffer("face_mean", torch.zeros(0, 3) if face_mean is None else face_mean, persistent=False)
        self.skins, self.shapes = nn.ModuleList(), []
        for i, garment in enumerate(garments):
            at = spread_points(garment.rest, POINTS)
            self.skins.append(Skin(replace(garment, skin_idx=garment.skin_idx[at], skin_val=garment.skin_val[at])))
            self.shapes.append(f"shape{i}")
            self.register_buffer(f"shape{i}", torch.as_tensor(garment.rest[at], dtype=torch.float32), persistent=False)

    @property
    def size(self):
        """P."""
        return sum(getattr(self, name).numel() + 3 for name in self.shapes) + self.face_mean.numel()

    @torch.no_grad()
    def forward(self, rotations, face=None):
        """Rotation vectors (B,K,3), keypoints (B,q,3), nan where unseen, or None -> (B,P)."""
        chunks = range(0, len(rotations), CHUNK)
        return torch.cat(
            [self._chunk(rotations[i : i + CHUNK], None if face is None else face[i : i + CHUNK]) for i in chunks]
        )

    def _chunk(self, rotations, face):
        transforms = self.pose_of(rotations, torch.zeros_like(rotations[:, 0]))
        parts = [
            x
            for skin, name in zip(self.skins, self.shapes)
            for x in self._garment(skin, getattr(self, name), transforms)
        ]
        if self.face_mean.numel():
            offset = (
                self.face_mean.new_zeros(len(rotations), *self.face_mean.shape)
                if face is None
                else face - self.face_mean
            )
            parts.append(torch.nan_to_num(offset).flatten(1) / len(self.face_mean) ** 0.5)
        return torch.cat(parts, 1)

    def _garment(self, skin, shape, transforms):
        centred = shape - shape.mean(0)
        carried = skin.pose(shape.expand(len(transforms[0]), -1, -1), *transforms)
        carried = carried - carried.mean(1, keepdim=True)
        turn = nearest_rotation(carried.transpose(1, 2) @ centred)
        radius = centred.square().sum(1).mean().sqrt()
        moved = (carried @ turn - centred).flatten(1) / len(shape) ** 0.5
        return moved, radius * (self.up @ turn - self.up)


def nearest_rotation(H):
    """The rotations Q (B,3,3) for which x Q comes nearest to y, H = sum x^T y (Kabsch 1976)."""
    U, _, V = torch.linalg.svd(H)
    flip = torch.ones_like(H[:, 0])
    flip[:, 2] = torch.det(U @ V).sign()
    return (U * flip[:, None]) @ V


class Projection(nn.Module):
    """Features (...,P) to their principal components (...,COMPONENTS), all divided by one number: lengths still compare."""

    def __init__(self, size):
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("basis", torch.zeros(size, COMPONENTS))

    @torch.no_grad()
    def fit(self, features):
        """To training features (T,P)."""
        x = features.double()
        mean = x.mean(0)
        variance, basis = torch.linalg.eigh((x - mean).T @ (x - mean) / len(x))
        kept = min(COMPONENTS, int((variance > LEAST * variance[-1]).sum()))  # what hardly varies points anywhere
        basis = basis.flip(1)[:, :kept]
        # an eigenvector's sign is nobody's choice
        basis = basis * basis.gather(0, basis.abs().argmax(0, keepdim=True)).sign()
        self.mean.copy_(mean)
        self.basis.zero_()
        self.basis[:, :kept] = basis * SPREAD / variance.sum().clamp(min=1e-12).sqrt()

    def forward(self, features):
        return (features - self.mean) @ self.basis
