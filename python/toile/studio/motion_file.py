"""Motion from a file, retargeted as `toile animate` does it and kept to what the studio can dress and picture."""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..io.motion import retargeted_motion
from .body import ACTIONS
from .motion import FPS, BodyMotion

ENDINGS = (".bvh", ".npz")
TRAVEL = 0.4  # m: the path on the floor is bent into a circle of this radius, to stay inside the rig
LOWERING = np.radians(18)  # below the A-pose at most: beyond, the skin of arm and trunk meets with the shirt between


def motion_of_file(path, body, frames):
    """The first `frames` frames at the studio's rate, of a .bvh file or a .npz of the SMPL family. UserError: it has fewer."""
    motion = retargeted_motion(path, body.model, body.J, FPS, np.zeros(3), lowest=LOWERING)
    if frames > len(motion):
        raise UserError(f"{path}: {len(motion)} frames at {FPS:g} fps, {frames} are needed with the ramp")
    root, expression = bent(motion.translation[:frames]), np.zeros((frames, len(ACTIONS)))
    return BodyMotion(motion.rotations[:frames], root, expression, grounded=False, missing=motion.missing)


def bent(path):
    """A path (T,3) kept within TRAVEL of its start on the floor."""
    path = path.copy()
    r = np.maximum(np.linalg.norm(path[:, :2], axis=1, keepdims=True), 1e-12)
    path[:, :2] *= TRAVEL * np.tanh(r / TRAVEL) / r
    return path
