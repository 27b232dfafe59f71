"""Points seen by several cameras as rays: where they meet, and how far each camera's own detections lie from where the others
say (leave one out)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...kernels.arrays import Anything, Floats
from ...scene import Camera

SURE = 0.3  # confidence from which a detection counts
ROUNDS = 3  # of reweighting
PARALLEL = 2.5e-4  # determinant of the rays' system of unit trace; two rays of 5 degrees have this


@dataclass(frozen=True)
class Sighting:
    """Detections of a sequence: `uv` (C,T,K,2) [px], `weight` (C,T,K) 0 where unseen, of `cameras` in consecutive frames."""

    cameras: tuple[Camera, ...]
    names: tuple[str, ...]
    uv: Floats
    weight: Floats

    @property
    def seeing(self) -> list[int]:
        """Of the cameras those that see anything."""
        return np.flatnonzero((self.weight > SURE).any((1, 2))).tolist()

    def only(self, keep: Sequence[int]) -> Sighting:
        """Of some cameras."""
        cameras, keep = tuple(self.cameras[i] for i in keep), np.array(keep, dtype=int)
        return replace(self, cameras=cameras, uv=self.uv[keep], weight=self.weight[keep])

    def thinned(self, most: int) -> Sighting:
        """With fewer of its points, evenly picked, so that there are about `most` detections."""
        count = max(1, min(len(self.names), most // max(1, self.weight.shape[0] * self.weight.shape[1])))
        pick = np.unique(np.linspace(0, len(self.names) - 1, count).astype(int))
        names = tuple(self.names[k] for k in pick)
        return replace(self, names=names, uv=self.uv[:, :, pick], weight=self.weight[:, :, pick])

    def shifted(self, camera: int, frames: int) -> Sighting:
        """With one camera's frame t + `frames` in the place of t."""
        uv, weight = self.uv.copy(), np.zeros_like(self.weight)
        weight[:] = self.weight
        uv[camera], weight[camera] = _moved(self.uv[camera], frames, 0.0), _moved(self.weight[camera], frames, 0.0)
        return replace(self, uv=uv, weight=weight)


def _moved(values: Floats, frames: int, fill: float) -> Floats:
    out = np.full_like(values, fill)
    T = len(values)
    a, b = max(0, frames), min(T, T + frames)
    if b > a:
        out[a - frames : b - frames] = values[a:b]
    return out


def directions(camera: Camera, uv: Anything) -> Floats:
    """Unit rays (..., 3) in the world of pixels (..., 2)."""
    import cv2

    flat = np.ascontiguousarray(np.asarray(uv, float).reshape(-1, 1, 2))
    criteria = (cv2.TERM_CRITERIA_COUNT, 20, 1e-9)
    xy = cv2.undistortPoints(flat, camera.K, camera.distortion, None, None, None, criteria).reshape(-1, 2)
    rays = np.c_[xy, np.ones(len(xy))] @ camera.T_camera_world[:3, :3]
    return (rays / np.linalg.norm(rays, axis=1, keepdims=True)).reshape(*np.shape(uv)[:-1], 3)


@dataclass(frozen=True)
class Meeting:
    """`points` (T,K,3) by all cameras; `residual` (C,T,K,2) [px], detections minus where the others say; NaN where unknown."""

    points: Floats
    residual: Floats

    @property
    def error(self) -> Floats:
        """(C,T,K) [px]"""
        return np.linalg.norm(self.residual, axis=-1)

    def typical(self, camera: int | None = None) -> float:
        """Median error [px] of a camera's detections, or of all; infinite where there are none."""
        error = self.error if camera is None else self.error[camera]
        known = error[~np.isnan(error)]
        return float(np.median(known)) if len(known) else float("inf")


def meet(sighting: Sighting) -> Meeting:
    """Least-squares meeting of the rays, reweighted by the leave-one-out errors (Cauchy); of two cameras, where one ray would be left,
    by the errors of both. A point behind a camera that sees it has an infinite error."""
    centres = np.array([camera.centre for camera in sighting.cameras])
    D = np.stack([directions(camera, uv) for camera, uv in zip(sighting.cameras, sighting.uv)])
    seen = sighting.weight > SURE
    weight = seen.astype(float)
    own = 1 if len(centres) > 2 else 0  # whether a camera's own rays are left out
    for _ in range(ROUNDS):
        A = weight[..., None, None] * (np.eye(3) - D[..., :, None] * D[..., None, :])
        b = np.einsum("ctkij,cj->ctki", A, centres)
        whole, right, views = A.sum(0), b.sum(0), seen.sum(0)
        residual = np.full(sighting.uv.shape, np.nan)
        for i, camera in enumerate(sighting.cameras):
            X = _solved(whole - own * A[i], right - own * b[i], views - own * seen[i])
            uv, depth = camera.project(np.nan_to_num(X))
            off = np.where((depth > 0)[..., None], sighting.uv[i] - uv, np.inf)
            known = seen[i] & np.isfinite(X).all(-1)
            residual[i][known] = off[known]
        error = np.linalg.norm(residual, axis=-1)
        finite = error[np.isfinite(error)]
        scale = 1.5 * np.median(finite) + 1e-9 if len(finite) else 1.0
        weight = np.where(seen, 1 / (1 + (np.nan_to_num(error, nan=0.0, posinf=1e6) / scale) ** 2), 0.0)
    return Meeting(_solved(whole, right, views), residual)


def _solved(A: Floats, b: Floats, views: Anything) -> Floats:
    """(T,K,3), NaN where fewer than two rays or nearly parallel ones meet."""
    scale = np.maximum(np.trace(A, axis1=-2, axis2=-1), 1e-12)[..., None, None]
    good = (views >= 2) & (np.linalg.det(A / scale) > PARALLEL)
    safe = np.where(good[..., None, None], A, np.eye(3))
    return np.where(good[..., None], np.linalg.solve(safe, b[..., None])[..., 0], np.nan)


def epipolar(sighting: Sighting) -> Floats:
    """(C,C) [px]: median distance of a camera's (row's) detections from the epipolar lines of another's (column's)."""
    C = len(sighting.cameras)
    table = np.full((C, C), np.nan)
    D = [directions(camera, uv) for camera, uv in zip(sighting.cameras, sighting.uv)]
    for i, one in enumerate(sighting.cameras):
        for j, other in enumerate(sighting.cameras):
            both = (sighting.weight[i] > SURE) & (sighting.weight[j] > SURE)
            if i == j or not both.any():
                continue
            # the plane through both centres and the other's ray; its normal against this ray, in this camera's pixels
            normal = np.cross(other.centre - one.centre, D[j][both])
            ray = D[i][both]
            length = np.linalg.norm(normal, axis=1)
            sine = np.abs(np.einsum("ni,ni->n", normal, ray)) / np.maximum(length, 1e-12)
            table[i, j] = float(np.median(sine)) * float(np.sqrt(one.K[0, 0] * one.K[1, 1]))
    return table
