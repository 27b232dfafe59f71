"""How far poses lie from one another."""

from __future__ import annotations

import numpy as np


def pose_distance(rotations, others):
    """Mean over the joints below the root of the geodesic angle [degrees] between a pose (K,3) and each of (T,K,3).

    Rotation vectors relative to the parent; the root is left out, since avatars unpose it.
    """
    from scipy.spatial.transform import Rotation

    others = np.asarray(others, dtype=np.float64)
    if len(others) == 0:
        return np.zeros(0)
    T, K = others.shape[:2]
    a = Rotation.from_rotvec(np.tile(np.asarray(rotations, np.float64)[1:], (T, 1)))
    b = Rotation.from_rotvec(others[:, 1:].reshape(-1, 3))
    return np.degrees((a.inv() * b).magnitude().reshape(T, K - 1).mean(1))
