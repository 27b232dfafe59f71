"""Pictures unwrapped onto the layers' UVs, each from one view: what of a texel this camera saw."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from .. import kernels
from ..kernels import bilinear
from .visibility import occlusion_border

BORDER = (0.03, 2)  # depth step [m] about which colours mix two surfaces, and how far [px], see occlusion_border
SEAM = 0.012  # a pixel this near to another layer may show it instead: registered borders err by as much [m]
LABEL = 3  # a pixel this near to a label that speaks against the layer may show that instead [px]
DOUBT = 0.05  # so near to another layer labels are asked; farther inside, registration errs less than they do [m]
TOLERANCE = 0.006  # of the depth test [m]
MIN_COSINE = 0.2  # views more grazing than this give no texel
EMPTY = 255  # no layer
CONFIDENCE = np.array([0.0, 0.5, 1.0])  # weight of a vertex that was hidden, interpolated, observed


@dataclass(frozen=True)
class UndistortedCrop:
    """One pinhole picture: undistorted, scaled, cut to a crop. Masks are 0 outside the captured picture."""

    camera: object  # scene.Camera without distortion
    image: np.ndarray  # (H,W,3) uint8
    mask: np.ndarray  # (H,W) bool
    labels: np.ndarray | None  # (H,W) uint8


def pinhole(camera, scale=1.0, crop=None):
    """The camera without distortion, `scale` of its pixels along one of the picture's; `crop` (row, column, height,
    width) of that picture."""
    whole = tuple(max(round(side / scale), 1) for side in camera.size)
    K = np.array(camera.K, dtype=np.float64)
    K[0] *= whole[1] / camera.width
    K[1] *= whole[0] / camera.height
    row, column, height, width = crop or (0, 0, *whole)
    K[:2, 2] -= [column, row]
    return replace(camera, K=K, width=width, height=height, distortion=np.zeros(5))


def undistorted(camera, picture, nearest=False):
    """A picture (H,W[,3]) as the pinhole camera of the same K sees it; zero where it shows nothing."""
    if not np.any(camera.distortion):
        return picture
    K = np.array(camera.K, dtype=np.float64)
    K[:2, 2] -= 0.5  # OpenCV's pixel (0,0) has its centre at (0, 0)
    maps = cv2.initUndistortRectifyMap(K, camera.distortion, None, K, (camera.width, camera.height), cv2.CV_32FC1)
    x, y = ((np.arange(n) - K[i, 2]) / K[i, i] for i, n in enumerate((camera.width, camera.height)))
    maps[0][np.hypot(x, y[:, None]) * camera.lens_limit > 1] = -2  # outside: OpenCV folds these in
    return cv2.remap(picture, *maps, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)


def undistorted_crop(camera, image, mask, labels, scale, crop):
    """The UndistortedCrop of a captured image (h,w,3), its mask (h,w) bool and labels (h,w) or None."""
    flat = pinhole(camera, scale)

    def cut(array, nearest):
        array = undistorted(camera, array, nearest)
        if scale != 1:
            how = cv2.INTER_NEAREST_EXACT if nearest else cv2.INTER_AREA if scale > 1 else cv2.INTER_LINEAR
            array = cv2.resize(array, (flat.width, flat.height), interpolation=how)
        return cropped(array, crop)

    mask = cut(255 * mask.astype(np.uint8), False) > 127
    labels = None if labels is None else cut(labels, True)
    return UndistortedCrop(pinhole(camera, scale, crop), cut(image, False), mask, labels)


def cropped(array, crop):
    """Rows and columns of a crop, zero beyond the picture."""
    row, column, height, width = crop
    out = np.zeros((height, width, *array.shape[2:]), array.dtype)
    r0, c0, r1, c1 = max(row, 0), max(column, 0), min(row + height, len(array)), min(column + width, array.shape[1])
    if r1 > r0 and c1 > c0:
        out[r0 - row : r1 - row, c0 - column : c1 - column] = array[r0:r1, c0:c1]
    return out


def crop_about(camera, points, size, scale):
    """The crop (row, column, height, width) of the scaled picture centred on what of `points` (n,3) it shows, moved to
    stay inside the picture where it fits."""
    flat = pinhole(camera, scale)
    uv, depth = flat.project(points)
    uv = (
        np.clip(uv[depth > 0], 0, [flat.width, flat.height])
        if (depth > 0).any()
        else np.array([[flat.width, flat.height]]) / 2
    )
    centre = 0.5 * (uv.min(0) + uv.max(0))
    start = []
    for middle, side, whole in ((centre[1], size[0], flat.height), (centre[0], size[1], flat.width)):
        low = round(middle - 0.5 * side)
        start.append(int(np.clip(low, 0, whole - side)) if side <= whole else (whole - side) // 2)
    return (*start, *size)


@dataclass(frozen=True)
class Unwrapped:
    """The texels of one layer's T x T map that were seen."""

    texels: np.ndarray  # (q,) flat indices, rising
    colours: np.ndarray  # (q,3) uint8
    weights: np.ndarray  # (q,) > 0

    @staticmethod
    def nothing():
        return Unwrapped(np.zeros(0, np.int64), np.zeros((0, 3), np.uint8), np.zeros(0))

    def maps(self, size):
        """(T,T,3) uint8 colours and (T,T) weights, zero where unseen."""
        colours, weights = np.zeros((size * size, 3), np.uint8), np.zeros(size * size)
        colours[self.texels], weights[self.texels] = self.colours, self.weights
        return colours.reshape(size, size, 3), weights.reshape(size, size)


