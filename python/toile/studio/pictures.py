"""Pictures, masks and true labels by the own rasteriser: two samples a pixel each way, a few lights, a noisy sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import kernels
from .paint import LABELS
from .surface import barycentric, vertex_normals

SAMPLES = 2  # per pixel and direction
LIGHTS = (((0.4, -0.8, 0.6), 0.60), ((-0.8, -0.2, 0.5), 0.40), ((0.3, 0.9, 0.4), 0.45))  # direction, strength
AMBIENT = 0.40
BACKGROUND = np.array([0.30, 0.32, 0.34])
SENSOR_NOISE = 2.0 / 255
TRACED_NOISE = 1.0 / 255  # beside the path tracer's own


@dataclass(frozen=True)
class OuterSurface:
    """The outer surface of one frame: body, then garments, in one list of triangles."""

    body: np.ndarray  # (n,3)
    body_faces: np.ndarray
    garment: np.ndarray | None  # (g,3) all garments, one after the other
    garment_faces: np.ndarray | None
    rest: np.ndarray | None = None  # (n+g,3) where the vertices are on the dressed body at rest

    @property
    def vertices(self):
        return self.body if self.garment is None else np.concatenate([self.body, self.garment])

    @property
    def faces(self):
        if self.garment is None:
            return self.body_faces
        return np.concatenate([self.body_faces, self.garment_faces + len(self.body)])

    @property
    def normals(self):
        N = vertex_normals(self.body, self.body_faces)
        return N if self.garment is None else np.concatenate([N, vertex_normals(self.garment, self.garment_faces)])


@dataclass(frozen=True)
class SyntheticView:
    """What one camera sees. `points` (p,3) lie under the centres of the pixels (rows, cols) of the mask."""

    image: np.ndarray  # (H,W,3) uint8
    mask: np.ndarray  # (H,W) bool
    labels: np.ndarray  # (H,W) uint8, true
    depth: np.ndarray  # (H,W) [m], the nearest sample's, inf on background
    points: np.ndarray  # (p,3) world points of mask pixels in row order
    rest_points: np.ndarray | None = None  # (p,3) the same points on the dressed body at rest


@dataclass(frozen=True)
class Sensor:
    """Per-camera gain (3,) and offset."""

    gain: np.ndarray
    bias: float


def make_sensors(count, rng):
    return [Sensor(1 + rng.normal(0, 0.04, 3), float(rng.normal(0, 0.01))) for _ in range(count)]


def take_picture(outer, camera, look, sensor, rng, traced=None):
    """One picture of `outer` by `camera`; `traced` (H,W,3) is what a path tracer saw, sRGB values before the sensor."""
    V, F, N = outer.vertices, outer.faces, outer.normals
    size = (camera.height * SAMPLES, camera.width * SAMPLES)
    K = np.diag([SAMPLES, SAMPLES, 1.0]) @ camera.K
    P = distorted(camera, V)
    hit = kernels.raster(P, F, K, size)
    row, col = np.nonzero(hit.face >= 0)
    face, depth = hit.face[row, col], hit.depth[row, col]
    ray = np.stack([(col + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1], np.ones(len(row))], 1)
    bary = barycentric(ray * depth[:, None], P[F[face]])
    at = lambda values: np.einsum("pc,pc...->p...", bary, values[F[face]])
    points, normals = at(V), at(N)
    label, colour = surface_look(outer, look, face, bary, F, paint=traced is None)
    if traced is None:
        full = np.broadcast_to(BACKGROUND, (*size, 3)).copy()
        full[row, col] = colour * shading(points, normals, camera)[:, None]
        image = full.reshape(camera.height, SAMPLES, camera.width, SAMPLES, 3).mean((1, 3))
        image = image * sensor.gain + sensor.bias + rng.normal(0, SENSOR_NOISE, image.shape)
    else:
        image = traced * sensor.gain + sensor.bias + rng.normal(0, TRACED_NOISE, traced.shape)
    votes = np.zeros((camera.height, camera.width, 1 + max(LABELS.values())), np.uint8)
    np.add.at(votes, (row // SAMPLES, col // SAMPLES, label), 1)
    mask = votes.sum(-1) * 2 >= SAMPLES**2
    labels = np.where(mask, votes.argmax(-1), 0).astype(np.uint8)
    near = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(near, (row // SAMPLES, col // SAMPLES), depth)
    place = np.zeros((2, camera.height, camera.width, 3))
    place[0, row // SAMPLES, col // SAMPLES] = points
    if outer.rest is not None:
        place[1, row // SAMPLES, col // SAMPLES] = at(outer.rest)
    return SyntheticView((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8), mask, labels, near, *place[:, mask])


def nearest(outer, camera):
    """(H,W) depths under the pixels' centres [m], inf on background."""
    return kernels.raster(distorted(camera, outer.vertices), outer.faces, camera.K, (camera.height, camera.width)).depth


def distorted(camera, V):
    """Camera-space vertices whose pinhole picture is the distorted one; edges stay straight, wrong by under 1e-3 px."""
    P = camera.to_camera(V)
    xy = camera.distort(P[:, :2] / P[:, 2:])
    return np.concatenate([xy * P[:, 2:], P[:, 2:]], 1)


def surface_look(outer, look, face, bary, F, paint=True):
    """True label ids (p,) and, with `paint`, colours (p,3) of hit points."""
    label, colour = np.zeros(len(face), np.int64), np.zeros((len(face), 3))
    on_body = face < len(outer.body_faces)
    f, b = F[face[on_body]], bary[on_body]
    at = lambda values: np.einsum("pc,pc...->p...", b, values[f])
    neutral = at(look.neutral)
    label[on_body] = look.body_labels(neutral, at(look.arm), at(look.head))
    label[~on_body] = look.cloth_labels(F[face[~on_body], 0] - len(outer.body))
    if not paint:
        return label, None
    colour[on_body] = look.body_colours(neutral, label[on_body], look.skin_vertex[f[:, 0]])
    colour[~on_body] = look.cloth_colours(F[face[~on_body]] - len(outer.body), bary[~on_body])
    return label, colour


def shading(points, normals, camera):
    """Diffuse light plus a weak gloss towards the camera; both sides of the cloth are lit."""
    view = camera.centre - points
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    n = n * np.where((n * view).sum(1) < 0, -1, 1)[:, None]
    light = np.full(len(n), AMBIENT)
    for direction, strength in LIGHTS:
        d = np.array(direction) / np.linalg.norm(direction)
        light += strength * np.maximum(n @ d, 0)
        half = view + d
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        light += 0.08 * strength * np.maximum((n * half).sum(1), 0) ** 30
    return light
