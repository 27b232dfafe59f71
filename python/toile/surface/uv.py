"""Maps over a layer's UVs: vertices to texels.

Texel (row r, column c) of a T-texel map has its centre at u = (c + 0.5) / T, v = 1 - (r + 0.5) / T; v grows upwards.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .. import kernels
from ..errors import UserError

GUTTER = 2  # texels about a chart that continue it, so that bilinear look-ups at its border read nothing else


SMOOTH = 1e-6  # weight of a map's second differences against its values at the vertices


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
        self._solver = None

    @property
    def corners(self):
        """Vertices (T,T,3) of each texel's face; those of face 0 where there is none."""
        return self.layer.faces[np.maximum(self.face, 0)]

    def texels(self, values):
        """Vertex values (n,C) at the texels, (T,T,C); zero outside."""
        return np.einsum("rck,rckx->rcx", self.bary, values[self.corners])

    def bake(self, values):
        """Vertex values (n,C) as a map (C,T,T): of all maps that give the values back at the vertices' UVs, bilinearly,
        the smoothest. Zero far from the charts."""
        values = np.asarray(values, dtype=np.float64)
        self._solver = self._solver or _Bake(self)
        return self._solver.map(values).reshape(self.size, self.size, -1).transpose(2, 0, 1)


def sampling_matrix(layer, size):
    """Bilinear sampling (t,T*T) at the UVs, sparse, as grid_sample with border padding does; and the vertex of each UV
    (t,), -1 where no face uses it."""
    at = np.clip(texel_positions(layer.uv, size) - 0.5, 0, size - 1)
    low = np.minimum(at.astype(np.int64), size - 2)
    f = at - low
    rows = np.repeat(np.arange(len(at)), 4)
    columns = np.stack([low[:, 1] * size + low[:, 0] + d for d in (0, 1, size, size + 1)], 1)
    weights = np.stack(
        [(1 - f[:, 0]) * (1 - f[:, 1]), f[:, 0] * (1 - f[:, 1]), (1 - f[:, 0]) * f[:, 1], f[:, 0] * f[:, 1]], 1
    )
    vertex = np.full(len(at), -1)
    vertex[np.asarray(layer.face_uv).ravel()] = np.asarray(layer.faces).ravel()
    S = sparse.csr_matrix((weights.ravel(), (rows, columns.ravel())), shape=(len(at), size * size))
    return S, vertex


class _Bake:
    """min |S m - v|^2 + SMOOTH |second differences of m|^2 over the texels of the charts and their gutter."""

    def __init__(self, uv_map):
        size = uv_map.size
        S, self.vertex = sampling_matrix(uv_map.layer, size)
        S = S[self.vertex >= 0]
        self.vertex = self.vertex[self.vertex >= 0]
        used = uv_map.valid.ravel() | (np.asarray(np.abs(S).sum(0)).ravel() > 0)
        self.texels = np.flatnonzero(used)
        self.S = S[:, self.texels].tocsr()
        D = _second_differences(used.reshape(size, size))[:, self.texels]
        A = self.S.T @ self.S + SMOOTH * (D.T @ D) + 1e-12 * sparse.identity(len(self.texels))
        self.factor, self.size = kernels.CholeskyFactor().factorize(A.tocsc()), size

    def map(self, values):
        wanted = values[self.vertex]
        found = self.factor.solve(self.S.T @ wanted)
        found += self.factor.solve(self.S.T @ (wanted - self.S @ found))  # refined: SMOOTH is small
        out = np.zeros((self.size * self.size, values.shape[1]))
        out[self.texels] = found
        return out


def _second_differences(used):
    """Rows 1, -2, 1 over three used texels in a row or column; two in a row where a strip is narrower, as 1, -1."""
    size = len(used)
    index = np.arange(size * size).reshape(size, size)
    entries = []
    for i, u in ((index, used), (index.T, used.T)):
        three = u[:, :-2] & u[:, 1:-1] & u[:, 2:]
        entries.append((np.stack([i[:, :-2][three], i[:, 1:-1][three], i[:, 2:][three]], 1), [1.0, -2.0, 1.0]))
        lone = (
            u & ~np.pad(three, ((0, 0), (0, 2))) & ~np.pad(three, ((0, 0), (1, 1))) & ~np.pad(three, ((0, 0), (2, 0)))
        )
        pair = lone[:, :-1] & u[:, 1:] | u[:, :-1] & lone[:, 1:]
        entries.append((np.stack([i[:, :-1][pair], i[:, 1:][pair]], 1), [1.0, -1.0]))
    blocks = []
    for columns, weights in entries:
        rows = np.repeat(np.arange(len(columns)), len(weights))
        values = np.tile(weights, len(columns))
        blocks.append(sparse.csr_matrix((values, (rows, columns.ravel())), shape=(len(columns), size * size)))
    return sparse.vstack(blocks).tocsr()