class Unwrapper:
    """Unwraps pictures of a frame onto all its layers; `maps` are their UvMaps, inner to outer."""

    def __init__(self, maps, garment_labels):
        self.maps, self.garment_labels = maps, list(garment_labels)
        self.texel = [np.flatnonzero(m.valid) for m in maps]
        self.face = [m.face.ravel()[t] for m, t in zip(maps, self.texel)]
        self.bary = [m.bary.reshape(-1, 3)[t] for m, t in zip(maps, self.texel)]
        self.counts = np.cumsum([0, *(len(m.layer.rest) for m in maps)])
        self.F = np.concatenate([m.layer.faces + s for m, s in zip(maps, self.counts)]).astype(np.int32)
        self.starts = np.cumsum([0, *(len(m.layer.faces) for m in maps)])  # faces of each layer
        self.layer_of = np.repeat(np.arange(len(maps)), np.diff(self.starts)).astype(np.uint8)

    def frame(self, vertices, confidence, covered=()):
        """Sets the frame: per layer vertices (n,3) and confidence (n,) uint8. Faces `covered` of the first layer are not drawn."""
        self.drawn = np.delete(np.arange(len(self.F)), covered)
        self.V = np.concatenate(vertices)
        self.normals = np.concatenate([kernels.vertex_normals(V, m.layer.faces) for V, m in zip(vertices, self.maps)])
        self.confidence = np.concatenate([CONFIDENCE[confidence_ids(c)] for c in confidence])

    def view(self, camera, image, mask, labels):
        """An Unwrapped a layer from one undistorted picture and its pinhole camera.

        A texel's weight is the cosine to the view times its confidence where the layers' depth buffer shows it, away from
        occlusion borders and from other layers, on pixels of the person whose labels do not speak against the layer."""
        drawn = kernels.raster(camera.to_camera(self.V), self.F[self.drawn], camera.K, camera.size)
        hit = drawn.face >= 0
        face = self.drawn[drawn.face]  # where hit
        clear = hit & mask & ~occlusion_border(drawn.depth, *BORDER)
        if not hit.any():
            return [Unwrapped.nothing() for _ in self.maps]
        layer = np.where(hit, self.layer_of[face], EMPTY)
        pixels = camera.K[0, 0] / np.median(drawn.depth[hit])  # a metre at the person
        clear &= ~seams(layer, SEAM * pixels)
        doubt = seams(layer, DOUBT * pixels)
        allowed = [self._allowed(m.layer.label, labels, doubt) for m in self.maps]
        return [self._layer(i, camera, image, face, drawn.depth, clear & a) for i, a in enumerate(allowed)]

    def _layer(self, i, camera, image, face, depth, clear):
        layer = self.maps[i].layer
        if not len(self.texel[i]):
            return Unwrapped.nothing()
        pick = np.flatnonzero(self._near(i, face[clear])[self.face[i]])
        corners, bary = layer.faces[self.face[i][pick]] + self.counts[i], self.bary[i][pick]
        points, normals = (np.einsum("tk,tkx->tx", bary, values[corners]) for values in (self.V, self.normals))
        confidence = np.einsum("tk,tk->t", bary, self.confidence[corners])
        uv, z = camera.project(points)
        column, row = (
            np.floor(uv[:, k]).clip(0, side - 1).astype(np.int64) for k, side in ((0, camera.width), (1, camera.height))
        )
        inside = (z > 0) & (uv >= 0).all(1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
        ray = camera.centre - points
        cosine = np.einsum("ni,ni->n", ray, normals) / np.linalg.norm(ray, axis=1)
        slack = TOLERANCE / np.maximum(cosine, MIN_COSINE)
        seen = inside & clear[row, column] & (cosine > MIN_COSINE) & (z < depth[row, column] + slack) & (confidence > 0)
        colours = bilinear(_blurred(image, clear, seen.sum()), uv[seen])
        return Unwrapped(
            self.texel[i][pick[seen]], np.rint(colours).clip(0, 255).astype(np.uint8), (cosine * confidence)[seen]
        )

    def _allowed(self, label, labels, doubt):
        """Pixels (H,W) whose labels, and those about them, do not speak against a layer of that label; all outside `doubt`."""
        if labels is None:
            return True
        against = (labels != label) if label >= 0 else np.isin(labels, self.garment_labels)
        return ~doubt | (cv2.dilate(against.astype(np.uint8), _disc(LABEL)) == 0)

    def _near(self, i, faces):
        """bool per face of layer i: within two rings of those that the picture shows."""
        F = self.maps[i].layer.faces
        mine = faces[(faces >= self.starts[i]) & (faces < self.starts[i + 1])] - self.starts[i]
        near = np.zeros(len(F), bool)
        near[mine] = True
        for _ in range(2):
            vertices = np.zeros(len(self.maps[i].layer.rest), bool)
            vertices[F[near]] = True
            near = vertices[F].any(1)
        return near


def _disc(width):
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * width + 1,) * 2)


