"""The same edit on the single-layer baseline: its UVs are marked where the garment lies in one frame, then held fixed.

In that frame every texel of the surface takes the nearest point of the registered garment: those that it covers are the
region, and the garment's UV there carries the edit over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ... import kernels
from ...surface.uv import UvMap

REACH = 0.02  # from the surface to the garment that it shows, at most [m]
ON_EDGE = 1e-6  # a barycentric weight that is zero


@dataclass(frozen=True)
class Marked:
    """What of a surface's UV square shows a garment."""

    region: np.ndarray  # (S,S) bool
    uv: np.ndarray  # (S,S,2) of the garment, where the region is


def mark(surface, surface_V, garment, garment_V, size):
    """Marks the surface's texels in a frame, from the vertices of both layers there; a texel beyond the garment's border
    has its nearest point on a boundary edge."""
    texels = UvMap(surface, size)
    shown = np.flatnonzero(texels.valid)
    normals = kernels.vertex_normals(surface_V, surface.faces)
    points, normals = (texels.texels(values).reshape(-1, 3)[shown] for values in (surface_V, normals))
    face, _, bary, distance = kernels.SurfaceIndex(garment_V, garment.faces).closest(points)
    facing = np.einsum("ki,ki->k", normals, kernels.face_normals(garment_V, garment.faces)[face]) > 0
    region, uv = np.zeros(size * size, bool), np.zeros((size * size, 2))
    region[shown] = (distance < REACH) & facing & ~on_border(garment.faces, face, bary)
    uv[shown] = np.einsum("kc,kcx->kx", bary, garment.uv[garment.face_uv[face]])
    return Marked(region.reshape(size, size), uv.reshape(size, size, 2))


def on_border(faces, face, bary):
    """Do points (k,), given by face and barycentric weights, lie on a boundary edge or vertex of the mesh?"""
    edges = np.sort(faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2)  # edge i lies opposite corner i
    _, inverse, count = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    open_edge = (count[inverse.ravel()] == 1).reshape(-1, 3)
    open_vertex = np.zeros(faces.max() + 1, bool)
    open_vertex[edges[open_edge]] = True
    zero = bary < ON_EDGE
    at_vertex = zero.sum(1) == 2
    corner = faces[face, bary.argmax(1)]
    return np.where(at_vertex, open_vertex[corner], (zero & open_edge[face]).any(1))


def edit_of_surface(edit, surface, marked):
    """An Edit of a garment as one of the surface's."""
    import cv2

    side = len(edit.cover)
    at = np.stack([marked.uv[..., 0] * side, (1 - marked.uv[..., 1]) * side], -1).astype(np.float32) - 0.5

    def read(picture):
        return cv2.remap(picture, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    cover = np.where(marked.region, read(edit.cover), 0).astype(np.uint8)
    colour = None if edit.colour is None else read(edit.colour)
    return replace(edit, layer=surface.name, cover=cover, colour=colour)
