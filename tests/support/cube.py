"""Three cameras that hide no mistake (unequal sides, principal points off the middle, turned and placed differently) and the
corners of a cube before them, whose pixels OpenCV itself says."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

CORNERS = np.array([[x, y, z] for x in (-0.4, 0.4) for y in (-0.3, 0.3) for z in (0.5, 1.4)])
NAMES = ("left", "front", "cam 3")


@dataclass(frozen=True)
class View:
    """What every format is written from: OpenCV's K (pixel centres at whole numbers) and its pose, world to camera [m]."""

    name: str
    width: int
    height: int
    K: np.ndarray
    distortion: np.ndarray  # k1 k2 p1 p2 k3
    R: np.ndarray
    t: np.ndarray

    @property
    def K_half(self):
        """K with pixel centres at halves."""
        K = self.K.copy()
        K[:2, 2] += 0.5
        return K

    @property
    def centre(self):
        return -self.R.T @ self.t

    @property
    def c2w(self):
        return np.vstack([np.c_[self.R.T, self.centre], [0, 0, 0, 1]])

    def pixels(self, points=CORNERS):
        """Where points land, with pixel centres at halves: cv2.projectPoints and half a pixel."""
        import cv2

        found = cv2.projectPoints(points, cv2.Rodrigues(self.R)[0], self.t, self.K, self.distortion)[0]
        return found.reshape(-1, 2) + 0.5


def views(distorted=True, names=NAMES, size=None):
    """Three views; `size` (width, height) for all where a format has one."""
    rng, found = np.random.default_rng(5), []
    for i, name in enumerate(names):
        angle = 0.4 + 2.0 * i
        centre = np.array([2.6 * np.sin(angle), -2.6 * np.cos(angle), 1.1 + 0.3 * i])
        z = np.array([0, 0, 1.0]) - centre
        z /= np.linalg.norm(z)
        x = np.cross(z, [0, 0, 1.0])
        x /= np.linalg.norm(x)
        R = Rotation.from_rotvec([0.02, 0.03, 0.25 - 0.3 * i]).as_matrix() @ np.stack([x, np.cross(z, x), z])
        width, height = size or ((480, 360), (300, 400), (512, 256))[i]
        K = np.array([[410.0 + 30 * i, 0, width / 2 + 17.3], [0, 402.0 + 35 * i, height / 2 - 11.7], [0, 0, 1]])
        bend = rng.normal(0, (0.05, 0.02, 0.002, 0.002, 0.01)) if distorted else np.zeros(5)
        found.append(View(name, width, height, K, bend, R, -R @ centre))
    return found


def check(cameras, written, metres=1.0, within=0.01):
    """The corners land where they should through each camera, whose translations are `metres` a unit."""
    assert set(cameras) == {view.name for view in written}
    for view in written:
        camera = cameras[view.name]
        pixels, depth = camera.project(CORNERS / metres)
        assert (depth > 0).all()
        assert np.abs(pixels - view.pixels()).max() < within, view.name
        assert camera.size in ((view.height, view.width), (0, 0))
