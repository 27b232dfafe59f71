"""How far poses lie from one another, whole and joint by joint."""

from __future__ import annotations

import numpy as np

from ...frame_numbers import evenly

ASKED = 256  # poses that tell how far they usually lie from one another
LEAN_FAR = 45.0  # degrees: a body that leans so much farther than every other pose is warned of
JOINT_FAR = 20.0  # degrees: a joint that is farther from where every other pose had it is warned of


def nearest_poses(rotations, others):
    """How far each pose of (F,K,3) lies from the nearest of (T,K,3), the mean over its joints (F,), and how far each of its joints from
    where any of them has it (F,K-1) [degrees]; nan without others.

    Rotation vectors relative to the parent; the root is left out, since avatars unpose it.
    """
    one, other = quaternions(rotations), quaternions(others)
    whole, alone = np.full(len(one), np.nan), np.full(one.shape[:2], np.nan)
    for i, q in enumerate(one if len(other) else ()):
        apart = joint_angles(q, other)
        whole[i], alone[i] = apart.mean(1).min(), apart.min(0)
    return whole, alone


def leans(rotations, others, up):
    """How far up (3,) lies, as the roots of poses (F,K,3) see it, from where any of (T,K,3) sees it (F,) [degrees]; nan without others."""
    from scipy.spatial.transform import Rotation

    if not len(others):
        return np.full(len(rotations), np.nan)
    seen, known = (Rotation.from_rotvec(np.asarray(r)[:, 0]).inv().apply(up) for r in (rotations, others))
    return np.degrees(np.arccos(np.clip((seen @ known.T).max(1), -1, 1)))


def usual_distance(rotations, frames, apart):
    """How far [degrees] 95 % of the poses (F,K,3) of these frames (F,) are at most from the nearest that is not their neighbour in time:
    `apart` frames or more away, where there is one. Of many poses ASKED are asked."""
    poses, found = quaternions(rotations), []
    for i in evenly(range(len(poses)), ASKED):
        far = np.abs(frames - frames[i]) >= apart
        others = poses[far if far.any() else frames != frames[i]]
        found.append(joint_angles(poses[i], others).mean(1).min() if len(others) else 0.0)
    return float(np.quantile(found, 0.95))


def quaternions(rotations):
    """(T,K-1,4) of the joints below the root of poses (T,K,3)."""
    from scipy.spatial.transform import Rotation

    below = np.asarray(rotations, np.float64)[:, 1:]
    if not below.size:
        return np.zeros((*below.shape[:2], 4))
    return Rotation.from_rotvec(below.reshape(-1, 3)).as_quat().reshape(*below.shape[:2], 4)


def joint_angles(q, others):
    """(T,K) geodesic angles [degrees] between rotations (K,4) and (T,K,4), unit quaternions: 4 asin(d / 2) of the shorter chord d to q
    or to -q, which is the same rotation; the squares of both sum to 4."""
    away = others - q
    square = np.einsum("tki,tki->tk", away, away)
    return np.degrees(4 * np.arcsin(np.sqrt(np.minimum(square, np.maximum(4 - square, 0))) / 2))


def leaning(frames, lean, whose):
    """[] or a warning: a body leans as in no pose `whose`, by `leans` (F,) [degrees]."""
    far = lean > LEAN_FAR
    if not far.any():
        return []
    worst = int(np.nanargmax(lean))
    return [
        f"{far.sum()} of {len(far)} poses lean more than {LEAN_FAR:.0f} degrees farther than any of {whose}: frame {frames[worst]} by "
        f"{lean[worst]:.0f} degrees; is the motion's up axis the scene's?"
    ]


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
