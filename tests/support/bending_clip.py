"""A clip with known answers: a bent tube and a patch over it, moved by a chain of three joints."""

import numpy as np

from toile.io.export.clip import Clip, ClipLayer, ClipSkeleton
from toile.scene import blend_skinning, joint_transforms

ROUND, HIGH = 8, 6


def tube(radius):
    """(vertices, faces, uv, face_uv) of an open tube about z whose UVs have a seam."""
    angle, height = np.arange(ROUND) * 2 * np.pi / ROUND, np.linspace(0, 1, HIGH)
    ring = np.stack([np.cos(angle), np.sin(angle)], 1) * radius
    V = np.concatenate([np.c_[ring, np.full(ROUND, z)] for z in height])
    faces, corners = [], []
    for j in range(HIGH - 1):
        for i in range(ROUND):
            at = lambda width, di, dj: (j + dj) * width + (i + di) % width
            for kind, width in ((faces, ROUND), (corners, ROUND + 1)):
                kind.append([at(width, 0, 0), at(width, 1, 0), at(width, 1, 1)])
                kind.append([at(width, 0, 0), at(width, 1, 1), at(width, 0, 1)])
    uv = np.stack(np.meshgrid(np.linspace(0, 1, ROUND + 1), height, indexing="xy"), -1).reshape(-1, 2)
    return V, np.array(faces, np.int32), uv, np.array(corners, np.int32)


def bending_clip(frames=(3, 4, 5, 7), up="z", loose=0.0):
    """`loose` [m]: vertices leave what the skeleton says by so much, in a way of their own a frame."""
    J, parents = np.array([[0, 0, 0.0], [0, 0, 0.4], [0, 0, 0.7]]), (-1, 0, 1)
    names = ("root", "upperarm01.L", "wrist")

    def pose(frame):
        turn = 0.1 * frame
        return np.array([[0.2, 0.1 * turn, turn], [turn, 0, 0.1], [0, -turn, 0]]), np.array([0.1, 0.2, 1.0]) * turn

    def layer(name, radius):
        V, F, uv, face_uv = tube(radius)
        weights = np.clip(1 - np.abs(V[:, 2:] - J[:, 2]) / 0.5, 0, None)
        order = np.argsort(-weights, axis=1)
        joints, weights = order.astype(np.int32), np.take_along_axis(weights, order, 1)
        weights = weights / weights.sum(1, keepdims=True)

        def at(frame):
            R, x = joint_transforms(parents, J, *pose(frame))
            noise = np.random.default_rng(frame).normal(size=V.shape)
            return blend_skinning(V, J, R, x, joints, weights) + loose * noise

        return ClipLayer(name, F, at, uv, face_uv, joints, weights)

    layers = layer("inner", 0.1), layer("t-shirt", 0.12)
    return Clip("bend", 25.0, up, tuple(frames), layers, ClipSkeleton(names, parents, J, pose))
