"""Maps over a layer's UVs read at its vertices, and vertex values at its texels, in torch; `surface.uv` says where texels lie."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from ...errors import UserError
from ...surface.uv import vertices_of_uvs


def grid(uv):
    """UVs (...,2), a tensor, as coordinates of grid_sample (align_corners=False)."""
    return torch.stack([2 * uv[..., 0] - 1, 1 - 2 * uv[..., 1]], -1)


class UvSampler(nn.Module):
    """Reads maps at the vertices of a layer: the mean over a vertex' UVs."""

    def __init__(self, layer):
        super().__init__()
        n = len(layer.rest)
        vertex = vertices_of_uvs(layer)
        used = vertex >= 0
        if (np.bincount(vertex[used], minlength=n) == 0).any():
            missing = int(np.flatnonzero(np.bincount(vertex[used], minlength=n) == 0)[0])
            raise UserError(f"layer {layer.name}: vertex {missing} has no UV")
        order = np.argsort(vertex[used], kind="stable")
        self.register_buffer(
            "places", grid(torch.as_tensor(layer.uv[used][order]).float())[None, None], persistent=False
        )
        count = np.bincount(vertex[used], minlength=n)
        most = int(count.max())
        slot = np.minimum(np.arange(most), count[:, None] - 1) + (np.cumsum(count) - count)[:, None]
        weight = (np.arange(most) < count[:, None]) / count[:, None]
        self.register_buffer("slots", torch.as_tensor(slot), persistent=False)
        self.register_buffer("weights", torch.as_tensor(weight).float(), persistent=False)

    def forward(self, maps):
        """(B,C,T,T) -> (B,n,C)."""
        grid_ = self.places.expand(len(maps), -1, -1, -1)
        read = nn.functional.grid_sample(maps.float(), grid_, align_corners=False, padding_mode="border")[:, :, 0]
        out = 0.0
        for k in range(self.slots.shape[1]):
            out = out + self.weights[:, k] * read[:, :, self.slots[:, k]]
        return out.transpose(1, 2)


class TexelValues(nn.Module):
    """Carries vertex values to the texels of a UvMap."""

    def __init__(self, uv_map, faces):
        super().__init__()
        size = uv_map.size
        texel = np.flatnonzero(uv_map.valid)
        corner = np.asarray(faces)[uv_map.face.ravel()[texel]]
        self.size = size
        self.register_buffer("texel", torch.as_tensor(texel), persistent=False)
        self.register_buffer("corner", torch.as_tensor(corner.astype(np.int64)), persistent=False)
        self.register_buffer("bary", torch.as_tensor(uv_map.bary.reshape(-1, 3)[texel]).float(), persistent=False)

    def forward(self, values):
        """(B,n,C) -> (B,C,T,T), zero where the map is not valid."""
        B, _, C = values.shape
        at = sum(self.bary[:, k, None] * values[:, self.corner[:, k]] for k in range(3))
        out = values.new_zeros(B, self.size * self.size, C)
        out[:, self.texel] = at.to(out.dtype)
        return out.transpose(1, 2).reshape(B, C, self.size, self.size)
