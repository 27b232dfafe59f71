"""Slides of a garment along its own surface: two numbers a vertex, in metres on the rest shape."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from .. import kernels
from ..surface.operators import nearest_on_polyline, sides
from .lattice import Lattice

PHONG = 0.75  # of the way from the flat face to the mean of its corners' tangent planes
COTANGENT = (0.05, 5.0)  # bounds of an edge's weight, against needles


class SlidingSurface:
    """A garment's rest shape `rest` (g,3) with `faces`, cut into a Lattice of about `spacing` [m].

    A slide d (g,2) is a tangent vector a vertex in `frames` (g,2,3); loop vertices have their first axis along the loop and
    do not leave it.
    """

    def __init__(self, rest, faces, loops, spacing):
        self.rest, self.faces = np.asarray(rest, np.float64), np.asarray(faces, np.int32)
        self.edges = kernels.unique_edges(self.faces)
        mean = np.linalg.norm(np.diff(self.rest[self.edges], axis=1), axis=2).mean()
        self.lattice = Lattice(self.rest, self.faces, int(np.clip(round(mean / spacing), 1, 8)))
        self.index = kernels.SurfaceIndex(self.rest, self.faces)
        self.normals = kernels.vertex_normals(self.rest, self.faces)
        self.loops = [np.asarray(loop) for loop in loops]
        self.frames = self._frames()
        self.mass = kernels.voronoi_mass(self.rest, self.faces)

    def _frames(self):
        """Tangents (g,2,3): the first one along the loop at loops, elsewhere along an edge."""
        along = np.zeros_like(self.rest)
        a, b = self.edges[::-1].T
        along[b], along[a] = self.rest[a] - self.rest[b], self.rest[b] - self.rest[a]
        for loop in self.loops:
            along[loop] = self.rest[np.roll(loop, -1)] - self.rest[np.roll(loop, 1)]
        along -= self.normals * np.einsum("gi,gi->g", along, self.normals)[:, None]
        first = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        return np.stack([first, np.cross(self.normals, first)], 1)

    @cached_property
    def on_loop(self):
        mask = np.zeros(len(self.rest), bool)
        for loop in self.loops:
            mask[loop] = True
        return mask

    @cached_property
    def own_face(self):
        """A face (g,) of each vertex."""
        face = np.zeros(len(self.rest), np.int32)
        face[self.faces.ravel()] = np.repeat(np.arange(len(self.faces), dtype=np.int32), 3)
        return face

    @cached_property
    def cotangents(self):
        """Weights (e,) of the edges."""
        L = kernels.cotangent_laplacian(self.rest, self.faces).tocsr()
        return np.clip(np.asarray(L[self.edges[:, 0], self.edges[:, 1]]).ravel(), *COTANGENT)

    @cached_property
    def smoothness(self):
        """Sparse (2g,2g): sum over edges of w |d_i - R_ij d_j|^2, R_ij carrying tangents from j to i, w cotangents."""
        w, (i, j) = self.cotangents, self.edges.T
        turned = _turn(self.normals[j], self.normals[i], self.frames[j])  # (e,2,3)
        R = np.einsum("eax,ebx->eab", self.frames[i], turned)  # d_j in the frame of i
        n = len(self.rest)
        rows, columns, values = [], [], []

        def put(r, c, block):
            for a in range(2):
                for b in range(2):
                    rows.append(2 * r + a), columns.append(2 * c + b), values.append(block[:, a, b])

        eye = np.broadcast_to(np.eye(2), (len(i), 2, 2)) * w[:, None, None]
        put(i, i, eye)
        put(j, j, np.einsum("e,eba,ebc->eac", w, R, R))
        put(i, j, -w[:, None, None] * R)
        put(j, i, -w[:, None, None] * R.transpose(0, 2, 1))
        return sparse.csc_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(2 * n,) * 2
        )

    def vectors(self, d):
        """Slides (g,2) as vectors in space (g,3)."""
        return np.einsum("ga,gax->gx", d, self.frames)

    def places(self, points, start):
        """face, bary of the places nearest to `points` that are reached on the surface from the faces `start`: where a sleeve
        hangs along the trunk, the nearest place of all may be the sleeve's."""
        face, _, bary, _ = self.index.reached(points, start)
        return face, bary

    def slid(self, d):
        """face (g,), bary (g,3): where each vertex lies on the surface after the slide; loops stay on themselves."""
        target = self.rest + self.vectors(d)
        face, bary = self.places(target, self.own_face)
        for loop in self.loops:
            face[loop], bary[loop] = self._along(loop, target[loop])
        return face, bary

    def _along(self, loop, points):
        """face, bary of the points nearest to `points` (k,3) on a loop."""
        segment, s, _ = nearest_on_polyline(points, self.rest[loop])
        ends = np.stack([loop, np.roll(loop, -1)], 1)[segment]
        face = self._face_of_edge(ends)
        corner = self.faces[face]
        return face, (corner == ends[:, :1]) * (1 - s)[:, None] + (corner == ends[:, 1:]) * s[:, None]

    @cached_property
    def _half_edges(self):
        """Codes of the faces' edges, rising, and the face of each."""
        edges = np.sort(sides(self.faces), axis=1).astype(np.int64)
        code = edges[:, 0] * len(self.rest) + edges[:, 1]
        order = np.argsort(code, kind="stable")
        return code[order], (order % len(self.faces)).astype(np.int32)

    def _face_of_edge(self, ends):
        code, face = self._half_edges
        ends = np.sort(ends, axis=1).astype(np.int64)
        return face[np.searchsorted(code, ends[:, 0] * len(self.rest) + ends[:, 1])]

    def points_at(self, V, face, bary):
        """The posed surface V (g,3) at places face, bary."""
        return np.einsum("gk,gki->gi", bary, V[self.faces[face]])

    def curved_points_at(self, V, face, bary):
        """The same on a curved surface through the vertices, so that none is lost by cutting corners: Phong tessellation
        (Boubekeur and Alexa 2008), and along loops cubics with the slopes of Catmull and Rom."""
        corner = self.faces[face]
        x, normal = self.points_at(V, face, bary), kernels.vertex_normals(V, self.faces)[corner]
        off = np.einsum("gki,gki->gk", x[:, None] - V[corner], normal)  # above the tangent plane at each corner
        x = x - PHONG * np.einsum("gk,gk,gki->gi", bary, off, normal)
        for loop in self.loops:
            x[loop] = self._on_cubic(V, loop, corner[loop], bary[loop])
        return x

    def _on_cubic(self, V, loop, corner, bary):
        """Places (k,) with two corners on a loop's edge, each on the cubic over that edge."""
        slope = np.zeros_like(V)
        slope[loop] = (V[np.roll(loop, -1)] - V[np.roll(loop, 1)]) / 2
        order, k = np.argsort(-bary, axis=1, kind="stable"), np.arange(len(loop))
        a, b = corner[k, order[:, 0]], corner[k, order[:, 1]]
        s, step = bary[k, order[:, 1]][:, None], V[b] - V[a]
        sign = np.where(np.einsum("ki,ki->k", slope[a], step) < 0, -1.0, 1.0)[:, None]
        size = np.linalg.norm(step, axis=1, keepdims=True)
        A, B = (
            sign * size * slope[v] / np.maximum(np.linalg.norm(slope[v], axis=1, keepdims=True), 1e-12) for v in (a, b)
        )
        return V[a] + (3 - 2 * s) * s**2 * step + s * (1 - s) ** 2 * A - s**2 * (1 - s) * B


def _turn(a, b, vectors):
    """Vectors (e,k,3) turned by the least rotation that takes unit normals a to b (e,3)."""
    axis, cosine = np.cross(a, b), np.einsum("ei,ei->e", a, b)
    along = np.einsum("ei,eki->ek", axis, vectors) / np.maximum(1 + cosine, 1e-9)[:, None]
    return cosine[:, None, None] * vectors + np.cross(axis[:, None], vectors) + along[..., None] * axis[:, None]
