"""Every kernel on a small problem against a closed form, brute force or scipy."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ... import kernels
from ...errors import first_line
from ...io.body import load_body_model
from ...scene import Camera


@dataclass(frozen=True)
class Checked:
    """A kernel's error against its reference, None where it raised `said`."""

    name: str
    against: str
    error: float | None
    most: float
    seconds: float
    said: str = ""

    @property
    def sound(self) -> bool:
        return self.error is not None and self.error <= self.most


def check_kernels() -> Iterator[Checked]:
    """One after the other, each about a second at most."""
    for name, (check, against, most) in CHECKS.items():
        start, error, said = time.perf_counter(), None, ""
        try:
            error = float(check())
        except Exception as broken:  # whatever it is, the other kernels are still looked at
            said = f"{type(broken).__name__}: {first_line(broken)}"
        yield Checked(name, against, error, most, time.perf_counter() - start, said)


# Surfaces -------------------------------------------------------------------------------------------------------------


def ball(radius=1.0, fine=3):
    """A closed sphere (n,3), (m,3)."""
    import trimesh

    mesh = trimesh.creation.icosphere(fine, radius)
    return np.array(mesh.vertices), np.array(mesh.faces, np.int32)


def sheet(n=21):
    """A unit square in z = 0 of n x n vertices."""
    x = np.linspace(0, 1, n)
    V = np.stack([*np.meshgrid(x, x, indexing="xy"), np.zeros((n, n))], -1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    F = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return V, F.astype(np.int32)


def tube(radius, height=0.4, around=48, along=12):
    """An open cylinder about z."""
    angle, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(-height / 2, height / 2, along))
    V = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(along - 1))
    a, b = (j * around + i).ravel(), (j * around + (i + 1) % around).ravel()
    return V, np.concatenate([np.c_[a, b, b + around], np.c_[a, b + around, a + around]]).astype(np.int32)


def in_front(V):
    """A pinhole camera (K, size) and the surface in its frame, two metres away."""
    return np.array([[100.0, 0, 48], [0, 100, 48], [0, 0, 1]]), (96, 96), V + [0, 0, 2]


# Checks, each the largest error --------------------------------------------------------------------------------------


def biharmonic():
    V, F = sheet()
    D = V @ np.array([[0.3, -0.1, 0.2], [0.1, 0.2, -0.3], [0, 0, 0]])
    known = np.flatnonzero((V[:, 0] < 0.11) | (V[:, 0] > 0.89) | (V[:, 1] < 0.11) | (V[:, 1] > 0.89))
    return np.abs(kernels.biharmonic(V, F, known, D[known]) - D).max()


def cholesky():
    import scipy.sparse as sp
    from scipy.sparse.linalg import spsolve

    V, F = ball()
    A = sp.csc_matrix(sp.eye(len(V)) - kernels.cotangent_laplacian(V, F))
    return np.abs(kernels.CholeskyFactor().factorize(A).solve(V) - spsolve(A, V)).max()


def closest():
    V, F = ball(fine=4)
    points = 1.5 * ball(fine=2)[0]
    distance = kernels.SurfaceIndex(V, F).closest(points)[3]
    return np.abs(distance - 0.5).max()


def signed_distance():
    V, F = ball(fine=4)
    radius = np.linspace(0.2, 1.8, 40)
    found = kernels.signed_distance(radius[:, None] * np.full(3, 3**-0.5), V, F)
    return np.abs(np.abs(found) - np.abs(radius - 1)).max() + 10 * np.any((found < 0) != (radius < 0.999))


def winding_number():
    V, F = ball()
    return np.abs(kernels.winding_number(np.array([[0, 0, 0.1], [0, 0, 3.0]]), V, F) - [1, 0]).max()


def intersecting_pairs():
    """Triangles of two spheres, by their planes and edges."""
    (V, F), W = ball(fine=0), ball(fine=0)[0] @ np.diag([0.9, 1.05, 1.1]) + [0.7, 0.31, 0.23]
    brute = {(i, j) for i, j in itertools.product(range(len(F)), repeat=2) if meet(V[F[i]], W[F[j]])}
    return len(brute ^ set(map(tuple, kernels.intersecting_pairs(V, F, W, F).tolist())))


def meet(a, b):
    """Does an edge of one triangle (3,3) pass through the other?"""
    return any(pierces(p[k], p[k - 1], q) for p, q in ((a, b), (b, a)) for k in range(3))


