"""Lenses: how far from the ideal pinhole a camera's polynomial moves a point, and up to where it may be believed."""

from __future__ import annotations

from typing import Any

import numpy as np

from .kernels.arrays import Anything, Floats


def lens_limit(coefficients: Anything) -> Floats:
    """1 / r (...) of the least r where `coefficients` (..., 5) turn back, d (r radial) / dr = 0; 0 where they never do."""
    k1, k2, _, _, k3 = np.moveaxis(coefficients, -1, 0)
    companion = np.zeros((*np.shape(k1), 3, 3))  # of u^3 + 3 k1 u^2 + 5 k2 u + 7 k3 = 0, u = 1 / r^2
    companion[..., 0, :] = -np.stack([3 * k1, 5 * k2, 7 * k3], -1)
    companion[..., 1, 0] = companion[..., 2, 1] = 1
    u = np.linalg.eigvals(companion)
    return np.sqrt(np.where((u.imag == 0) & (u.real > 0), u.real, 0).max(-1))


def distort(xy: Anything, coefficients: Anything, limit: Anything, derivative: bool = False) -> Any:
    """Ideal normalised coordinates (..., 2) to distorted ones, and d distorted / d xy (..., 2, 2) where asked for.

    `coefficients` (..., 5): k1 k2 p1 p2 k3 of Brown 1971 in OpenCV's order, and their `lens_limit`, broadcast against the points.
    What lies beyond is moved as it is there: it would fold back into the picture."""
    if not np.any(limit):
        return _brown(xy, coefficients, derivative)
    r = np.linalg.norm(xy, axis=-1, keepdims=True)
    share = 1 / np.maximum(1, r * limit[..., None])
    if not derivative:
        return _brown(share * xy, coefficients, False) + (1 - share) * xy
    distorted, D = _brown(share * xy, coefficients, True)
    far = share[..., 0] < 1
    n = xy[far] / r[far]
    across = share[far][:, None] * (np.eye(2) - n[:, :, None] * n[:, None])  # d (share xy) / d xy
    D[far] = np.eye(2) + (D[far] - np.eye(2)) @ across
    return distorted + (1 - share) * xy, D


def _brown(xy: Anything, coefficients: Anything, derivative: bool) -> Any:
    k1, k2, p1, p2, k3 = np.moveaxis(coefficients, -1, 0)
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    distorted = np.stack([x * radial + dx, y * radial + dy], -1)
    if not derivative:
        return distorted
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d x = slope x
    D = np.empty(xy.shape + (2,))
    D[..., 0, 0] = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    D[..., 0, 1] = D[..., 1, 0] = slope * x * y + 2 * p1 * x + 2 * p2 * y
    D[..., 1, 1] = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return distorted, D
