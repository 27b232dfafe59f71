"""Prints as the pictures show them: colours at a lattice's points, over all views, free of the cameras' own colours."""

from __future__ import annotations

import numpy as np

DARK = 0.04  # added to colours 0..1 before their logarithm is taken
# lightness and two chromas of logarithms of RGB
CHANNELS = np.array([[1 / 3, 1 / 3, 1 / 3], [1, -1, 0], [-0.5, -0.5, 1]])
SURE = 0.25  # total squared weight of a point's views from which it counts in full
SHARED = 0.2  # weight of other views that a point needs to be compared with theirs
ROUNDS = 5  # of bettering what cameras add
SHARE = 0.7  # of a round's step: all cameras move at once, whole steps would overshoot


def logarithms(colours):
    """Of uint8 colours (k,3)."""
    return np.log(colours / 255.0 + DARK)


def blended(views, offsets, points):
    """Channels (N,3) and weights (N,) 0..1 of a frame's views together; views more face-on count by the square."""
    total, weight = np.zeros((points, 3)), np.zeros(points)
    for view, offset in zip(views, offsets):
        w = view.weights**2
        total[view.texels] += w[:, None] * (logarithms(view.colours) - offset)
        weight[view.texels] += w
    return total / np.maximum(weight, 1e-9)[:, None] @ CHANNELS.T, np.minimum(weight / SURE, 1)


def camera_offsets(frames, points):
    """What each camera adds to the logarithm of colours (c,3), against the mean of the others at the same points;
    frames: lists of Unwrapped a camera. Their mean over cameras is zero."""
    offsets = np.zeros((len(frames[0]), 3))
    for _ in range(ROUNDS):
        apart = [[] for _ in offsets]
        for views in frames:
            logs = [logarithms(v.colours) - o for v, o in zip(views, offsets)]
            total, weight = np.zeros((points, 3)), np.zeros(points)
            for view, y in zip(views, logs):
                total[view.texels] += view.weights[:, None] * y
                weight[view.texels] += view.weights
            for view, y, own in zip(views, logs, apart):
                others = weight[view.texels] - view.weights
                k = others > SHARED
                rest = total[view.texels][k] - view.weights[k, None] * y[k]
                own.append(y[k] - rest / others[k, None])
        step = np.array([np.median(np.concatenate(a), axis=0) if sum(map(len, a)) else np.zeros(3) for a in apart])
        offsets += SHARE * step
        offsets -= offsets.mean(0)
    return offsets