def pierces(start, end, t):
    normal = np.cross(t[1] - t[0], t[2] - t[0])
    before, behind = (start - t[0]) @ normal, (end - t[0]) @ normal
    if before * behind > 0:
        return False
    place = start + before / (before - behind) * (end - start)
    sides = [np.cross(t[k] - t[k - 1], place - t[k - 1]) @ normal for k in range(3)]
    return min(sides) >= 0


def mrf():
    rng = np.random.default_rng(1)
    unary, edges = rng.uniform(0, 1, (10, 2)), np.array(list(itertools.combinations(range(10), 2)))
    weights = rng.uniform(0, 0.2, len(edges))
    X = np.array(list(itertools.product(range(2), repeat=10)))
    energy = unary[np.arange(10), X].sum(1) + (X[:, edges[:, 0]] != X[:, edges[:, 1]]) @ weights
    return abs(kernels.mrf(unary, edges, weights).energy - energy.min())


def untangle():
    (cloth, F), (V, G) = tube(0.99), ball()
    found = kernels.untangle(cloth, F, V, G)
    return len(kernels.intersecting_pairs(found.V, F, V, G))


def nricp():
    V, F = ball(0.5)
    d = 1 + 0.15 * np.sin(5 * V[:, :1] + 1) * np.cos(4 * V[:, 1:2])
    x, y, z = (V * d).T
    bent = np.stack([x + 0.04 * z**2, y + 0.02 * np.sin(2 * z), z - 0.04 * x * z], 1)
    found = kernels.nricp(V * d, F, bent, F, preset="draft").V
    return kernels.SurfaceIndex(bent, F).closest(found)[3].max()


def posed_body():
    """The packaged body with arms, legs and head turned: (model, vertices, rotations, translation)."""
    model, rng = load_body_model(), np.random.default_rng(5)
    rotations = np.zeros((len(model.parents), 3))
    for k, role in enumerate(model.joint_roles):
        if role.startswith(("upperarm01", "lowerarm01", "upperleg01", "neck01")):
            rotations[k] = rng.uniform(-0.15, 0.15, 3)
    translation = np.array([0.02, -0.01, 0.01])
    return model, model.skin(model.v_template, model.J, rotations, translation), rotations, translation


def skeleton():
    model, V, rotations, translation = posed_body()
    start = 0.7 * rotations, 0.7 * translation, np.zeros(4)
    found = kernels.SkeletonSolver(model).solve(V, model.f, start=start)
    return kernels.SurfaceIndex(V, model.f).closest(found.V)[3].mean()


def drape():
    V, F = sheet()
    body_V, body_F = ball()
    i, j = kernels.unique_edges(F).T
    far = body_V - [0, 0, 50]
    cloth = kernels.DrapeSolver(F, len(V), np.linalg.norm(V[i] - V[j], axis=1), body_F, len(far))
    cloth.start(V, far, settle=0)
    return np.abs(cloth.step(far, 0.5).V - V + [0, 0, 9.81 * 0.5**2 / 2]).max()


def inner():
    model, V, rotations, translation = posed_body()
    covered = np.isin(np.arange(len(V)), model.segments["torso"])
    shirt = V + 0.01 * kernels.vertex_normals(V, model.f)
    frame = rotations, translation, np.where(covered[:, None], shirt, V), (~covered).astype(float), [(shirt, model.f)]
    solver = kernels.InnerSolver(model, np.zeros(4))
    found = solver.solve(solver.fuse([frame]).rest, *frame)
    return np.linalg.norm(found.V - V, axis=1)[~covered].mean()


