"""Cloth hardly stretches: slides under which a garment's edges are as long as its template's, up to one scale a frame."""

from __future__ import annotations

import numpy as np

from .lattice import gradient

SCALED = 1.2  # a template that a run made larger or smaller by more is no longer the capture's


def true_lengths(mesh, own, faces):
    """Vertices (g,3) of the template whose edges' lengths the cloth keeps: those of the capture's `mesh`, where that has the
    run's `faces` and about the size of the run's `own` template (g,3), else those; None where there are none."""
    same = mesh is not None and np.array_equal(mesh.faces, faces)
    if same and (own is None or _size(own) / SCALED < _size(mesh.vertices) < _size(own) * SCALED):
        return mesh.vertices
    return own


def _size(V):
    return np.linalg.norm(np.ptp(V, axis=0))


class Lengths:
    """The edges of a SlidingSurface against their lengths in the `template` (g,3)."""

    def __init__(self, surface, template, settings):
        self.surface, self.settings = surface, settings
        self.i, self.j = surface.edges.T
        self.lengths = np.maximum(np.linalg.norm(template[self.i] - template[self.j], axis=1), 1e-6)
        self.gradient = gradient(surface.rest, surface.faces)
        L = surface.cotangents
        self.areas = L * self.lengths**2  # of the cloth that an edge stands for, doubled

    def equations(self, posed, places):
        """Of sum over edges of w (|x_i - x_j| / (c l) - 1)^2, x the `posed` surface (g,3) at the vertices' places: the 2x2
        blocks (2,2,e,2,2) of J'WJ by ends, and J'Wr (g,2). c is the frame's median ratio; w those of Welsch."""
        s, surface = self.settings, self.surface
        x = surface.points_at(posed, *places)
        J = np.einsum("gsr,gar->gsa", np.stack([G @ x for G in self.gradient], -1), surface.frames)  # dx / dd
        e = x[self.i] - x[self.j]
        length = np.maximum(np.linalg.norm(e, axis=1), 1e-9)
        c = np.median(length / self.lengths)
        r = length / (c * self.lengths) - 1
        w = np.exp(-0.5 * (r / s.edge_outlier) ** 2) * self.areas / (s.strain_length * s.edge_strain) ** 2
        u = e / (length * c * self.lengths)[:, None]
        ends = np.stack([np.einsum("es,esa->ea", u, J[self.i]), -np.einsum("es,esa->ea", u, J[self.j])])
        blocks = w[:, None, None] * ends[:, None, :, :, None] * ends[None, :, :, None, :]
        right = np.zeros((len(x), 2))
        np.add.at(right, self.i, (w * r)[:, None] * ends[0])
        np.add.at(right, self.j, (w * r)[:, None] * ends[1])
        return blocks, right
