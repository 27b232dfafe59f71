"""Label errors as networks make them: borders shifted by 3-6 pixels and blobs of a wrong part, alike in all views.

Both are fields on the surface in 3D, so views agree about what is wrong; they are drawn anew for every frame.
"""

from __future__ import annotations

import numpy as np

from .surface import smooth_noise

SHIFT_PX = (3.0, 6.0)  # length of the border shift
SHIFT_LENGTH = 0.06  # m, over which the shift's direction and length change
BLOB_RADIUS = (0.015, 0.05)  # m
MAX_BLOBS = 4000


def wrong_labels(views, cameras, fraction, rng):
    """Label images whose errors cover `fraction` of all foreground pixels over the views; gives (images, share)."""
    total = sum(len(v.points) for v in views)
    if fraction <= 0 or total == 0:
        return [v.labels.copy() for v in views], 0.0
    points = np.concatenate([v.points for v in views])
    true = np.concatenate([v.labels[v.mask] for v in views])
    parts = np.split(np.arange(total), np.cumsum([len(v.points) for v in views])[:-1])
    field = shift_field(points, rng)
    label = np.concatenate([shifted(v, c, field[i]) for v, c, i in zip(views, cameras, parts)])
    keep = partial_shift(label != true, fraction, points, rng)
    label[~keep] = true[~keep]
    add_blobs(label, true, points, fraction, rng)
    images = []
    for view, i in zip(views, parts):
        image = np.zeros_like(view.labels)
        image[view.mask] = label[i]
        images.append(image)
    return images, float((label != true).mean())


def shift_field(points, rng):
    """World vectors (p,3) of length in (0,1]: direction and length vary smoothly along the surface."""
    d = np.stack([smooth_noise(points, SHIFT_LENGTH, rng, 32) for _ in range(3)], 1)
    d /= np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
    low, high = SHIFT_PX
    t = 0.5 + 0.5 * np.tanh(smooth_noise(points, SHIFT_LENGTH, rng, 32))
    return d * (low + (high - low) * t)[:, None]


def shifted(view, camera, field):
    """Each pixel takes the label found `field` pixels (measured along the camera's axes) away; the mask stays."""
    row, col = np.nonzero(view.mask)
    step = field @ camera.T_camera_world[:2, :3].T
    r = np.clip(np.rint(row + step[:, 1]).astype(int), 0, view.mask.shape[0] - 1)
    c = np.clip(np.rint(col + step[:, 0]).astype(int), 0, view.mask.shape[1] - 1)
    moved = view.labels[r, c]
    return np.where(moved > 0, moved, view.labels[row, col])


def partial_shift(wrong, fraction, points, rng):
    """Where the shift is kept (p,): everywhere, or a smooth share of the surface if it alone exceeds `fraction`."""
    share = wrong.mean()
    if share <= fraction:
        return np.ones(len(points), bool)
    gate = smooth_noise(points, 0.1, rng, 32)
    return gate <= np.quantile(gate[wrong], fraction / share)


def add_blobs(label, true, points, fraction, rng):
    """Balls of another label present in the frame, until `fraction` of the pixels is wrong. Changes `label`."""
    from scipy.spatial import cKDTree

    ids = np.unique(true)
    tree = cKDTree(points)
    wrong, goal = int((label != true).sum()), fraction * len(points)
    for _ in range(MAX_BLOBS):
        if wrong >= goal or len(ids) < 2:
            return
        centre = points[rng.integers(len(points))]
        inside = np.array(tree.query_ball_point(centre, rng.uniform(*BLOB_RADIUS)), dtype=int)
        other = rng.choice(ids)
        wrong += int((other != true[inside]).sum()) - int((label[inside] != true[inside]).sum())
        label[inside] = other
