"""Shapes with known answers."""

import numpy as np


def sphere(rings=48, sectors=96, radius=1.0):
    """A closed sphere, outward faces."""
    t = np.linspace(0, np.pi, rings + 1)[1:-1]
    p = np.linspace(0, 2 * np.pi, sectors, endpoint=False)
    T, P = np.meshgrid(t, p, indexing="ij")
    V = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], -1).reshape(-1, 3)
    V = radius * np.concatenate([V, [[0, 0, 1.0], [0, 0, -1.0]]])
    i, j = np.meshgrid(np.arange(rings - 2), np.arange(sectors), indexing="ij")
    a, b = i * sectors + j, i * sectors + (j + 1) % sectors
    c, d = a + sectors, b + sectors
    F = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    j = np.arange(sectors)
    top, bottom, last = len(V) - 2, len(V) - 1, (rings - 2) * sectors
    caps = [
        np.stack([0 * j + top, j, (j + 1) % sectors], 1),
        np.stack([last + j, 0 * j + bottom, last + (j + 1) % sectors], 1),
    ]
    return V, np.concatenate([F, *caps]).astype(np.int32)


def tube(rings=40, sectors=64, radius=0.2, height=0.6):
    """An open cylinder about z with outward faces."""
    z = np.linspace(0, height, rings)
    p = np.linspace(0, 2 * np.pi, sectors, endpoint=False)
    Z, P = np.meshgrid(z, p, indexing="ij")
    V = np.stack([radius * np.cos(P), radius * np.sin(P), Z], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(sectors), indexing="ij")
    a, b = i * sectors + j, i * sectors + (j + 1) % sectors
    F = np.concatenate(
        [np.stack([a, b, a + sectors], -1).reshape(-1, 3), np.stack([b, b + sectors, a + sectors], -1).reshape(-1, 3)]
    )
    return V, F.astype(np.int32)


def box(size, at):
    """A closed box (8 vertices, 12 faces) about a place."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return corners * size + at, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
