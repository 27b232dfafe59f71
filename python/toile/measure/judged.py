"""What a verdict is given: surfaces with what was found of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import kernels
from ..kernels.arrays import Bools

COVERED = 0.1  # m: so far a garment may hang off what it covers
GAP = 0.02  # m: into a narrower one, as between a sleeve and the trunk beside it, nothing looks


@dataclass(frozen=True)
class JudgedLayer:
    """A surface that a frame was registered as. `label`: of the scan's points that are its own; None for all of them."""

    name: str
    label: int | None
    vertices: np.ndarray  # (n,3) [m]
    faces: np.ndarray  # (m,3)
    confidence: np.ndarray  # (n,)
    looks: np.ndarray  # indices (k,) of the vertices that a scan can show


def uncovered(garments: Sequence[JudgedLayer]) -> list[JudgedLayer]:
    """Garments, inner to outer, of which those vertices look that no garment farther out covers or faces across a GAP; all where none
    is left."""
    out = []
    for i, layer in enumerate(garments):
        bare = np.ones(len(layer.vertices), bool)
        for over in garments[i + 1 :]:
            bare &= ~_covered(layer, over)
        out.append(replace(layer, looks=np.flatnonzero(bare)) if bare.any() else layer)
    return out


def covered_shares(layers: Sequence[JudgedLayer]) -> dict[str, float]:
    """Of each `uncovered` garment but the outermost the share at which nothing looks."""
    return {layer.name: 1 - len(layer.looks) / len(layer.vertices) for layer in layers[:-1]}


def _covered(layer: JudgedLayer, over: JudgedLayer) -> Bools:
    """Which vertices lie within COVERED behind a garment, their closest point of it none of its border, or face it across a GAP."""
    V = layer.vertices
    face, point, weight, distance = kernels.SurfaceIndex(over.vertices, over.faces).closest(V, COVERED)
    normal = kernels.face_normals(over.vertices, over.faces)[face]
    border = np.zeros(len(over.vertices), bool)
    border[np.concatenate(kernels.boundary_loops(over.faces))] = True
    at_border = ((weight > 0) & ~border[over.faces[face]]).sum(1) == 0
    behind = (np.einsum("ni,ni->n", V - point, normal) < 0) & ~at_border
    opposed = np.einsum("ni,ni->n", kernels.vertex_normals(V, layer.faces), normal) < 0
    return (face >= 0) & (behind | (opposed & (distance < GAP)))
