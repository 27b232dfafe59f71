"""A surface through oriented points, cut where nothing supports it."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import numpy as np

from ..errors import UserError
from ..kernels import vertex_components

WEIGHT = 4.0  # of the points against smoothness (Kazhdan, Hoppe 2013)


def poisson(points, normals, cell, largest_depth):
    """Screened Poisson surface of points (n,3) with outward normals (n,3): V (v,3), F (m,3), closed or nearly so. `cell` [m]
    is the octree's, unless that asks for more than `largest_depth` levels."""
    check_poisson()
    import pymeshlab

    extent = 1.1 * np.ptp(points, axis=0).max()
    depth = int(np.clip(np.ceil(np.log2(extent / cell)), 4, largest_depth))
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points, v_normals_matrix=normals))
    meshes.generate_surface_reconstruction_screened_poisson(depth=depth, pointweight=WEIGHT, preclean=True, threads=1)
    made = meshes.current_mesh()
    return np.array(made.vertex_matrix()), np.array(made.face_matrix(), dtype=np.int32)


def check_poisson():
    """UserError: what `poisson` needs is not installed."""
    if find_spec("pymeshlab") is None:
        raise UserError("scans need pymeshlab: pip install 'toile[stereo]'")


def load_poisson():
    """Loads the library of `poisson`, to be called in the main thread: a process where another thread loads it first aborts when
    it ends (pymeshlab 2025.7.post1: malloc_consolidate)."""
    if find_spec("pymeshlab") is not None:
        import_module("pymeshlab")


def keep_vertices(V, F, keep):
    """The part of a mesh whose faces have all their vertices kept (n,) bool; and the kept vertices' old numbers."""
    F = F[keep[F].all(1)]
    old, F = np.unique(F, return_inverse=True)
    return V[old], F.reshape(-1, 3).astype(np.int32), old


def large_pieces(F, n, share):
    """Vertices (n,) bool of the pieces that have at least this share of them."""
    piece = vertex_components(F, n)
    size = np.bincount(piece)
    return size[piece] >= share * n
