"""The room that garments worn over one another need between parts of a body (docs/method/animation.md)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .. import kernels
from ..scene import Bools, Floats, Ints
from .dent import inwards
from .layers import Layer

MOST = 0.08  # [m] off the skin: what lies farther covers something else
FACING = 0.5  # cosine between the skin's normal and the way to the cloth: cloth beside it covers something else
KEPT = 0.5  # of its distance from the skin, where cloth is pressed


class Wrapping(NamedTuple):
    """Of each vertex of a skin: how `thick` (n,) [m] what covers it is, pressed, 0 where fewer than two garments do; and whether it is
    `under` (n,) a garment that goes under others. Cloth meets cloth of its own between two such places alone."""

    thick: Floats
    under: Bools

    @classmethod
    def none(cls, n: int) -> Wrapping:
        return cls(np.zeros(n), np.zeros(n, bool))

    def of(self, vertices: Ints | slice) -> Wrapping:
        return Wrapping(self.thick[vertices], self.under[vertices])


def wrapping(skin: Floats, faces: Ints, garments: Sequence[Layer]) -> Wrapping:
    """The Wrapping of a resting skin (n,3) with faces (m,3) in garments, inner to outer. A garment covers a vertex to which it comes
    within MOST, in front of the skin, and not by its border. Pressed, the outermost keeps the share KEPT of its distance."""
    if len(garments) < 2:
        return Wrapping.none(len(skin))
    outwards = -inwards(skin, faces)
    off = np.array([_distance(skin, outwards, garment) for garment in garments])
    over = np.isfinite(off)
    outermost = np.where(over, off, 0.0).max(0)
    return Wrapping(np.where(over.sum(0) > 1, KEPT * outermost, 0.0), over[:-1].any(0))


def _distance(skin, outwards, garment):
    """(n,) [m] from each vertex to a garment that covers it, infinite where it does not."""
    at_border = kernels.border_vertices(garment.faces, len(garment.rest))
    face, q, bary, distance = kernels.SurfaceIndex(garment.rest, garment.faces).closest(skin, MOST)
    by_border = (at_border[garment.faces[face]] | (bary < 1e-9)).all(1)
    in_front = np.einsum("nx,nx->n", q - skin, outwards) > FACING * distance
    return np.where((face >= 0) & in_front & ~by_border, distance, np.inf)
