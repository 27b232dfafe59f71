"""A calibrated rig around the person: a ring at two heights, slightly distorted lenses, off-centre principal points."""

from __future__ import annotations

import numpy as np

from ..scene import Camera

RADIUS = 3.2  # m from the middle of the stage
HEIGHTS = (1.0, 1.9)  # m, in turns
TARGET = np.array([0.0, 0.0, 0.92])  # m
VISIBLE = 2.25  # m of height that the image spans at the target


def make_cameras(count, size, rng, span=VISIBLE, pinhole=False):
    """`count` square cameras of `size` pixels; camera 0 sees the front (person faces -y).

    `pinhole`: the same rig with ideal lenses and square pixels, as the path tracer has them.
    """
    cameras = []
    for i in range(count):
        angle = 2 * np.pi * i / count + rng.normal(0, 0.03)
        eye = np.array([RADIUS * np.sin(angle), -RADIUS * np.cos(angle), HEIGHTS[i % 2] + rng.normal(0, 0.03)])
        distance = np.linalg.norm(eye - TARGET)
        focal = size * distance / span * rng.uniform(0.99, 1.01)
        centre = size / 2 + rng.normal(0, 0.006, 2) * size
        K = np.array([[focal, 0, centre[0]], [0, focal * rng.uniform(0.998, 1.002), centre[1]], [0, 0, 1]])
        distortion = np.array([-0.03, 0.008, 2e-4, -2e-4, 0.0]) + rng.normal(0, [5e-3, 2e-3, 1e-4, 1e-4, 1e-3])
        if pinhole:
            K[1, 1], distortion = focal, np.zeros(5)
        T = look_at(eye, TARGET + rng.normal(0, 0.02, 3))
        cameras.append(Camera(f"cam{i:02d}", size, size, K, distortion, T))
    return cameras


def look_at(eye, target):
    """T_camera_world (4,4): x right, y down, z forward, world z up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ eye
    return T


def cameras_json(cameras):
    return {
        "cameras": [
            {
                "name": c.name, "width": c.width, "height": c.height, "K": c.K.tolist(),
                "distortion": c.distortion.tolist(), "T_camera_world": c.T_camera_world.tolist(),
            }
            for c in cameras
        ]
    }  # fmt: skip
