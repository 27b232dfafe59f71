"""Maps over a layer's UVs read at its vertices, and vertex values at its texels, in torch; `surface.uv` says where texels lie."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from torch import nn

from ...errors import UserError
from ...surface.uv import vertices_of_uvs
from .operators import Linear


class UvSampler(nn.Module):
    """Reads maps of `size` texels a side at the vertices of a layer: bilinearly, the mean over a vertex' UVs. Beyond the outermost
    texel centres a map is constant."""

    def __init__(self, layer, size):
        super().__init__()
        n = len(layer.rest)
        vertex = vertices_of_uvs(layer)
        used = vertex >= 0
        count = np.bincount(vertex[used], minlength=n)
        if (count == 0).any():
            raise UserError(f"layer {layer.name}: vertex {int(np.flatnonzero(count == 0)[0])} has no UV")
        row, (texel, weight) = vertex[used], _bilinear(np.asarray(layer.uv, np.float64)[used], size)
        weight = weight / count[row][:, None]
        self.read = Linear(coo_matrix((weight.ravel(), (np.repeat(row, 4), texel.ravel())), shape=(n, size * size)))

    def forward(self, maps):
        """(B,C,T,T) -> (B,n,C)."""
        return self.read(maps.permute(0, 2, 3, 1).flatten(1, 2))


def _bilinear(uv, size):
    """Numbers (t,4) and weights (t,4) of the texels about UVs (t,2)."""
    at = np.clip(np.stack([uv[:, 0], 1 - uv[:, 1]], 1) * size - 0.5, 0, size - 1)
    low = np.floor(at).astype(np.int64)
    high, share = np.minimum(low + 1, size - 1), at - low
    texels, weights = [], []
    for y, wy in ((low[:, 1], 1 - share[:, 1]), (high[:, 1], share[:, 1])):
        for x, wx in ((low[:, 0], 1 - share[:, 0]), (high[:, 0], share[:, 0])):
            texels.append(y * size + x)
            weights.append(wy * wx)
    return np.stack(texels, 1), np.stack(weights, 1)


class TexelValues(nn.Module):
    """Carries vertex values to the texels of a UvMap. `vertices` (k,): those that some texel reads."""

    def __init__(self, uv_map, faces):
        super().__init__()
        texel = np.flatnonzero(uv_map.valid)
        corner = np.asarray(faces)[uv_map.face.ravel()[texel]]
        self.size, self.vertices = uv_map.size, np.unique(corner)
        weight = uv_map.bary.reshape(-1, 3)[texel]
        shape = self.size**2, int(np.max(faces)) + 1
        self.read = Linear(coo_matrix((weight.ravel(), (np.repeat(texel, 3), corner.ravel())), shape=shape))

    def forward(self, values):
        """(B,n,C) -> (B,C,T,T), zero where the map is not valid."""
        values = values[:, : self.read.shape[1]]
        return self.read(values).permute(0, 2, 1).unflatten(2, (self.size, self.size))
