"""How thick garments are that are worn over one another: room that limbs leave them (docs/method/animation.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import kernels
from ..scene import Floats
from .layers import Layer

MOST = 0.08  # [m] off the skin: what lies farther covers something else
KEPT = 0.5  # of its distance from the skin, where cloth is pressed


def wrapping(skin: Floats, garments: Sequence[Layer]) -> Floats:
    """(n,) how thick [m] the garments are that cover each vertex of the resting skin (n,3), pressed: of the outermost one's
    distance the share KEPT, 0 where fewer than two cover it. A garment covers a vertex to which it comes within MOST, and not by
    its border."""
    over, off = np.zeros(len(skin), int), np.zeros(len(skin))
    for garment in garments:
        at_border = kernels.border_vertices(garment.faces, len(garment.rest))
        face, _, bary, distance = kernels.SurfaceIndex(garment.rest, garment.faces).closest(skin, MOST)
        beside = (at_border[garment.faces[face]] | (bary < 1e-9)).all(1)
        covers = (face >= 0) & ~beside
        over += covers
        off[covers] = np.maximum(off[covers], distance[covers])
    return np.where(over > 1, KEPT * off, 0.0)
