"""The cameras that an animation is seen by: an avatar's own, new ones taken in turn, or one that goes round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...io.camera import read_cameras
from ...io.image import MAX_PIXELS
from ...scene import Camera
from ..model.assets import training_poses

ORBIT = "orbit"
SMALLEST = 2  # side of a picture [px]: films have even ones
ROUND = 10.0  # seconds of that camera's way about the person, whom it follows


def asked_cameras(own, camera, height=None):
    """[(Camera, its index among an avatar's `own`, -1 for a new one)] that are taken in turn, for `camera` as `animate` takes it, of
    pictures `height` pixels high, as its own by default; of ORBIT the one that it begins with. UserError: it is none, or one that pictures
    cannot be drawn by."""
    chosen = [(resized(one, height), i) for one, i in _named_cameras(own, camera)]
    for one, _ in chosen:
        if min(one.size) < SMALLEST or one.width * one.height > MAX_PIXELS:
            bounds = f"expected at least {SMALLEST} a side, and at most {MAX_PIXELS} pixels in all"
            raise UserError(f"--camera, --height: pictures of {one.width} x {one.height} pixels, {bounds}")
    return chosen


def _named_cameras(own, camera):
    known = {one.name: [(one, i)] for i, one in enumerate(own)}
    if camera is None:
        return [(own[0], 0)]
    if camera == ORBIT:
        return [(own[0], -1)]
    if camera in known:
        return known[camera]
    if not Path(camera).is_file():
        raise UserError(f"--camera {camera}: expected {ORBIT}, a cameras.json, or one of {', '.join(known)}")
    cameras = list(read_cameras(Path(camera)).values())
    if not cameras:
        raise UserError(f"{camera}: cameras: there is none")
    if any(np.any(one.distortion) for one in cameras):
        raise UserError(f"{camera}: distortion: pictures are drawn by pinhole cameras")
    if len({one.size for one in cameras}) > 1:
        raise UserError(f"{camera}: width, height: the cameras of a path have one size")
    return [(one, -1) for one in cameras]


def camera_path(driven, camera, height):
    """A function from the motion's row of a DrivenAvatar to (Camera, its index among the avatar's, -1 for a new one)."""
    cameras = asked_cameras(driven.avatar.cameras, camera, height)
    if camera != ORBIT:
        return lambda i: cameras[i % len(cameras)]
    (first, index), to = cameras[0], driven.motion.translation
    home = training_poses(driven.folder)["translation"].mean(0)  # where that camera saw the person
    up, times = driven.avatar.up.cpu().numpy().astype(np.float64), driven.motion.frames / driven.motion.fps
    angles = 2 * np.pi / ROUND * (times - times[0])
    return lambda i: (turned(followed(first, to[i] - home, up), to[i], up, angles[i]), index)


def resized(camera: Camera, height):
    """The same view, `height` pixels high."""
    if height is None:
        return camera
    scale = height / camera.height
    K = np.diag([scale, scale, 1.0]) @ camera.K
    return replace(camera, K=K, width=round(camera.width * scale), height=height)


def followed(camera, way, up):
    """The camera carried along with who has gone the `way` (3,) [m], on the level."""
    carried = np.eye(4)
    carried[:3, 3] = way - (way @ up) * up
    return replace(camera, T_camera_world=camera.T_camera_world @ np.linalg.inv(carried))


def turned(camera, centre, up, angle):
    """The camera carried about an axis `up` through `centre` by `angle` [rad]."""
    from scipy.spatial.transform import Rotation

    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(angle * up).as_matrix()
    turn[:3, 3] = centre - turn[:3, :3] @ centre
    return replace(camera, T_camera_world=camera.T_camera_world @ np.linalg.inv(turn))
