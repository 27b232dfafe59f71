"""Ambient occlusion of a mesh."""

from typing import Any

import numpy as np

from .. import _core
from .arrays import Array, Floats, as_faces, as_indices, as_vertices


def ambient_occlusion(
    V: Array, F: Array, rays: int = 64, seed: int = 0, of: Array | None = None, **options: Any
) -> Floats:
    """How much of an even sky does each vertex see?

    V: (n,3) float64 [m]; F: (m,3) int; rays: directions a vertex; seed: same seed, same bits; of: (k,) vertices that are
    asked for, all by default: the time is theirs. To shade several meshes by
    one another, pass them as one.

    Options: relative_offset=1e-4 (share of the mesh's diagonal by which rays start off the vertex, along its normal);
    reach=1e30 (what is farther away casts no shade [m]).

    -> (n,) or (k,) float64: the share, 0 to 1, of `rays` cosine-weighted directions about the area-weighted vertex normal that
    meet no face; 1 under an open sky and where a vertex has no normal. Both sides of a face cast shade. Bits do not
    depend on the number of threads.
    InputError: empty mesh, NaN or infinity, index out of range, `of` empty, rays not in 1..65536, relative_offset or reach not positive.
    Source: S. Zhukov, A. Iones, G. Kronin, An ambient light illumination model, EGWR 1998.
    """
    asked = as_indices("occlusion", "of", np.zeros(0, np.int32) if of is None else of)
    if of is not None and len(asked) == 0:
        raise _core.InputError("occlusion: of is empty")
    mesh = as_vertices("occlusion", "V", V), as_faces("occlusion", "F", F)
    return _core.ambient_occlusion(*mesh, asked, rays=rays, seed=seed, **options)