def _blurred(image, clear, texels):
    """The picture as texels see it: one that spans several pixels takes the mean of the clear ones, so that fine prints do
    not alias and nothing bleeds in."""
    image, pixels = image.astype(np.float32), np.sqrt(clear.sum() / max(texels, 1))  # pixels along a texel's side
    if pixels <= 1.5:
        return image
    weight = clear[..., None].astype(np.float32)
    total, weight = (cv2.GaussianBlur(x, (0, 0), 0.4 * pixels) for x in (image * weight, weight))
    return total / np.maximum(weight, 1e-6)[..., None]


def seams(layer, width):
    """Pixels (H,W) of a layer within `width` pixels, at least one, of one that shows another; EMPTY is none."""
    disc = _disc(max(round(width), 1))
    near = np.zeros(layer.shape, bool)
    for k in np.unique(layer[layer != EMPTY]):
        near |= (layer != k) & (cv2.dilate((layer == k).astype(np.uint8), disc) > 0)
    return near


def confidence_ids(confidence):
    """uint8 of a store, or float there, as indices."""
    return np.nan_to_num(confidence).astype(np.int64).clip(0, len(CONFIDENCE) - 1)


def mean_texture(views, size):
    """The Unwrapped of one layer's views together: weighted mean colours, summed weights."""
    total, weight = np.zeros((size * size, 3)), np.zeros(size * size)
    for view in views:
        total[view.texels] += view.weights[:, None] * view.colours
        weight[view.texels] += view.weights
    seen = np.flatnonzero(weight)
    return Unwrapped(seen, np.rint(total[seen] / weight[seen, None]).astype(np.uint8), weight[seen])


def filled(texture, seen):
    """A texture (T,T,C) whose unseen texels take the nearest seen one's colour; grey where nothing was seen."""
    from scipy.ndimage import distance_transform_edt

    if not seen.any():
        return np.full_like(texture, 0.5)
    row, column = distance_transform_edt(~seen, return_distances=False, return_indices=True)
    return texture[row, column]
