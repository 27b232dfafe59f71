"""Operators, topology, closest points, sides, sights and factors: how to draw their arguments, and what their results must be."""

import numpy as np
import scipy.sparse as sp

from toile import kernels

from .laws import LAWFUL, finite, rows, within


def draw_mesh(d):
    V, F = d.dressed(*d.mesh())
    return {"V": V, "F": F}


def run_operators(V, F):
    n, m = rows(V), rows(F)
    results = []
    for name, shape in (
        ("vertex_normals", (n, 3)),
        ("face_normals", (m, 3)),
        ("face_areas", (m,)),
        ("voronoi_mass", (n,)),
    ):
        try:
            results.append((name, getattr(kernels, name)(V, F), shape))
        except LAWFUL:
            continue
    try:
        L = kernels.cotangent_laplacian(V, F)
        assert L.shape == (n, n)
        results.append(("cotangent_laplacian", L.data, None))
    except LAWFUL:
        pass
    for result in results:
        finite(*result)


def draw_topology(d):
    V, F = d.mesh()
    return {"F": d.layout(d.indices(F)), "n": d.whole(len(V), len(V) + 3)}


def run_topology(F, n):
    try:
        for loop in kernels.boundary_loops(F):
            assert len(loop) >= 1
        edges = kernels.unique_edges(F)
        assert (edges[:, 0] <= edges[:, 1]).all()
        within("face_neighbours", kernels.face_neighbours(F), -1, rows(F) - 1)
    except LAWFUL:
        pass
    finite("border_vertices", kernels.border_vertices(F, n), (n,))
    finite("vertex_components", kernels.vertex_components(F, n), (n,))


def draw_closest(d):
    V, F = d.dressed(*d.mesh())
    k = int(d.rng.integers(0, 30))
    return {
        "V": V,
        "F": F,
        "P": d.points(k, 0.4),
        "D": d.points(k),
        "radius": d.number(1e-3, 1e3),
        "far": d.number(1e-3, 1e3),
    }


def run_closest(V, F, P, D, radius, far):
    index = kernels.SurfaceIndex(V, F)
    try:
        face, point, barycentric, distance = index.closest(P, radius)
        hit = face >= 0
        within("face", face, -1, rows(F) - 1)
        finite("point", point[hit])
        finite("distance", distance[hit])
        within("barycentric", barycentric[hit], -1e-6, 1 + 1e-6)
        assert radius < 1e29 or hit.all(), "no face within an unbounded radius"
    except LAWFUL:
        pass
    try:
        face, point, barycentric, distance = index.reached(P, np.arange(rows(P)) % max(rows(F), 1))
        within("face", face, 0, rows(F) - 1)
        finite("point", point)
        within("barycentric", barycentric, -1e-6, 1 + 1e-6)
        assert (distance >= index.closest(P)[3] * (1 - 1e-9)).all(), "reached nearer than the nearest"
    except LAWFUL:
        pass
    assert index.occluded(P, D, 0.0, far).shape == (rows(P),)


def draw_pairs(d):
    V1, F1 = d.dressed(*d.mesh())
    V2, F2 = d.dressed(*d.mesh())
    return {"V1": V1, "F1": F1, "V2": V2, "F2": F2}


def run_pairs(V1, F1, V2, F2):
    for pairs, other in (
        (lambda: kernels.self_intersections(V1, F1), F1),
        (lambda: kernels.intersecting_pairs(V1, F1, V2, F2), F2),
    ):
        try:
            found = pairs()
        except LAWFUL:
            continue
        within("pairs", found[:, 0], 0, rows(F1) - 1)
        within("pairs", found[:, 1], 0, rows(other) - 1)


def draw_inside(d):
    V, F = d.dressed(*d.mesh(closed=True if d.chance(0.7) else None))
    return {"P": d.points(int(d.rng.integers(0, 40)), 0.4), "V": V, "F": F}


def run_inside(P, V, F):
    for query in (kernels.winding_number, kernels.signed_distance):
        try:
            finite(query.__name__, query(P, V, F), (rows(P),))
        except LAWFUL:
            continue


def draw_cholesky(d):
    n = int(d.rng.integers(0, 30))
    A = sp.random(n, n, 0.2, random_state=d.rng.integers(2**31)) if n else sp.csc_matrix((0, 0))
    A = sp.csc_matrix(A @ A.T + sp.eye(n) * d.pick([1, 0, -1, 1e-300, 1e300])) if n else A
    if len(A.data) and d.spoil():
        A.data[d.rng.integers(len(A.data))] = d.pick((np.nan, np.inf, 1e300))
    if d.spoil():
        A = A[:, : n - 1] if d.chance(0.5) else sp.csc_matrix(A.astype(np.float32)) if d.chance(0.5) else A.tocoo()
    return {"A": A, "B": d.layout(d.values(d.rng.normal(size=(n + int(d.spoil(0.1)), int(d.rng.integers(0, 4))))))}


def run_cholesky(A, B):
    factor = kernels.CholeskyFactor()
    try:
        factor.solve(B)
        assert rows(B) == 0, "solved without a factor"
    except LAWFUL:
        pass
    factor.factorize(A)
    finite("solution", factor.solve(B), np.shape(B))


def draw_sight(d):
    n, size = int(d.rng.integers(0, 30)), d.rng.integers(1, 12, 2)
    f = d.number(1, 1e3)
    T = np.eye(4)
    T[:3, 3] = d.rng.normal(size=3)
    return {
        "points": d.points(n, 0.4), "normals": d.points(n + int(d.spoil(0.1)), 0.4),
        "K": d.layout(d.values([[f, 0, 5], [0, f, 5], [0, 0, 1]])), "distortion": d.layout(d.values(0.1 * d.rng.normal(size=5))),
        "T": d.layout(d.values(T)), "depth": d.layout(d.values(d.rng.uniform(0, 4, size))), "tolerance": d.number(1e-3, 1),
        "min_cosine": d.number(1e-3, 1), "image": d.layout(d.rng.random((*size, int(d.rng.integers(0, 5)))).astype(np.float32)),
    }  # fmt: skip


def run_sight(points, normals, K, distortion, T, depth, tolerance, min_cosine, image):
    uv, weight, clearance = kernels.visibility(points, normals, K, distortion, T, depth, tolerance, min_cosine)
    n = rows(points)
    assert uv.shape == (n, 2) and clearance.shape == (n,)
    finite("weight", weight, (n,))
    within("weight", weight, 0, np.inf)
    finite("readings", kernels.bilinear(image, uv), (n, np.shape(image)[2]))