def raster():
    """Depths against rays through the pixels' centres."""
    V, F = ball(0.5)
    K, size, V = in_front(V)
    found = kernels.raster(V, F, K, size)
    row, column = np.nonzero(found.face >= 0)
    rays = np.c_[column + 0.5, row + 0.5, np.ones(len(row))] @ np.linalg.inv(K).T
    a, b, c = V[F[found.face[row, column]]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    depth = np.sum(a * normal, 1) / np.sum(rays * normal, 1)
    return np.abs(found.depth[row, column] - depth).max() + 10 * (len(row) < 1000)


def visibility():
    """The half of a ball that faces the camera."""
    V, F = ball(0.5)
    K, size, placed = in_front(V)
    T = np.eye(4)
    T[2, 3] = 2
    depth = kernels.raster(placed, F, K, size).depth
    N = kernels.vertex_normals(V, F)
    seen = kernels.visibility(V, N, K, np.zeros(5), T, depth, 0.01, 0.2)[1] > 0
    cosine = -np.sum(N * placed, 1) / np.linalg.norm(placed, axis=1)
    return np.mean(seen[np.abs(cosine - 0.2) > 0.1] != (cosine > 0.2)[np.abs(cosine - 0.2) > 0.1])


def bilinear():
    ramp = np.tile(np.arange(20.0)[None, :, None], (10, 1, 3)).astype(np.uint8)
    at = np.random.default_rng(0).uniform(1, 9, (50, 2))
    return np.abs(kernels.bilinear(ramp, at) - (at[:, :1] - 0.5)).max()


def ambient_occlusion():
    """Under a ball the sky that is lost is the squared sine of its half angle."""
    (V, F), (B, G) = sheet(), ball(0.2)
    found = kernels.ambient_occlusion(
        np.concatenate([V, B + [0.5, 0.5, 0.5]]), np.concatenate([F, G + len(V)]), rays=4096
    )
    return abs(found[220] - (1 - 0.4**2))


def remesh():
    V, F = tube(0.1, 0.4)
    X, G = kernels.remesh(V, F, 0.02)
    return kernels.SurfaceIndex(V, F).closest(X)[3].max() + abs(len(kernels.boundary_loops(G)) - 2)


def cheapest_path():
    cost, step = np.random.default_rng(0).uniform(0, 1, (6, 4)), np.random.default_rng(1).uniform(0, 1, (4, 4))
    total = lambda path: cost[np.arange(6), path].sum() + step[path[:-1], path[1:]].sum()
    best = min(total(np.array(path)) for path in itertools.product(range(4), repeat=6))
    return abs(total(kernels.cheapest_path(cost, step)) - best)


def stereo():
    """Three cameras before the plane z = 1 with a texture of waves."""
    waves = np.random.default_rng(3).normal(0, 150, (24, 2))
    K, cameras, pictures = np.array([[160.0, 0, 40], [0, 160, 32], [0, 0, 1]]), [], []
    v, u = np.mgrid[:64, :80] + 0.5
    for i, x in enumerate((-0.1, 0.0, 0.1)):
        T = np.eye(4)
        T[0, 3] = -x
        cameras.append(Camera(f"{i}", 80, 64, K, np.zeros(5), T))
        place = np.stack([(u - 40) / 160 + x, (v - 32) / 160], -1)
        pictures.append(np.clip(128 + 6 * np.sin(place @ waves.T + np.arange(24)).sum(-1), 0, 255).astype(np.float32))
    depth = kernels.StereoSolver(cameras).solve(pictures, None, np.tile([0.6, 1.8], (3, 1))).depth
    return np.nanmedian(np.abs(depth[1][12:-12, 16:-16] - 1))


CHECKS: dict[str, tuple[Callable[[], float], str, float]] = {
    "biharmonic": (biharmonic, "an affine field on a sheet comes back", 1e-9),
    "cholesky": (cholesky, "scipy's sparse solver", 1e-9),
    "closest": (closest, "distances to a sphere [m]", 1e-9),
    "signed_distance": (signed_distance, "distances to a sphere, and their signs [m]", 5e-3),
    "winding_number": (winding_number, "1 inside a sphere, 0 outside", 0.05),
    "intersecting_pairs": (intersecting_pairs, "all edges through all triangles [pairs]", 0),
    "mrf": (mrf, "all labellings of ten nodes", 1e-9),
    "cheapest_path": (cheapest_path, "all paths", 1e-12),
    "untangle": (untangle, "no triangles of cloth and body meet [pairs]", 0),
    "nricp": (nricp, "a known bend comes back [m]", 2e-3),
    "skeleton": (skeleton, "a posed body comes back [m]", 2e-3),
    "drape": (drape, "a sheet in free fall [m]", 5e-3),
    "inner": (inner, "a body under a shirt keeps its bare skin [m]", 2e-3),
    "raster": (raster, "rays through pixels [m]", 1e-9),
    "visibility": (visibility, "the half of a sphere that faces the camera [share]", 0),
    "bilinear": (bilinear, "a ramp", 1e-5),
    "ambient_occlusion": (ambient_occlusion, "the sky under a ball", 1e-2),
    "remesh": (remesh, "a tube stays where it is, with both borders [m]", 1e-6),
    "stereo": (stereo, "a textured plane [m]", 2e-3),
}
