"""Kinematics of a skinned body: rotations along the tree of joints, and linear blend skinning by them.

Rotations stand about world axes relative to the parent. K joints with rest positions J (K,3) [m] and parents (K,), of which
parents[0] = -1 and each stands before its children; the posed joints have world rotations R (K,3,3) and positions x (K,3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .kernels.arrays import Anything, Array, Floats, Ints


def joint_transforms(
    parents: Sequence[int] | Ints, J: Anything, rotations: Array, translation: Anything
) -> tuple[Floats, Floats]:
    """Forward kinematics: R (K,3,3) and x (K,3), of rotation vectors (K,3) [rad] and a translation (3,) [m]."""
    from scipy.spatial.transform import Rotation

    return posed_joints(parents, J, Rotation.from_rotvec(rotations).as_matrix(), translation)


def posed_joints(
    parents: Sequence[int] | Ints, J: Anything, local: Anything, translation: Anything
) -> tuple[Floats, Floats]:
    """Forward kinematics of one frame or of many: R (...,K,3,3) and x (...,K,3), of rotation matrices `local` (...,K,3,3)."""
    R, x = np.empty_like(local), np.empty(local.shape[:-1])
    for k, p in enumerate(parents):
        if p < 0:
            R[..., k, :, :], x[..., k, :] = local[..., k, :, :], J[k] + translation
        else:
            R[..., k, :, :] = R[..., p, :, :] @ local[..., k, :, :]
            x[..., k, :] = x[..., p, :] + R[..., p, :, :] @ (J[k] - J[p])
    return R, x


def blended_transforms(
    J: Anything, R: Anything, x: Anything, weights_idx: Anything, weights_val: Anything
) -> tuple[Floats, Floats]:
    """Per vertex A (n,3,3) and b (n,3) so that skinning is A v + b, by weights (n,B) of the joints `weights_idx` (n,B)."""
    from scipy.sparse import csr_matrix

    n, most = weights_idx.shape
    starts = np.arange(0, n * most + 1, most)
    return blended_by(csr_matrix((weights_val.ravel(), weights_idx.ravel(), starts), shape=(n, len(R))), J, R, x)


def blended_by(weights: Anything, J: Anything, R: Anything, x: Anything) -> tuple[Floats, Floats]:
    """`blended_transforms` by weights (n,K) of all joints, dense or sparse."""
    bones = np.concatenate([R.reshape(-1, 9), x - np.einsum("kij,kj->ki", R, J)], axis=1)
    blended = weights @ bones
    return blended[:, :9].reshape(-1, 3, 3), blended[:, 9:]


def unblended(posed: Anything, A: Anything, b: Anything) -> Floats:
    """Rest vertices (n,3) of posed ones (n,3): A^-1 (v - b)."""
    rest: Floats = np.linalg.solve(A, (posed - b)[..., None])[..., 0].astype(np.float64, copy=False)
    return rest


def blend_skinning(
    rest: Anything, J: Anything, R: Anything, x: Anything, weights_idx: Anything, weights_val: Anything
) -> Floats:
    """sum_k w_k (R_k (v - J_k) + x_k) for rest vertices (n,3)."""
    A, b = blended_transforms(J, R, x, weights_idx, weights_val)
    return np.einsum("nij,nj->ni", A, rest) + b
