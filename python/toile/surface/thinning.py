"""A scan by fewer triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import kernels
from ..scene import Mesh


def thinned(mesh: Mesh, spacing: float) -> Mesh:
    """The mesh by one vertex a cell of a grid of `spacing` [m], the mean of those in it (Rossignac and Borrel 1993). Sheets
    that lie in one cell and face other ways, as sleeve and side do, stay apart: each octant of normals counts by itself.
    Labels are those of the faces left, confidence is averaged, UVs are dropped. 0 leaves the mesh as it is."""
    if spacing == 0:
        return mesh
    V, F = mesh.vertices, mesh.faces
    place = _cell(V, kernels.vertex_normals(V, F), spacing)
    count = np.bincount(place)
    mean = lambda values: np.bincount(place, values) / count
    faces = place[F]
    a, b, c = np.sort(faces, axis=1).astype(np.int64).T
    whole = np.flatnonzero((a < b) & (b < c))
    n = len(count)
    _, first, listed = np.unique(((a * n + b) * n + c)[whole], return_index=True, return_counts=True)
    kept = whole[np.sort(first[listed % 2 == 1])]  # two on the same corners cancel: what was closed stays closed
    return replace(
        mesh,
        vertices=np.stack([mean(x) for x in V.T], axis=1),
        faces=faces[kept].astype(np.int32),
        uv=None,
        face_uv=None,
        face_labels=None if mesh.face_labels is None else mesh.face_labels[kept],
        confidence=None if mesh.confidence is None else mean(mesh.confidence),
    )


def _cell(V, N, spacing):
    """Number (n,) of each vertex's cell and octant among those that hold one."""
    i, j, k = np.floor((V - V.min(0)) / spacing).astype(np.int64).T
    octant = (N > 0) @ np.array([1, 2, 4])
    key = ((i * (j.max() + 1) + j) * (k.max() + 1) + k) * 8 + octant
    return np.unique(key, return_inverse=True)[1].ravel()
