"""Motion from a BVH file, kept to what the studio can dress and picture."""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..io import bvh as io
from .body import ACTIONS
from .motion import FPS, BodyMotion

TRAVEL = 0.4  # m: the path on the floor is bent into a circle of this radius, to stay inside the rig
LOWERING = np.radians(18)  # below the A-pose at most: beyond, the skin of arm and trunk meets with the shirt between


def bvh_motion(path, body, frames):
    """The first `frames` frames at the studio's rate, from the first that is not a lone calibration pose."""
    from scipy.spatial.transform import Rotation

    bvh = io.read_bvh(path)
    found, missing = io.matches(bvh)
    if "root" not in found:
        raise UserError(f"{path}: no joint named like Hips")
    bvh = io.standing(path, bvh, found)
    start, step = io.starts_at(bvh), 1 / (FPS * bvh.frame_time)
    pick = start + np.rint(np.arange(frames) * step).astype(int)
    if pick[-1] >= len(bvh):
        have = int((len(bvh) - 1 - start) / step) + 1
        raise UserError(f"{path}: {have} frames at {FPS:g} fps, {frames} are needed with the ramp")
    R = io.retarget(io.facing(bvh, pick, found), bvh, body.model, body.J, found, LOWERING)
    local = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(frames, -1, 3)
    root = bent(io.floor_path(bvh, pick, body.model, body.J, found))
    return BodyMotion(local, root, np.zeros((frames, len(ACTIONS))), grounded=False, missing=tuple(missing))


def bent(path):
    """A path (T,3) kept within TRAVEL of its start on the floor."""
    path = path.copy()
    r = np.maximum(np.linalg.norm(path[:, :2], axis=1, keepdims=True), 1e-12)
    path[:, :2] *= TRAVEL * np.tanh(r / TRAVEL) / r
    return path
