"""Exact triangle pairs and signed distances."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from toile import kernels


def icosphere(radius=1.0, subdivisions=3):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def rational_segment_meets_triangle(p, q, a, b, c):
    """Rational arithmetic on integer points; None where the segment lies in the triangle's plane."""

    def det(u, v, w):
        return (
            u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])
        )

    def orient(a, b, c, d):
        return det(*[[Fraction(int(x) - int(y)) for x, y in zip(v, d)] for v in (a, b, c)])

    above, below = orient(a, b, c, p), orient(a, b, c, q)
    if above == 0 and below == 0:
        return None
    if above * below > 0:
        return False
    sides = [orient(p, q, a, b), orient(p, q, b, c), orient(p, q, c, a)]
    return all(s >= 0 for s in sides) or all(s <= 0 for s in sides)


def rational_triangles_meet(t, u):
    answers = [rational_segment_meets_triangle(x[i], x[(i + 1) % 3], *y) for x, y in ((t, u), (u, t)) for i in range(3)]
    return None if all(a is None for a in answers) else any(a for a in answers if a is not None)


def test_pairs_match_rational_arithmetic_on_random_integer_triangles():
    rng = np.random.default_rng(3)
    V1, V2 = rng.integers(-4, 5, (240, 3)), rng.integers(-4, 5, (240, 3))
    F = np.arange(240, dtype=np.int32).reshape(-1, 3)
    area = lambda V: np.abs(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])).sum(1) > 0
    found = {tuple(p) for p in kernels.intersecting_pairs(V1, F, V2, F)}
    checked = 0
    for f, g in product(np.flatnonzero(area(V1)), np.flatnonzero(area(V2))):
        truth = rational_triangles_meet(V1[F[f]], V2[F[g]])
        if truth is not None:
            assert ((f, g) in found) == truth
            checked += 1
    assert checked > 5000 and len(found) > 500


def test_pairs_of_shifted_spheres_match_all_faces_against_all():
    V, F = icosphere(subdivisions=1)
    W = V + [0.31, 0.17, 0.05]
    brute = [[f, g] for f in range(len(F)) for g in range(len(F)) if segments_meet(V[F[f]], W[F[g]])]
    assert kernels.intersecting_pairs(V, F, W, F).tolist() == brute


def segments_meet(t, u):
    """Edges of each triangle against the other, in floating point: fine in general position."""

    def edge_through(p, q, tri):
        a, b, c = tri
        n = np.cross(b - a, c - a)
        s, e = n @ (p - a), n @ (q - a)
        if s * e > 0:
            return False
        x = p + (q - p) * s / (s - e)
        inside = [np.cross(b - a, x - a) @ n, np.cross(c - b, x - b) @ n, np.cross(a - c, x - c) @ n]
        return min(inside) >= 0

    return any(edge_through(x[i], x[(i + 1) % 3], y) for x, y in ((t, u), (u, t)) for i in range(3))


def test_nested_spheres_have_no_pair_and_touching_ones_have():
    V, F = icosphere(1.0)
    assert len(kernels.intersecting_pairs(1.01 * V, F, V, F)) == 0
    assert set(map(tuple, kernels.intersecting_pairs(V, F, V, F))) >= {(f, f) for f in range(len(F))}


def test_pairs_are_symmetric_and_follow_a_permutation_of_faces():
    V, F = icosphere(subdivisions=2)
    W = V * [1.2, 0.9, 1.0]
    pairs = kernels.intersecting_pairs(V, F, W, F)
    assert {(g, f) for f, g in pairs} == set(map(tuple, kernels.intersecting_pairs(W, F, V, F)))
    order = np.random.default_rng(0).permutation(len(F))
    permuted = kernels.intersecting_pairs(V, F[order], W, F)
    assert {(order[f], g) for f, g in permuted} == set(map(tuple, pairs))


@pytest.mark.parametrize("offset, scale", [(0.0, 1e-6), (0.0, 1e6), (2.0**20, 1.0)])
def test_pairs_do_not_depend_on_units_or_origin(offset, scale):
    V, F = icosphere(subdivisions=2)
    V = np.round(V * 2**20) / 2**20  # so that the offset is added without rounding
    W = np.round((V + [0.3, 0.2, 0.1]) * 2**20) / 2**20
    expected = kernels.intersecting_pairs(V, F, W, F)
    assert len(expected) > 0
    assert np.array_equal(kernels.intersecting_pairs(V * scale + offset, F, W * scale + offset, F), expected)


def test_self_intersections_of_two_spheres_in_one_mesh_are_their_pairs():
    V, F = icosphere(subdivisions=2)
    W = V + [0.31, 0.17, 0.05]
    both = kernels.self_intersections(np.vstack([V, W]), np.vstack([F, F + len(V)]))
    pairs = kernels.intersecting_pairs(V, F, W, F) + [0, len(F)]
    assert np.array_equal(both, pairs)
    assert len(kernels.self_intersections(V, F)) == 0


def test_signed_distance_to_a_sphere_is_radius_minus_one():
    V, F = icosphere(subdivisions=5)
    P = np.random.default_rng(1).normal(size=(500, 3))
    d = kernels.signed_distance(P, V, F)
    assert np.abs(d - (np.linalg.norm(P, axis=1) - 1)).max() < 1e-3


def test_signed_distance_matches_libigl_on_overlapping_spheres():
    import igl

    V, F = icosphere(subdivisions=3)
    V, F = np.vstack([V, V + [0.7, 0.1, 0]]), np.vstack([F, F + len(V)])
    P = np.random.default_rng(2).uniform(-1.5, 2.2, (2000, 3))
    exact = igl.winding_number(V, F, P)
    assert np.abs(kernels.winding_number(P, V, F) - exact).max() < 0.05
    distance = np.sqrt(igl.point_mesh_squared_distance(P, V, F)[0])
    assert np.abs(kernels.signed_distance(P, V, F) - np.where(exact > 0.5, -distance, distance)).max() < 1e-9


def test_threads_do_not_change_a_bit(threads):
    V, F = icosphere(subdivisions=4)
    W = V * [1.1, 0.95, 1.0]
    P = np.random.default_rng(5).normal(size=(3000, 3))
    answers = []
    for n in (1, 2, 3, 8):
        threads(n)
        answers.append(
            (kernels.intersecting_pairs(V, F, W, F), kernels.signed_distance(P, V, F), kernels.winding_number(P, V, F))
        )
    for other in answers[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(answers[0], other))


def test_bad_input_is_refused_by_name_and_index():
    V, F = icosphere(subdivisions=1)
    bad_F, bad_V = F.copy(), V.copy()
    bad_F[7, 1] = 99
    bad_V[3] = np.nan
    with pytest.raises(kernels.InputError, match=r"intersecting_pairs: F2\[7\] holds vertex 99"):
        kernels.intersecting_pairs(V, F, V, bad_F)
    with pytest.raises(kernels.InputError, match=r"intersecting_pairs: V1\[3\] is not finite"):
        kernels.intersecting_pairs(bad_V, F, V, F)
    with pytest.raises(kernels.InputError, match=r"self_intersections: V is empty"):
        kernels.self_intersections(np.empty((0, 3)), F)
    with pytest.raises(kernels.InputError, match=r"signed_distance: points\[3\] is not finite"):
        kernels.signed_distance(bad_V, V, F)
    with pytest.raises(kernels.InputError, match=r"signed_distance: F has shape"):
        kernels.signed_distance(V, V, F[:, :2])
