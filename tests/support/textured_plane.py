"""Cameras before a tilted plane whose colours are a smooth function of the place: pictures exact to the ray."""

import numpy as np

from toile.scene import Camera

NORMAL = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])  # towards the cameras
FREQUENCIES = np.random.default_rng(3).normal(0, 150, (24, 3))  # [rad/m]: waves of a few pixels
PHASES = np.random.default_rng(4).uniform(0, 2 * np.pi, 24)


def cameras(count=4, size=(96, 128), spread=0.35, distance=1.0):
    """On an arc about the origin, all looking at it, somewhat rolled; pixels 1/160 of the distance large."""
    out = []
    for i in range(count):
        angle = spread * (i - (count - 1) / 2)
        eye = distance * np.array([np.sin(angle), 0.1 * (i % 2), -np.cos(angle)])
        z = -eye / np.linalg.norm(eye)
        x = np.cross([0.1 * i, 1, 0], z)
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3, :3] = np.stack([x, np.cross(z, x), z])
        T[:3, 3] = -T[:3, :3] @ eye
        K = np.array([[160.0, 0, size[1] / 2 + 3], [0, 160, size[0] / 2 - 2], [0, 0, 1]])
        out.append(Camera(f"cam{i}", size[1], size[0], K, np.zeros(5), T))
    return out


def hits(camera, distance=1.0):
    """Depth (H,W) [m] and place (H,W,3) where the pixels' rays meet the plane through the origin."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T @ camera.T_camera_world[:3, :3]
    depth = -(camera.centre @ NORMAL) / (rays @ NORMAL)
    return depth, camera.centre + depth[..., None] * rays


def picture(camera, scale=1.0, contrast=20.0):
    """Grey values (H,W) float32 of the plane's texture; `scale` stretches it with the scene."""
    _, place = hits(camera)
    waves = np.sin(place / scale @ FREQUENCIES.T + PHASES).sum(-1) / np.sqrt(12)
    return np.clip(128 + contrast * waves, 0, 255).astype(np.float32)


def ranges(cameras_, distance=1.0):
    return np.tile([0.6 * distance, 1.8 * distance], (len(cameras_), 1))
