"""From pixels to space: 2D keypoints of several views become 3D points with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from ..config import ReconstructSettings
from ..errors import UserError
from ..lens import distort, lens_limit
from ..scene import Camera, Frame, Keypoints, Points3D
from ..surface.keypoints import mirrored

_UNDISTORT_STEPS = 20
LONGEST = 3.0  # m: keypoints that span more are no person's in metres
FEW = 20  # detections whose median says nothing of a frame's noise
MANY = 4  # detections of a point, of which one inlier more than `min_views` is asked for
LIMBS = (  # whose sides a detector confuses together
    ("body.clavicle", "body.upperarm", "body.lowerarm", "body.wrist"),
    ("body.upperleg", "body.lowerleg", "body.foot", "body.toe", "body.big_toe", "body.small_toe", "body.heel"),
    ("hand_",),
    ("face.",),
)


def triangulate(keypoints: Keypoints, cameras: Mapping[str, Camera], settings: ReconstructSettings) -> Points3D:
    """Robust triangulation: RANSAC over view pairs, then least squares on the reprojection error of the inliers. What an
    inlier is follows the pictures' size, and then the noise of the frame's own residuals (`Points3D.gate` [px]). A view in
    which left and right of the body or of a limb are swapped against the others (seen from behind, for one) is turned back.

    A point is NaN (sigma infinite, views = inliers found) unless enough views agree on it. `sigma` is the square root
    of the trace of the covariance s^2 (J'WJ)^-1 [m], s [px] the larger of the stated and the observed noise.
    Raises UserError for a camera that the calibration lacks.
    """
    views = [name for name in keypoints.points if len(keypoints.points[name])]
    for name in views:
        if name not in cameras:
            raise UserError(f"keypoints.json: points.{name}: cameras.json has no camera of this name")
    k = len(keypoints.names)
    if k == 0 or len(views) < 2:
        return _nothing_seen(keypoints.names)
    rig = _Rig([cameras[name] for name in views])
    observed = np.stack([np.asarray(keypoints.points[name], dtype=np.float64) for name in views])  # (C,k,3)
    uv = observed[..., :2]
    seen = (observed[..., 2] >= settings.min_confidence) & np.isfinite(uv).all(-1)
    uv = np.where(seen[..., None], uv, 0.0)

    first = settings.inlier_share * max(max(cameras[name].size) for name in views)
    fit = _fit(rig, uv, seen, first, settings)
    gate = _observed_gate(fit[2], seen, first, settings)
    turned = _unswapped(keypoints.names, rig.project(fit[0]), uv, seen, gate)
    if turned is not None or gate != first:
        uv, seen = (uv, seen) if turned is None else turned
        fit = _fit(rig, uv, seen, gate, settings)
    return _points(keypoints.names, *fit, seen, gate, settings)


def check_with_scans(samples: Iterable[tuple[Frame, Points3D | None]], settings: ReconstructSettings) -> None:
    """UserError where in every sampled frame that has both the points lie beside the scan: half
    of them farther than `settings.apart`, though the scan is as long as they are, or they longer than anybody is."""
    found = {}
    for frame, points in samples:
        found_points = np.zeros((0, 3)) if points is None else points.points
        known = found_points[np.isfinite(found_points).all(1)]
        if len(known) and frame.scan is not None:
            whole = _length(frame.scan.vertices) >= settings.whole * _length(known)
            whole = whole or _length(np.percentile(known, (10, 90), axis=0)) > LONGEST
            found[frame.number] = np.median(frame.scan.index.closest(known)[3]) if whole else 0.0
    if found and min(found.values()) > settings.apart:
        number, off = min(found.items(), key=lambda item: item[1])
        raise UserError(
            f"frame {number}: half of the keypoints lie {off:.2g} m and more from the scan: are cameras and scans in the "
            "same units and axes, and of the same moment?"
        )


def _length(points):
    return np.ptp(points, axis=0).max()


def _fit(rig, uv, seen, gate, settings):
    """Points (k,3), their information, reprojection errors (C,k) [px] and inliers (C,k) at an inlier distance [px]."""
    X, inlier = _best_of_pairs(rig, uv, seen, gate, settings)
    for _ in range(settings.gauss_newton_steps):
        X, information, residual = _gauss_newton_step(rig, X, uv, inlier, gate)
        error = np.linalg.norm(residual, axis=-1)
        inlier = seen & (error < gate) & (rig.depth(X) > 0)
    return X, information, error, inlier


def _unswapped(names, at, uv, seen, gate):
    """Detections uv (C,k,2) and seen (C,k) with left and right of a pair of limbs exchanged in the views where most of its
    points then lie within the inlier distance of where the others see them, `at` (C,k,2), and do not as they are; None where
    there are none."""
    other = _other_side(names)
    near = np.where(seen, np.linalg.norm(uv - at, axis=-1), np.inf) < gate
    crossed = np.where(seen, np.linalg.norm(uv - at[:, other], axis=-1), np.inf) < gate
    order = np.tile(np.arange(len(names)), (len(uv), 1))
    for prefixes in LIMBS:
        limb = np.array([i for i, name in enumerate(names) if name.startswith(prefixes) and other[i] != i], dtype=int)
        told = seen[:, limb].sum(1)
        swapped = (2 * near[:, limb].sum(1) < told) & (2 * crossed[:, limb].sum(1) > told)
        order[np.ix_(swapped, limb)] = other[limb]
    if (order == np.arange(len(names))).all():
        return None
    return np.take_along_axis(uv, order[..., None], 1), np.take_along_axis(seen, order, 1)


def _other_side(names):
    """Row of the same point of the other side (k,), its own where there is none."""
    row = {name: i for i, name in enumerate(names)}
    return np.array([row.get(mirrored(name), i) for i, name in enumerate(names)], dtype=int)


def agreement(
    keypoints: Keypoints, points: Points3D, cameras: Mapping[str, Camera], settings: ReconstructSettings
) -> dict[str, float]:
    """{camera: share of its detections that lie within the inlier distance of `points`, either side of a pair}."""
    other, shares = _other_side(keypoints.names), {}
    for name, found in keypoints.points.items():
        seen = found[:, 2] >= settings.min_confidence
        if seen.any():
            at = cameras[name].project(points.points)[0]
            off = np.fmin(*(np.linalg.norm(found[:, :2] - where, axis=1) for where in (at, at[other])))
            shares[name] = float((off[seen] < points.gate).mean())
    return shares


def _observed_gate(error, seen, first, settings):
    """The inlier distance by the noise that a frame shows [px]: the median error of all detections, inliers or not, is
    sqrt(2 ln 2) sigma of two pixel coordinates, after 2 n of n views lost 3 degrees of freedom to the point. Within the
    range about the first one; that one where they are near each other."""
    views = seen.sum(0)
    known = seen & (views >= settings.min_views + 1) & np.isfinite(error)
    if known.sum() < FEW:
        return first
    freedom = np.sqrt(2 * views / np.maximum(2 * views - 3, 1))
    sigma = np.median((error * freedom)[known]) / np.sqrt(2 * np.log(2))
    gate = float(np.clip(settings.inlier_sigmas * sigma, *(first * np.array(settings.inlier_range))))
    return gate if abs(gate - first) > settings.inlier_near * first else first


class _Rig:
    """The cameras of one frame as stacked arrays (C, ...)."""

    def __init__(self, cameras):
        self.K = np.stack([c.K for c in cameras])
        self.R = np.stack([c.T_camera_world[:3, :3] for c in cameras])
        self.t = np.stack([c.T_camera_world[:3, 3] for c in cameras])
        self.distortion = np.stack([c.distortion for c in cameras])[:, None]  # (C,1,5)
        self.limit = lens_limit(self.distortion)
        self.centre = -np.einsum("cji,cj->ci", self.R, self.t)

    def distort(self, xy, derivative=False):
        return distort(xy, self.distortion, self.limit, derivative)

    def to_camera(self, X):
        """World points (..., k, 3) -> (..., C, k, 3)."""
        return np.einsum("cij,...kj->...cki", self.R, X) + self.t[:, None]

    def depth(self, X):
        return np.einsum("cj,...kj->...ck", self.R[:, 2], X) + self.t[:, 2, None]

    def project(self, X):
        """World points (..., k, 3) -> pixels (..., C, k, 2); points behind a camera come out infinitely far."""
        p = self.to_camera(X)
        z = p[..., 2:]
        xy = p[..., :2] / np.where(z > 1e-9, z, 1.0)
        uv = np.einsum("cij,...ckj->...cki", self.K[:, :2, :2], self.distort(xy)) + self.K[:, None, :2, 2]
        return np.where(z > 1e-9, uv, np.inf)

    def project_with_jacobian(self, X):
        """Pixels (C,k,2) and d pixels / d X (C,k,2,3)."""
        p = self.to_camera(X)
        z = np.where(np.abs(p[..., 2]) > 1e-9, p[..., 2], 1e-9)
        xy = p[..., :2] / z[..., None]
        distorted, D = self.distort(xy, derivative=True)
        uv = np.einsum("cij,ckj->cki", self.K[:, :2, :2], distorted) + self.K[:, None, :2, 2]
        P = (self.R[:, None, :2, :] - xy[..., None] * self.R[:, None, 2:, :]) / z[..., None, None]  # d xy / d X
        return uv, self.K[:, None, :2, :2] @ D @ P

    def rays(self, uv):
        """Unit world directions (C,k,3) through pixels (C,k,2): the distortion is inverted by fixed-point steps."""
        target = np.einsum("cij,ckj->cki", np.linalg.inv(self.K[:, :2, :2]), uv - self.K[:, None, :2, 2])
        xy = target.copy()
        if self.distortion.any():
            for _ in range(_UNDISTORT_STEPS):
                xy = xy + (target - self.distort(xy))
        d = np.concatenate([xy, np.ones(xy.shape[:-1] + (1,))], axis=-1)
        d = np.einsum("cji,ckj->cki", self.R, d)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)


def _view_pairs(count, settings):
    pairs = np.stack(np.triu_indices(count, 1), axis=1)
    if count <= settings.exhaustive_views:
        return pairs
    draw = np.random.default_rng(settings.seed).choice(len(pairs), min(settings.drawn_pairs, len(pairs)), replace=False)
    return pairs[np.sort(draw)]


def _best_of_pairs(rig, uv, seen, gate, settings):
    """Midpoints of all view pairs; per point the one of least truncated squared reprojection error."""
    a, b = _view_pairs(len(rig.K), settings).T
    d = rig.rays(uv)
    da, db = d[a], d[b]  # (P,k,3)
    w = (rig.centre[b] - rig.centre[a])[:, None]
    cosine = np.einsum("pki,pki->pk", da, db)
    sine2 = np.maximum(1 - cosine**2, 1e-12)
    wa, wb = np.einsum("pki,pki->pk", w + 0 * da, da), np.einsum("pki,pki->pk", w + 0 * db, db)
    s, t = (wa - cosine * wb) / sine2, (cosine * wa - wb) / sine2
    X = 0.5 * (rig.centre[a][:, None] + s[..., None] * da + rig.centre[b][:, None] + t[..., None] * db)
    usable = seen[a] & seen[b] & (s > 0) & (t > 0) & (sine2 > np.sin(settings.min_angle) ** 2)

    error2 = ((rig.project(X) - uv) ** 2).sum(-1)  # (P,C,k)
    limit = gate**2
    cost = np.where(seen, np.minimum(error2, limit), 0.0).sum(1)
    cost = np.where(usable, cost, np.inf)
    best = cost.argmin(0)
    point = np.arange(uv.shape[1])
    found = np.isfinite(cost[best, point])
    X = np.where(found[:, None], X[best, point], rig.centre.mean(0))
    return X, seen & found & (error2[best, :, point].T < limit)


def _gauss_newton_step(rig, X, uv, inlier, gate):
    """One step on sum_i w_i |project(X) - uv_i|^2, w Geman-McClure at the inlier distance; -> X, J'WJ, residuals."""
    at, J = rig.project_with_jacobian(X)
    r = np.where(inlier[..., None], at - uv, 0.0)
    w = np.where(inlier, (1 + (r**2).sum(-1) / gate**2) ** -2, 0.0)
    rows = np.moveaxis(J, 1, 0).reshape(len(X), -1, 3)  # (k,2C,3)
    weighted = (rows * np.repeat(w.T, 2, axis=1)[..., None]).swapaxes(1, 2)
    H, g = weighted @ rows, (weighted @ np.moveaxis(r, 1, 0).reshape(len(X), -1, 1))[..., 0]
    damping = 1e-9 * np.trace(H, axis1=1, axis2=2) + 1e-12
    X = X - np.linalg.solve(H + damping[:, None, None] * np.eye(3), g[..., None])[..., 0]
    return X, H, rig.project(X) - uv


def _points(names, X, information, error, inlier, seen, gate, settings):
    count, asked = inlier.sum(0), seen.sum(0)
    accepted = count >= np.where(asked >= MANY, settings.min_views + 1, settings.min_views)
    square = np.where(inlier, np.minimum(error, gate) ** 2, 0.0).sum(0)
    noise = np.maximum(settings.pixel_sigma, np.sqrt(square / np.maximum(2 * count - 3, 1)))
    regular = information + 1e-9 * np.eye(3)
    sigma = noise * np.sqrt(np.trace(np.linalg.inv(regular), axis1=1, axis2=2))
    accepted &= np.isfinite(X).all(1)
    return Points3D(
        names=names,
        points=np.where(accepted[:, None], X, np.nan),
        sigma=np.where(accepted, sigma, np.inf),
        views=count.astype(np.int32),
        gate=gate,
    )


def _nothing_seen(names):
    k = len(names)
    return Points3D(names, np.full((k, 3), np.nan), np.full(k, np.inf), np.zeros(k, np.int32))
