"""What each camera sees of a surface: depth buffers, visibility of points, values read from pictures."""

import numpy as np

from .. import kernels


class DepthView:
    """One camera with the depth buffer of a surface. `depth` (H,W) [m], +inf where empty; `face` (H,W), -1 there."""

    def __init__(self, camera, V, F):
        self.camera = camera
        moved = kernels.undistorted_view(V, camera.K, camera.distortion, camera.T_camera_world)
        result = kernels.raster(moved, F, camera.K, camera.size)
        self.depth, self.face = result.depth, result.face

    def visibility(self, points, normals, tolerance, min_cosine):
        """Pixels (n,2) of points (n,3), weights (n,): the cosine to the view where visible, else 0, and by how far (n,) [m]
        each point lies before the surface: +inf where the picture shows none, -inf outside the picture."""
        c = self.camera
        return kernels.visibility(
            points, normals, c.K, c.distortion, c.T_camera_world, self.depth, tolerance, min_cosine
        )

    def with_picture(self, crop):
        """The kernels' View of the camera with its depths and a Crop of its picture."""
        c = self.camera
        return kernels.View(c.K, c.distortion, c.T_camera_world, self.depth, crop.values, crop.corner)

    def crop(self, about, more):
        """Slices (rows, columns) of the pixels within `about` [m] and `more` pixels of the surface's outline; at least two
        by two."""
        covered, size = self.face >= 0, self.face.shape
        nearest = self.depth.min(initial=np.inf)
        margin = more + (
            int(np.ceil(about * np.abs(self.camera.K[:2, :2]).max() / nearest)) if np.isfinite(nearest) else 0
        )
        spans = []
        for axis in (0, 1):
            at = np.flatnonzero(covered.any(1 - axis))
            first, last = (at[0] - margin, at[-1] + margin + 1) if len(at) else (0, 2)
            first = int(np.clip(first, 0, size[axis] - 2))
            spans.append(slice(first, int(np.clip(last, first + 2, size[axis]))))
        return tuple(spans)


def occlusion_border(depth, step, width):
    """Pixels (H,W) within `width` pixels of a depth step or of the silhouette: their colours may mix two surfaces."""
    import cv2

    finite = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
    box = np.ones((3, 3), np.uint8)
    border = (cv2.dilate(finite, box) - cv2.erode(finite, box)) > step
    return cv2.dilate(border.astype(np.uint8), np.ones((2 * width - 1,) * 2, np.uint8)) > 0 if width > 0 else border
