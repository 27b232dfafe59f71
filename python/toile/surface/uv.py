"""Maps over a layer's UVs: vertices to texels.

Texel (row r, column c) of a T-texel map has its centre at u = (c + 0.5) / T, v = 1 - (r + 0.5) / T; v grows upwards.
"""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..errors import UserError

GUTTER = 2  # texels about a chart that continue it, so that bilinear look-ups at its border read nothing else


def texel_positions(uv, size):
    """UVs (...,2) in texels (...,2) column, row, where texel (0,0) has its centre at (0.5, 0.5)."""
    return np.stack([uv[..., 0] * size, (1 - uv[..., 1]) * size], -1)


class UvMap:
    """A layer's faces drawn into a square of `size` texels.

    face (T,T) int32, -1 where no face and no gutter lies; bary (T,T,3) weights of its corners, in a gutter those of the
    chart's nearest texel; valid (T,T): face >= 0; inside (T,T): without the gutter.
    """

    def __init__(self, layer, size):
        from scipy.ndimage import distance_transform_edt

        self.layer, self.size = layer, size
        at = texel_positions(layer.uv, size)
        drawn = kernels.raster(np.c_[at, np.ones(len(at))], layer.face_uv, np.eye(3), (size, size), barycentric=True)
        self.inside = drawn.face >= 0
        if not self.inside.any():
            raise UserError(f"layer {layer.name}: its UVs cover no texel of {size} x {size}")
        distance, (row, column) = distance_transform_edt(~self.inside, return_indices=True)
        self.valid = distance <= GUTTER
        self.face = np.where(self.valid, drawn.face[row, column], -1).astype(np.int32)
        self.bary = drawn.barycentric[row, column] * self.valid[..., None]

    @property
    def corners(self):
        """Vertices (T,T,3) of each texel's face; those of face 0 where there is none."""
        return self.layer.faces[np.maximum(self.face, 0)]

    def texels(self, values):
        """Vertex values (n,C) at the texels, (T,T,C); zero outside."""
        return np.einsum("rck,rckx->rcx", self.bary, values[self.corners])


def vertices_of_uvs(layer):
    """The vertex of each UV (t,), -1 where no face uses it."""
    vertex = np.full(len(layer.uv), -1)
    vertex[np.asarray(layer.face_uv).ravel()] = np.asarray(layer.faces).ravel()
    return vertex
