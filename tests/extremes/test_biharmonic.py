"""biharmonic at the edges of what it may be given: each row is solved or refused."""

import numpy as np
import pytest

from toile.kernels import BiharmonicSolver, InputError, biharmonic

AFFINE = np.array([[0.3, -0.2, 0.1], [0.05, 0.4, -0.3], [0.7, 0.2, 0.6]])


def sheet(n=12):
    """A planar square of side 1, (n+1)^2 vertices; and its rim with one ring."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a = i[:-1, :-1].ravel()
    F = np.concatenate([np.c_[a, a + 1, a + n + 2], np.c_[a, a + n + 2, a + n + 1]])
    rings = np.unique(np.concatenate([i[:2].ravel(), i[-2:].ravel(), i[:, :2].ravel(), i[:, -2:].ravel()]))
    return np.stack([x, y, 0 * x], -1).reshape(-1, 3) / n, F, rings


def affine_error(V, F, known, solver=None):
    """Of the affine field, relative to the mesh: exact whatever happens inside, since the mesh is planar."""
    field = (V - V[0]) @ AFFINE.T
    D = (solver or BiharmonicSolver(V, F, known)).solve(field[known])
    return np.abs(D - field).max() / np.ptp(V)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3])
def test_biharmonic_solved_in_any_unit(scale):
    V, F, rings = sheet()
    assert affine_error(scale * V, F, rings) < 1e-11


def test_biharmonic_solved_far_from_the_origin():
    V, F, rings = sheet()
    assert affine_error(V + [1e6, -1e6, 1e6], F, rings) < 1e-7  # the corners themselves are rounded to 1e-10


def needles(V, F):
    tips = V[F[100:120, 0]] + 1e-9 * (V[F[100:120]].mean(1) - V[F[100:120, 0]])
    new = len(V) + np.arange(20)
    fans = [np.column_stack([F[100:120, c], F[100:120, (c + 1) % 3], new]) for c in range(3)]
    return np.vstack([V, tips]), np.vstack([np.delete(F, np.s_[100:120], axis=0), *fans])


def zero_area(V, F):
    return V, np.vstack([F, np.stack([F[100:120, 0], F[100:120, 1], F[100:120, 1]], 1)])


def flat_caps(V, F):
    """A vertex in the middle of an edge, the face on one side split there, a cap of no area on the other."""
    i, j, k = F[130]
    middle = len(V)
    return np.vstack([V, [(V[i] + V[j]) / 2]]), np.vstack([np.delete(F, 130, axis=0), [[i, middle, k], [middle, j, k], [i, j, middle]]])


def duplicate_faces(V, F):
    return V, np.vstack([F, F])


def isolated_vertices(V, F):
    return np.vstack([V, V[:1]]), F


@pytest.mark.parametrize("spoil", [needles, zero_area, flat_caps, duplicate_faces, isolated_vertices])
def test_biharmonic_solved_with_bad_faces_and_vertices(spoil):
    V, F, rings = sheet()
    V, F = spoil(V, F)
    solver = BiharmonicSolver(V, F, rings)
    assert affine_error(V, F, rings, solver) < 1e-4  # mollified lengths are no longer quite planar
    assert solver.mollified < 1e-3 / 12


def test_biharmonic_solved_on_a_non_manifold_edge_and_two_components():
    V, F, rings = sheet()
    fin = np.vstack([V, V + [0, 0, 5], [[0.5, 0.5, 0.3]]])
    faces = np.vstack([F, F + len(V), [[84, 85, 2 * len(V)]]])  # a third face on an inner edge
    known = np.concatenate([rings, rings + len(V), [2 * len(V)]])
    t = np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(biharmonic(fin, faces, known, np.tile(t, (len(known), 1))), np.tile(t, (len(fin), 1)))
    D = biharmonic(fin, faces, known, fin[known])
    np.testing.assert_allclose(D[len(V) : 2 * len(V)], fin[len(V) : 2 * len(V)], atol=1e-10)


def test_biharmonic_solved_on_4_vertices():
    V = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    D = biharmonic(V, F, [0, 1, 2], np.eye(3))
    assert np.isfinite(D).all()
    np.testing.assert_allclose(D.sum(1), 1, atol=1e-12)  # a partition of unity


@pytest.mark.slow
def test_biharmonic_solved_on_1_000_000_vertices():
    V, F, rings = sheet(999)
    solver = BiharmonicSolver(V, F, rings)
    assert affine_error(V, F, rings, solver) < 1e-9 and solver.mollified == 0 and solver.factorisations == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_biharmonic_refuses_what_is_not_finite(value):
    V, F, rings = sheet()
    bad = V.copy()
    bad[17, 1] = value
    with pytest.raises(InputError, match=r"V\[17\] is not finite"):
        biharmonic(bad, F, rings, V[rings])
    with pytest.raises(InputError, match=r"D_known\[17\] is not finite"):
        D_known = V[rings]
        D_known[17, 2] = value
        biharmonic(V, F, rings, D_known)


def test_biharmonic_refuses_faces_of_two_vertices_only():
    with pytest.raises(InputError, match="F has no face of three"):
        biharmonic(np.eye(3), [[0, 1, 1], [2, 2, 2]], [0], np.zeros((1, 3)))
