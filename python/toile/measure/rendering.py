"""Shaded pictures of surfaces, from cameras of their own."""

from __future__ import annotations

import numpy as np

from .. import kernels

SIZE = (360, 220)  # (height, width) of a picture [px]
BODY, CLOTH = (222, 190, 170), ((86, 124, 168), (170, 110, 90), (110, 150, 100), (150, 120, 170))
PAPER = (244, 243, 240)
AXES = {  # rows: the picture's right, down and forward of a camera that looks at the front of a body at rest
    "z": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "y": ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
    "x": ((0, 1, 0), (-1, 0, 0), (0, 0, 1)),
}


def joined(surfaces):
    """One surface (V, F) of several [(V, F)], and of each triangle the number (m,) of the one that it is of."""
    offset = np.cumsum([0, *(len(V) for V, _ in surfaces)])
    F = np.concatenate([F + o for (_, F), o in zip(surfaces, offset)]).astype(np.int32)
    return (
        np.concatenate([V for V, _ in surfaces]),
        F,
        np.repeat(np.arange(len(surfaces)), [len(F) for _, F in surfaces]),
    )


def render(parts, angle, up="z", size=SIZE, about=None):
    """Shaded layers [(V, F, colour)] from the front (0) or elsewhere about the up axis [rad]: a picture (H,W,3) uint8. It
    shows all of them, or just the box around the points `about` (k,3)."""
    V, F, _ = joined([(V, F) for V, F, _ in parts])
    colour = np.concatenate([np.broadcast_to(p[2], (len(p[1]), 3)) for p in parts])
    box = _view(V if about is None else about, angle, up)
    centre = (box.min(0) + box.max(0)) / 2
    camera = _view(V, angle, up) - centre
    height, width = size[0] * 2, size[1] * 2
    extent = np.ptp(box, axis=0)
    span = max(extent[1] / height, extent[0] / width) * 1.08
    distance = 6.0
    camera = camera + [0, 0, distance]
    focal = distance / span
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    hit = kernels.raster(camera, F, K, (height, width)).face
    normals = kernels.vertex_normals(camera, F)[F].mean(1)
    light = np.clip(0.35 + 0.65 * np.abs(normals @ np.array([0.35, -0.45, -0.82])), 0, 1)
    shaded = np.concatenate([colour * light[:, None], [PAPER]]).astype(np.float32)[hit]
    quarters = shaded[::2, ::2] + shaded[1::2, ::2] + shaded[::2, 1::2] + shaded[1::2, 1::2]
    return (quarters / 4).round().astype(np.uint8)


def facing(rotation, up="z"):
    """The angle [rad] about the up axis from which a person is seen from the front, whose root is turned by a rotation
    vector (3,); 0 where it lies on its back or its front."""
    from scipy.spatial.transform import Rotation

    axes = np.array(AXES[up], dtype=np.float64)
    x, _, z = axes @ Rotation.from_rotvec(rotation).apply(-axes[2])
    return float(np.arctan2(x, -z)) if np.hypot(x, z) > 0.3 else 0.0


def _view(V, angle, up):
    """Points in the axes of a camera that looks at the person's front: x right, y down, z forward."""
    c, s = np.cos(angle), np.sin(angle)
    return V @ np.array(AXES[up], dtype=np.float64).T @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
