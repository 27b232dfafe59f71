"""What a garment takes over from the body it lies on: skinning weights, fit; and its texture coordinates."""

import numpy as np

from .. import kernels
from .operators import adjacency, neighbour_mean, sides, smooth_on

_CARRY_NEIGHBOURS = 24
# m, degrees: so near to the body and so much along it, cloth moves as the body there
SURE_REACH, SURE_ANGLE = 0.05, 30.0
# what sure values count against others; m: over so much the others are smoothed
SURE, SCALE = 1e6, 0.1


def unwrap(V, F):
    """UVs (t,2) in the unit square and (m,3) indices into them, by xatlas; the order of faces is kept."""
    import xatlas

    origin, face_uv, uv = xatlas.parametrize(V.astype(np.float32), F.astype(np.uint32))
    if not np.array_equal(origin[face_uv], F):
        raise RuntimeError("xatlas changed the order of the faces")
    return uv.astype(np.float64), face_uv.astype(np.int32)


def transfer_skin(model, V, F, smoothing):
    """Skinning weights (g,K) of garment vertices over the body at rest, smoothed. From the closest points where cloth lies along the
    body; between, as from one leg to the other in a skirt, where the closest point leaps, a smooth fill (after Abdrashitov,
    Raichstat, Monsen and Hill 2023, "Robust Skin Weights Transfer via Weight Inpainting")."""
    dense = np.zeros((len(model.v_template), len(model.parents)))
    np.put_along_axis(dense, np.asarray(model.weights_idx, np.int64), model.weights_val, axis=1)
    face, _, bary, distance = kernels.SurfaceIndex(model.v_template, model.f).closest(V)
    along = np.einsum("gi,gi->g", kernels.vertex_normals(V, F), kernels.face_normals(model.v_template, model.f)[face])
    sure = (along > np.cos(np.radians(SURE_ANGLE))) & (distance < SURE_REACH)
    skin = smooth_on(F, _filled(V, F, np.einsum("gc,gck->gk", bary, dense[model.f[face]]), sure), smoothing)
    skin[skin < 1e-4] = 0
    return skin / skin.sum(1, keepdims=True)


def _filled(V, F, values, sure):
    """argmin_w sum_i c_i |w_i - values_i|^2 + SCALE^4 |(laplacian w)_i|^2 over a mesh, not below 0; c_i is SURE where values (g,K) are `sure`
    (g,), else 1. The Laplacian is that of evenly spaced vertices: 4 / h^2 times the mean of the neighbours less w, h^2 their mean squared distance."""
    from scipy.sparse import diags, identity

    i, j = kernels.unique_edges(F).T
    h2 = np.square(V[i] - V[j]).sum(1).mean()
    L = 4 / h2 * (identity(len(V)) - neighbour_mean(adjacency(sides(F), len(V))))
    c = np.where(sure, SURE, 1.0)
    factor = kernels.CholeskyFactor().factorize((diags(c) + SCALE**4 * (L.T @ L)).tocsc())
    return np.maximum(factor.solve(c[:, None] * values), 0)


def move_with_body(points, start, end, reach):
    """Points (g,3) moved by the displacement start -> end (n,3) of the body vertices about them, a Gaussian mean of `reach`
    [m] over the nearest."""
    from scipy.spatial import cKDTree

    distance, near = cKDTree(start).query(points, k=min(_CARRY_NEIGHBOURS, len(start)))
    w = np.exp(-0.5 * ((distance - distance[:, :1]) / reach) ** 2)
    return points + np.einsum("gk,gkd->gd", w / w.sum(1, keepdims=True), (end - start)[near])
