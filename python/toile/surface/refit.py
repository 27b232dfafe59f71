"""A garment made for one body, laid on another of the same model: it keeps its shape as far as the other body lets it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import kernels
from ..kernels import CholeskyFactor
from .attachments import Attachments
from .operators import sides, umbrella_laplacian

REACH = 0.3  # [m] over which the skeleton's say fades against the garment's own shape
CLEARANCE = 0.005  # [m] asked off the body, less where the garment lay nearer to its owner's
ROUNDS = 30
STILL = 1e-4  # [m] a round that moves no vertex farther is the last


@dataclass(frozen=True)
class Wearer:
    """A body at rest that a garment lies on."""

    vertices: np.ndarray  # (n,3) [m]
    joints: np.ndarray  # (K,3) [m]


def refit(layer, owner: Wearer, wearer: Wearer, skin_faces):
    """Rest vertices (g,3) [m] of a garment's Layer on `wearer`, from those on `owner`; both skins have the same faces (m,3).

    Each vertex goes where its joints go, c_i = g_i + sum_k w_ik (J'_k - J_k). Near these places lies the as-rigid-as-possible
    shape (Sorkine and Alexa 2007)

        argmin_{x,R} sum_ij |(x_i - x_j) - R_i (g_i - g_j)|^2 + (h / REACH)^2 sum_i |x_i - c_i|^2,  h the mean edge length,

    whose edges turn rather than stretch; what comes nearer the body than CLEARANCE, or than it lay to the owner's, is pushed
    out. Parts without a loop, such as buttons, follow the cloth. On its owner's body it is the garment's own rest, to the bit.
    """
    if np.array_equal(owner.vertices, wearer.vertices) and np.array_equal(owner.joints, wearer.joints):
        return layer.rest
    parts = Attachments(layer.faces, len(layer.rest))
    at, F = parts.cloth, parts.faces
    moved = np.einsum("gb,gbc->gc", layer.skin_val[at], (wearer.joints - owner.joints)[layer.skin_idx[at]])
    g = layer.rest[at]
    clearance = np.minimum(CLEARANCE, kernels.signed_distance(g, owner.vertices, skin_faces))
    x = _laid(g, F, g + moved, clearance, wearer.vertices, skin_faces)
    clear = kernels.untangle(x, F, wearer.vertices, skin_faces, margin=CLEARANCE)
    return parts.follow(layer.rest, np.asarray(clear.V))


def strain_of(faces, before, after):
    """(e,) elongations of the edges of faces (m,3) from vertices `before` (n,3) to `after`, over their lengths."""
    i, j = kernels.unique_edges(faces).T
    lengths = [np.linalg.norm(V[i] - V[j], axis=1) for V in (before, after)]
    return lengths[1] / np.maximum(lengths[0], 1e-9) - 1


def _laid(g, F, places, clearance, skin, skin_faces):
    """The shape of `refit`, by local and global steps from `places` (n,3)."""
    i, j = np.unique(np.concatenate([s := sides(F), s[:, ::-1]]), axis=0).T  # each edge both ways
    edges, L = g[i] - g[j], umbrella_laplacian(F, len(g))
    anchor = (np.linalg.norm(edges, axis=1).mean() / REACH) ** 2
    off, factor, x = _Off(skin, skin_faces), CholeskyFactor(), places
    for _ in range(ROUNDS):
        short, pushed = off(x, clearance)
        R = _turns(i, edges, x[i] - x[j], len(x))
        right = anchor * places + short[:, None] * pushed
        np.add.at(right, i, np.einsum("eab,eb->ea", R[i] + R[j], edges) / 2)
        before, x = x, factor.factorize(_plus_diagonal(L, anchor + short)).solve(right)
        if np.abs(x - before).max() < STILL:
            break
    return x


def _plus_diagonal(L, values):
    from scipy.sparse import diags

    return (L + diags(values)).tocsc()


def _turns(i, edges, now, n):
    """Rotations (n,3,3) that take the `edges` (e,3) from each vertex i nearest to what they are `now` (Kabsch 1976)."""
    S = np.zeros((n, 3, 3))
    np.add.at(S, i, now[:, :, None] * edges[:, None])
    U, _, Wt = np.linalg.svd(S)
    U[:, :, 2] *= np.where(np.linalg.det(U @ Wt) < 0, -1, 1)[:, None]
    return U @ Wt


class _Off:
    """What of a garment comes too near to a skin V (n,3) with faces F, and where it belongs."""

    def __init__(self, V, F):
        self.V, self.F, self.index, self.normals = V, F, kernels.SurfaceIndex(V, F), kernels.face_normals(V, F)

    def __call__(self, x, clearance):
        """(g,) 1.0 where a vertex of x (g,3) is nearer than its clearance (g,), inside is negative; places (g,3) at it."""
        face, closest, _, gap = self.index.closest(x)
        distance = kernels.signed_distance(x, self.V, self.F)
        away = np.sign(distance)[:, None] * (x - closest) / np.maximum(gap, 1e-9)[:, None]
        outward = np.where(gap[:, None] > 1e-9, away, self.normals[face])
        return (distance < clearance).astype(float), closest + clearance[:, None] * outward
