"""What a garment takes over from the body it lies on: skinning weights, fit; and its texture coordinates."""

import numpy as np

from .. import kernels
from .operators import smooth_on

_CARRY_NEIGHBOURS = 24


def unwrap(V, F):
    """UVs (t,2) in the unit square and (m,3) indices into them, by xatlas; the order of faces is kept."""
    import xatlas

    origin, face_uv, uv = xatlas.parametrize(V.astype(np.float32), F.astype(np.uint32))
    if not np.array_equal(origin[face_uv], F):
        raise RuntimeError("xatlas changed the order of the faces")
    return uv.astype(np.float64), face_uv.astype(np.int32)


def transfer_skin(model, V, F, smoothing):
    """Skinning weights (g,K) of garment vertices from the closest points of the body at rest, smoothed."""
    dense = np.zeros((len(model.v_template), len(model.parents)))
    np.put_along_axis(dense, np.asarray(model.weights_idx, np.int64), model.weights_val, axis=1)
    face, _, bary, _ = kernels.SurfaceIndex(model.v_template, model.f).closest(V)
    skin = smooth_on(F, np.einsum("gc,gck->gk", bary, dense[model.f[face]]), smoothing)
    skin[skin < 1e-4] = 0
    return skin / skin.sum(1, keepdims=True)


def move_with_body(points, start, end, reach):
    """Points (g,3) moved by the displacement start -> end (n,3) of the body vertices about them, a Gaussian mean of `reach`
    [m] over the nearest."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(start).query(points, k=min(_CARRY_NEIGHBOURS, len(start)))
    w = np.exp(-0.5 * ((distance - distance[:, :1]) / reach) ** 2)
    return points + np.einsum("gk,gkd->gd", w / w.sum(1, keepdims=True), (end - start)[near])
