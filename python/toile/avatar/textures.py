"""Pictures unwrapped onto the layers' UVs, each from one view: what of a texel this camera saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from .. import kernels
from ..views import occlusion_border, read

BORDER = (0.03, 2)  # colours within so many pixels of a depth step of so many metres mix two surfaces, see occlusion_border
SEAM = 2  # pixels within so many of another layer may show it instead: the registered border errs by as much
TOLERANCE = 0.006  # of the depth test [m]
MIN_COSINE = 0.2  # views more grazing than this give no texel
CONFIDENCE = np.array([0.0, 0.5, 1.0])  # weight of a vertex that was hidden, interpolated, observed


@dataclass(frozen=True)
class Picture:
    """One pinhole picture: undistorted, scaled, cut to a window. Masks are 0 outside the captured picture."""

    camera: object  # scene.Camera without distortion
    image: np.ndarray  # (H,W,3) uint8
    mask: np.ndarray  # (H,W) bool
    labels: np.ndarray | None  # (H,W) uint8


def pinhole(camera, scale=1.0, window=None):
    """The camera without distortion, `scale` of its pixels along one of the picture's; `window` (row, column, height,
    width) of that picture."""
    whole = round(camera.height / scale), round(camera.width / scale)
    K = np.array(camera.K, dtype=np.float64)
    K[0] *= whole[1] / camera.width
    K[1] *= whole[0] / camera.height
    row, column, height, width = window or (0, 0, *whole)
    K[:2, 2] -= [column, row]
    return replace(camera, K=K, width=width, height=height, distortion=np.zeros(5))


def undistorted(camera, picture, nearest=False):
    """A picture (H,W[,3]) as the pinhole camera of the same K sees it; zero where it shows nothing."""
    if not np.any(camera.distortion):
        return picture
    K = np.array(camera.K, dtype=np.float64)
    K[:2, 2] -= 0.5  # OpenCV's pixel (0,0) has its centre at (0, 0)
    maps = cv2.initUndistortRectifyMap(K, camera.distortion, None, K, (camera.width, camera.height), cv2.CV_32FC1)
    return cv2.remap(picture, *maps, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)


def take(camera, image, mask, labels, scale, window):
    """The Picture of a captured image (h,w,3), its mask (h,w) bool and labels (h,w) or None."""
    flat = pinhole(camera, scale)

    def cut(array, nearest):
        array = undistorted(camera, array, nearest)
        if scale != 1:
            how = cv2.INTER_NEAREST_EXACT if nearest else cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
            array = cv2.resize(array, (flat.width, flat.height), interpolation=how)
        return cropped(array, window)

    mask = cut(255 * mask.astype(np.uint8), False) > 127
    labels = None if labels is None else cut(labels, True)
    return Picture(pinhole(camera, scale, window), cut(image, False), mask, labels)


def cropped(array, window):
    """Rows and columns of a window, zero beyond the picture."""
    row, column, height, width = window
    out = np.zeros((height, width, *array.shape[2:]), array.dtype)
    r0, c0, r1, c1 = max(row, 0), max(column, 0), min(row + height, len(array)), min(column + width, array.shape[1])
    if r1 > r0 and c1 > c0:
        out[r0 - row : r1 - row, c0 - column : c1 - column] = array[r0:r1, c0:c1]
    return out


def window_about(camera, points, size, scale):
    """The window (row, column, height, width) of the scaled picture centred on what of `points` (n,3) it shows, moved to
    stay inside the picture where it fits."""
    flat = pinhole(camera, scale)
    uv, depth = flat.project(points)
    uv = np.clip(uv[depth > 0], 0, [flat.width, flat.height]) if (depth > 0).any() else np.array([[flat.width, flat.height]]) / 2
    centre = 0.5 * (uv.min(0) + uv.max(0))
    start = []
    for middle, side, whole in ((centre[1], size[0], flat.height), (centre[0], size[1], flat.width)):
        low = round(middle - 0.5 * side)
        start.append(int(np.clip(low, 0, whole - side)) if side <= whole else (whole - side) // 2)
    return (*start, *size)


class Unwrapper:
    """Unwraps pictures of a frame onto all its layers; `maps` are their UvMaps, inner to outer."""

    def __init__(self, maps, garment_labels):
        self.maps, self.garment_labels = maps, garment_labels
        self.texel = [np.flatnonzero(m.valid) for m in maps]
        self.corners = [m.corners.reshape(-1, 3)[t] for m, t in zip(maps, self.texel)]
        self.bary = [m.bary.reshape(-1, 3)[t] for m, t in zip(maps, self.texel)]

    def frame(self, vertices, confidence):
        """Sets the frame: per layer vertices (n,3) and confidence (n,) uint8."""
        counts = np.cumsum([0, *(len(v) for v in vertices)])
        self.V = np.concatenate(vertices)
        self.F = np.concatenate([m.layer.faces + s for m, s in zip(self.maps, counts)]).astype(np.int32)
        self.layer_of = np.repeat(np.arange(len(self.maps)), [len(m.layer.faces) for m in self.maps]).astype(np.uint8)
        self.points, self.normals, self.sure = [], [], []
        for m, V, sure, corners, bary in zip(self.maps, vertices, confidence, self.corners, self.bary):
            at = lambda values: np.einsum("tk,tk...->t...", bary, values[corners])  # noqa: B023, E731
            self.points.append(at(V))
            self.normals.append(at(kernels.vertex_normals(V, m.layer.faces)))
            self.sure.append(at(CONFIDENCE[confidence_ids(sure)]))

    def view(self, camera, image, mask, labels):
        """Per layer ((T,T,3) uint8 texture, (T,T) weight in 0..1) from one undistorted picture and its pinhole camera.

        A texel's weight is the cosine to the view times its confidence where the layers' depth buffer shows it, away from
        occlusion borders, on a pixel of the person whose label does not speak against the layer; else 0."""
        drawn = kernels.raster(camera.to_camera(self.V), self.F, camera.K, camera.size)
        depth = drawn.depth
        clear = (drawn.face >= 0) & mask & ~occlusion_border(depth, *BORDER) & ~seams(self.layer_of[drawn.face], SEAM)
        return [self._layer(i, camera, image, labels, depth, clear) for i in range(len(self.maps))]

    def _layer(self, i, camera, image, labels, depth, clear):
        size = self.maps[i].size
        texture, weight = np.zeros((size * size, 3), np.uint8), np.zeros(size * size)
        uv, z = camera.project(self.points[i])
        column, row = np.floor(uv).astype(np.int64).T
        inside = (z > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
        at = np.flatnonzero(inside)
        row, column = row[at], column[at]
        ray = camera.centre - self.points[i][at]
        cosine = np.einsum("ni,ni->n", ray, self.normals[i][at]) / np.linalg.norm(ray, axis=1)
        seen = clear[row, column] & (cosine > MIN_COSINE)
        seen &= z[at] < depth[row, column] + TOLERANCE / np.maximum(cosine, MIN_COSINE)
        if labels is not None:
            label = self.maps[i].layer.label
            said = labels[row, column]
            seen &= (said == label) if label >= 0 else ~np.isin(said, self.garment_labels)
        at, cosine = at[seen], cosine[seen]
        texture[self.texel[i][at]] = np.rint(read(image.astype(np.float32), uv[at])).clip(0, 255)
        weight[self.texel[i][at]] = cosine * self.sure[i][at]
        return texture.reshape(size, size, 3), weight.reshape(size, size)


def seams(layer, width):
    """Pixels (H,W) within `width` pixels of one that shows another layer."""
    box = np.ones((2 * width + 1,) * 2, np.uint8)
    return cv2.dilate(layer, box) != cv2.erode(layer, box)


def confidence_ids(confidence):
    """uint8 of a store, or float there, as indices."""
    return np.nan_to_num(confidence).astype(np.int64).clip(0, len(CONFIDENCE) - 1)


def mean_texture(views):
    """Mean (T,T,3) uint8 and summed weight (T,T) of one layer's [(texture, weight)] over views."""
    total = np.zeros(views[0][0].shape)
    weight = np.zeros(views[0][1].shape)
    for texture, w in views:
        total += w[..., None] * texture
        weight += w
    return np.rint(total / np.maximum(weight, 1e-9)[..., None]).astype(np.uint8), weight


def filled(texture, seen):
    """A texture (T,T,C) whose unseen texels take the nearest seen one's colour; grey where nothing was seen."""
    from scipy.ndimage import distance_transform_edt

    if not seen.any():
        return np.full_like(texture, 0.5)
    row, column = distance_transform_edt(~seen, return_distances=False, return_indices=True)
    return texture[row, column]
