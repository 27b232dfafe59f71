"""Cameras about a person."""

import numpy as np

from toile.scene import Camera


def ring_of_cameras(count, distortion=(-0.12, 0.05, 0.001, -0.002, 0.0)):
    cameras = {}
    for i in range(count):
        angle = 2 * np.pi * i / count
        centre = np.array([2.5 * np.sin(angle), -2.5 * np.cos(angle), 1.0 + 0.5 * (i % 2)])
        z = np.array([0, 0, 1.0]) - centre
        z /= np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        T = np.eye(4)
        T[:3, :3] = np.stack([x, np.cross(z, x), z])
        T[:3, 3] = -T[:3, :3] @ centre
        K = np.array([[560.0, 0, 256], [0, 560, 256], [0, 0, 1]])
        cameras[f"cam{i}"] = Camera(f"cam{i}", 512, 512, K, np.array(distortion), T)
    return cameras
