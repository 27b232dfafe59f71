"""What each camera sees of a surface: depth buffers, visibility of points, values read from pictures."""

import numpy as np

from . import kernels


class View:
    """One camera with the depth buffer of a surface. `depth` (H,W) [m], +inf where empty; `face` (H,W), -1 there."""

    def __init__(self, camera, V, F):
        self.camera = camera
        p = camera.to_camera(V)
        z = np.maximum(p[:, 2:], 1e-3)
        # the pinhole picture of moved vertices is the distorted picture, up to the bend inside one triangle
        moved = np.concatenate([camera.distort(p[:, :2] / z) * z, p[:, 2:]], axis=1)
        result = kernels.raster(moved, F, camera.K, camera.size)
        self.depth, self.face = result.depth, result.face

    def see(self, points, normals, tolerance, min_cosine):
        """Pixels (n,2) of points (n,3), and weights (n,): the cosine to the view where visible, else 0."""
        uv, clear = self.clearance(points)
        ray = self.camera.centre - points
        cosine = np.einsum("ni,ni->n", ray, normals) / np.maximum(np.linalg.norm(ray, axis=1), 1e-12)
        visible = (cosine > min_cosine) & (clear > -tolerance / np.maximum(cosine, min_cosine)) & np.isfinite(clear)
        return uv, np.where(visible, cosine, 0.0)

    def clearance(self, points):
        """Pixels (n,2), and by how far (n,) [m] each point lies before the surface: +inf where the picture shows none,
        -inf outside the picture."""
        uv, z = self.camera.project(points)
        column, row = (np.floor(uv[:, i]).astype(np.int64) for i in (0, 1))
        inside = (z > 0) & (column >= 0) & (row >= 0) & (column < self.camera.width) & (row < self.camera.height)
        at = np.full(len(points), -np.inf)
        at[inside] = self.depth[row[inside], column[inside]]
        return uv, at - z


def occlusion_border(depth, step, width):
    """Pixels (H,W) within `width` pixels of a depth step or of the silhouette: their colours may mix two surfaces."""
    import cv2

    finite = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
    box = np.ones((3, 3), np.uint8)
    border = (cv2.dilate(finite, box) - cv2.erode(finite, box)) > step
    return cv2.dilate(border.astype(np.uint8), np.ones((2 * width - 1,) * 2, np.uint8)) > 0 if width > 0 else border


def read(image, uv):
    """Bilinear values (n, C) of an image (H,W,C) at pixels (n,2); pixel (0,0) has its centre at (0.5, 0.5)."""
    h, w = image.shape[:2]
    x = np.clip(uv[:, 0] - 0.5, 0, w - 1.001)
    y = np.clip(uv[:, 1] - 0.5, 0, h - 1.001)
    j, i = x.astype(np.int64), y.astype(np.int64)
    a, b = (y - i)[:, None].astype(np.float32), (x - j)[:, None].astype(np.float32)
    flat = image.reshape(h * w, -1)
    k = i * w + j
    return (1 - a) * ((1 - b) * flat[k] + b * flat[k + 1]) + a * ((1 - b) * flat[k + w] + b * flat[k + w + 1])
