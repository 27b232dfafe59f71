"""A tube with a print of random dots on it."""

import numpy as np

RADIUS, HEIGHT = 0.15, 0.5


def tube(around=60, along=32):
    a, z = np.meshgrid(np.arange(around) / around * 2 * np.pi, np.linspace(0, HEIGHT, along))
    V = np.stack([RADIUS * np.cos(a), RADIUS * np.sin(a), z], -1).reshape(-1, 3)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij"))
    corner = [i * around + j, i * around + (j + 1) % around, (i + 1) * around + (j + 1) % around, (i + 1) * around + j]
    F = np.concatenate([np.stack([corner[k] for k in t], 1) for t in ((0, 1, 2), (0, 2, 3))]).astype(np.int32)
    return V, F


def dots(points, turn=0.0, seed=0):
    """Channels of a print of random dots, 2 cm wide, the whole turned about the tube's axis by `turn` [m along the surface]."""
    rng = np.random.default_rng(seed)
    angle, height, colour = rng.uniform(0, 2 * np.pi, 150), rng.uniform(0, HEIGHT, 150), rng.normal(0, 0.4, (150, 3))
    around = RADIUS * (np.arctan2(points[:, 1], points[:, 0])[:, None] - angle) - turn
    circle = 2 * np.pi * RADIUS
    around = (around + circle / 2) % circle - circle / 2
    return np.exp(-(around**2 + (points[:, 2:] - height) ** 2) / (2 * 0.01**2)) @ colour


def around_and_up(matcher, d):
    """Slides (g,2) as lengths around the tube and along its axis."""
    v, p = matcher.surface.vectors(d), matcher.surface.rest
    tangent = np.stack([-p[:, 1], p[:, 0], 0 * p[:, 0]], 1) / RADIUS
    return np.einsum("gi,gi->g", v, tangent), v[:, 2]
