"""How far poses lie from one another, whole and joint by joint."""

from __future__ import annotations

import numpy as np

JOINT_FAR = 20.0  # degrees: a joint that is farther from where every other pose had it is warned of


def joint_distances(rotations, others):
    """(T,K-1) geodesic angles [degrees] of the joints below the root between a pose (K,3) and each of (T,K,3).

    Rotation vectors relative to the parent; the root is left out, since avatars unpose it.
    """
    from scipy.spatial.transform import Rotation

    others = np.asarray(others, dtype=np.float64)
    T, K = others.shape[:2]
    if T == 0:
        return np.zeros((0, K - 1))
    a = Rotation.from_rotvec(np.tile(np.asarray(rotations, np.float64)[1:], (T, 1)))
    b = Rotation.from_rotvec(others[:, 1:].reshape(-1, 3))
    return np.degrees((a.inv() * b).magnitude().reshape(T, K - 1))


def pose_distance(rotations, others):
    """(T,) mean over the joints of their distances."""
    return joint_distances(rotations, others).mean(1)


def nearest_poses(rotations, others):
    """How far a pose (K,3) lies from the nearest of (T,K,3) as a whole, by `pose_distance`, and how far each of its joints from where any of
    them has it (K-1,) [degrees]; nan without others."""
    apart = joint_distances(rotations, others)
    return (apart.mean(1).min(), apart.min(0)) if len(apart) else (np.nan, np.full(apart.shape[1], np.nan))


def joints_apart(frames, alone, names, whose):
    """[] or a warning: a joint lies where the poses `whose` never had it, though its pose may be near one of them in the mean.

    alone (F,K-1): how far each frame's joints lie from there [degrees]; names of those joints.
    """
    far = (alone > JOINT_FAR).any(1)
    if not far.any():
        return []
    frame, joint = np.unravel_index(alone.argmax(), alone.shape)
    return [
        f"{far.sum()} of {len(far)} poses have a joint more than {JOINT_FAR:.0f} degrees from where {whose} had it: in frame "
        f"{frames[frame]} {names[joint]} is {alone[frame, joint]:.0f} degrees off; it is drawn as the farthest that was taught"
    ]
