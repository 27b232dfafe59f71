"""Points spread evenly over a mesh, across all seams of its UVs: each face cut into n x n, values interpolated linearly."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .. import kernels

LAZY = 0.5  # share of a point's value that one step of blurring takes from its neighbours


class Lattice:
    """The vertices of a mesh V (g,3) [m], faces (m,3), cut into n x n triangles a face.

    face (N,) and bary (N,3) say where each point lies, positions (N,3); spacing [m] is the mean edge between points.
    """

    def __init__(self, V, faces, n):
        self.n, self.corners = n, np.asarray(faces, dtype=np.int64)
        self.face, self.bary, self.ids = _points(self.corners, len(V), n)
        self.positions = np.einsum("nk,nki->ni", self.bary, V[self.corners[self.face]])
        self.triangles = _triangles(self.ids, n)
        self.edges = kernels.unique_edges(self.triangles)
        self.spacing = float(np.linalg.norm(np.diff(self.positions[self.edges], axis=1), axis=2).mean())
        self.areas = kernels.voronoi_mass(self.positions, self.triangles)
        size = len(self.face)
        self.to_points = sparse.csr_matrix(
            (self.bary.ravel(), (np.repeat(np.arange(size), 3), self.corners[self.face].ravel())), shape=(size, len(V))
        )
        self.gradient = gradient(self.positions, self.triangles)
        self._walk = _walk(self.edges, size)

    def __len__(self):
        return len(self.face)

    def look_up(self, face, bary):
        """Points (k,3) about each place on the mesh, and their weights (k,3)."""
        x = np.clip(bary, 0, 1) * self.n
        low = np.clip(np.floor(x), 0, self.n - 1).astype(np.int64)
        rows = np.arange(len(x))
        while (over := low.sum(1) - (self.n - 1)).max(initial=0) > 0:  # a place on an edge between points
            pick = np.argmin(np.where(low > 0, x - low, np.inf), axis=1)
            low[rows[over > 0], pick[over > 0]] -= 1
        f = np.clip(x - low, 0, 1)
        down = low.sum(1) < self.n - 1  # the triangle that points the other way
        step = np.eye(3, dtype=np.int64)
        corner = low[:, None] + np.where(down[:, None, None], 1 - step, step)
        weight = np.where(down[:, None], 1 - f, f)
        return self.ids[face[:, None], corner[..., 0], corner[..., 1]], weight / weight.sum(1, keepdims=True)

    def blurred(self, sums, weights, sigma, start=0.0):
        """Sums (N,C) and weights (N,), both blurred from a Gaussian of `start` to one of `sigma` [m]."""
        steps = round((sigma**2 - start**2) / (0.5 * LAZY * self.spacing**2))
        both = np.c_[sums, weights]
        for _ in range(max(steps, 0)):
            both = self._walk @ both
        return both[:, :-1], both[:, -1]


def _points(faces, vertices, n):
    """face, bary of each point, each once, and ids (m,n+1,n+1): the point whose first two coordinates are (i,j)/n."""
    edges = np.asarray(kernels.unique_edges(faces), dtype=np.int64)
    order = edges[:, 0] * vertices + edges[:, 1]  # rising
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    i, j = i[i + j <= n], j[i + j <= n]
    steps = np.stack([i, j, n - i - j], 1)
    codes = np.empty((len(faces), len(steps)), np.int64)
    inner = vertices + len(edges) * n
    for s, step in enumerate(steps):
        on = np.flatnonzero(step)
        if len(on) == 1:
            codes[:, s] = faces[:, on[0]]
        elif len(on) == 2:
            a, b = faces[:, on[0]], faces[:, on[1]]
            edge = np.searchsorted(order, np.minimum(a, b) * vertices + np.maximum(a, b))
            codes[:, s] = vertices + edge * n + np.where(a < b, step[on[0]], step[on[1]])
        else:
            codes[:, s] = inner + np.arange(len(faces)) * len(steps) + s
    _, first, ids = np.unique(codes, return_index=True, return_inverse=True)
    table = np.zeros((len(faces), n + 1, n + 1), np.int64)
    table[:, i, j] = ids.reshape(codes.shape)
    face, step = np.divmod(first, len(steps))
    return face, steps[step] / n, table


def _triangles(ids, n):
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    i, j = i[i + j < n], j[i + j < n]
    up = np.stack([ids[:, i + 1, j], ids[:, i, j + 1], ids[:, i, j]], -1)
    i, j = i[i + j < n - 1], j[i + j < n - 1]
    down = np.stack([ids[:, i, j + 1], ids[:, i + 1, j], ids[:, i + 1, j + 1]], -1)
    return np.concatenate([up.reshape(-1, 3), down.reshape(-1, 3)]).astype(np.int32)


def gradient(P, F):
    """Three sparse (N,N): the gradient in space of point values, area-weighted over the faces about each point."""
    corner = P[F]
    opposite = np.roll(corner, -2, 1) - np.roll(corner, -1, 1)  # of each corner, along the face's turn
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    double = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(double, 1e-18)[:, None]
    slope = np.cross(normal[:, None], opposite)  # = 2 A grad of the corner's hat function
    total = np.bincount(F.ravel(), np.repeat(double, 3), minlength=len(P))
    rows, columns = np.repeat(F, 3, 1).ravel(), np.tile(F, 3).ravel()
    return [
        sparse.csr_matrix(
            (np.tile(slope[..., k], 3).ravel() / np.maximum(total, 1e-18)[rows], (rows, columns)), shape=(len(P),) * 2
        )
        for k in range(3)
    ]


def _walk(edges, size):
    """One step of a lazy random walk, symmetric so that it keeps the sum of what it spreads."""
    a, b = edges.T
    degree = np.bincount(edges.ravel(), minlength=size)
    share = LAZY / np.maximum(degree[a], degree[b])
    A = sparse.coo_matrix((np.r_[share, share], (np.r_[a, b], np.r_[b, a])), shape=(size, size)).tocsr()
    return (A + sparse.diags(1 - np.asarray(A.sum(1)).ravel())).tocsr()
