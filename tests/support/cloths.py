"""Sheets of cloth, bodies that they fall upon, and the energy of a sheet written a second time."""

import numpy as np
import trimesh

from toile.kernels import DrapeSolver, unique_edges

GRAVITY = 9.81


def sheet(across=9, along=9, size=(0.4, 0.4), height=0.0):
    """A flat sheet about the z axis, faces up: vertices (along * across, 3), row after row."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, across) * size[0], np.linspace(-0.5, 0.5, along) * size[1])
    a = (np.arange(along - 1)[:, None] * across + np.arange(across - 1)).ravel()
    odd = ((np.arange(along - 1)[:, None] + np.arange(across - 1)) % 2 == 1).ravel()[:, None]
    b, c, d = a + 1, a + across + 1, a + across
    first = np.where(odd, np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(odd, np.stack([b, c, d], -1), np.stack([a, c, d], -1))
    return np.stack([x, y, 0 * x + height], -1).reshape(-1, 3), np.concatenate([first, second]).astype(np.int32)


def edge_lengths(V, F):
    """Lengths (e,) of the edges, as `DrapeSolver` takes them."""
    i, j = unique_edges(F).T
    return np.linalg.norm(V[i] - V[j], axis=1)


def ball(radius=0.2, subdivisions=3, at=(0, 0, 0)):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices) + at, np.array(mesh.faces, dtype=np.int32)


def slab(size=(2.0, 2.0, 0.2), cells=8):
    """A closed box with its top at z = 0."""
    mesh = trimesh.creation.box(size)
    for _ in range(int(np.log2(cells))):
        mesh = mesh.subdivide()
    return np.array(mesh.vertices) - [0, 0, size[2] / 2], np.array(mesh.faces, dtype=np.int32)


def solver(V, F, body_V, body_F, held=(), **options):
    return DrapeSolver(F, len(V), edge_lengths(V, F), body_F, len(body_V), held, **options)


def energy(V, F, density, stretch, bending):
    """x (3n,) -> (energy [J], its gradient) under gravity along -z, of a sheet at rest in V without slivers: springs and
    hinges, by angles instead of lengths."""
    corners = V[F]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    mass = np.zeros(len(V))
    np.add.at(mass, F.ravel(), np.repeat(density * area / 3, 3))
    beside = {}
    for f, face in enumerate(F.tolist()):
        for c in range(3):
            beside.setdefault(frozenset((face[c], face[(c + 1) % 3])), []).append((f, face[(c + 2) % 3]))
    i, j = np.array([sorted(edge) for edge in beside]).T
    rest = np.linalg.norm(V[i] - V[j], axis=1)
    stiffness = stretch * np.array([sum(area[f] for f, _ in sides) for sides in beside.values()]) / rest**2

    def cotangent(at, b, c):
        u, v = V[b] - V[at], V[c] - V[at]
        return u @ v / np.linalg.norm(np.cross(u, v))

    rows, weight = [], []
    for edge, sides in beside.items():
        if len(sides) == 2:
            (a, b), (f, k), (g, l) = sorted(edge), *sides
            row = np.zeros(len(V))
            for corner in (k, l):
                row[a] += cotangent(b, a, corner)
                row[b] += cotangent(a, b, corner)
                row[corner] -= cotangent(a, b, corner) + cotangent(b, a, corner)
            rows.append(row)
            weight.append(3 * bending / (area[f] + area[g]))
    hinges = np.array(rows)
    Q = hinges.T @ (np.array(weight)[:, None] * hinges)

    def at(x):
        X = x.reshape(-1, 3)
        d = X[i] - X[j]
        length = np.linalg.norm(d, axis=1)
        pull = (stiffness * (length - rest) / length)[:, None] * d
        gradient = Q @ X
        value = 0.5 * (stiffness * (length - rest) ** 2).sum() + 0.5 * (X * gradient).sum()
        np.add.at(gradient, i, pull)
        np.add.at(gradient, j, -pull)
        gradient[:, 2] += GRAVITY * mass
        return value + GRAVITY * mass @ X[:, 2], gradient.ravel()

    return at
