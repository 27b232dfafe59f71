"""biharmonic at the edges of what it may be given. Each row is marked beforehand by its name: *solved* rows must give the
affine field or the clean mesh's answer, *refused* rows an error that names what is wrong.

A mesh is what its faces say: a slit whose sides share places but no vertices stays a slit, and a part of it without a
known vertex is refused.
"""

import numpy as np
import pytest

from toile.kernels import BiharmonicSolver, InputError, SolveError, biharmonic

from . import ugly

AFFINE = np.array([[0.3, -0.2, 0.1], [0.05, 0.4, -0.3], [0.7, 0.2, 0.6]])


def sheet(n=12):
    """A planar square of side 1, (n+1)^2 vertices; and its border with one ring."""
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
    return np.vstack([V, [(V[i] + V[j]) / 2]]), np.vstack(
        [np.delete(F, 130, axis=0), [[i, middle, k], [middle, j, k], [i, j, middle]]]
    )


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


# --- a curved mesh, against the clean answer ----------------------------------------------------------------------------
def tube(around=24, along=20):
    a, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, 1, along))
    r = 0.3 + 0.05 * np.sin(3 * a + 4 * z)
    V = np.stack([r * np.cos(a), 0.7 * r * np.sin(a), z], -1).reshape(-1, 3)
    at = np.arange(around * along).reshape(along, around)
    right = np.roll(at, -1, 1)
    F = np.concatenate([np.stack([at[:-1], right[:-1], right[1:]], -1), np.stack([at[:-1], right[1:], at[1:]], -1)])
    known = np.r_[at[:2].ravel(), at[-2:].ravel()]
    return V, F.reshape(-1, 3), known, 0.05 * np.sin(3 * V[known] + V[known][:, [1, 2, 0]])


def error(D, clean):
    return np.abs(D[: len(clean)] - clean).max() / 0.05


@pytest.mark.parametrize("scale", [1e-30, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e30])
def test_biharmonic_solved_on_a_tube_in_any_unit(scale):
    V, F, known, D = tube()
    clean = biharmonic(V, F, known, D)
    assert error(biharmonic(scale * V, F, known, D), clean) < 1e-11
    assert error(biharmonic(V, F, known, scale * D) / scale, clean) < 1e-11


@pytest.mark.parametrize("offset, most", [(1e3, 1e-10), (1e6, 1e-7)])
def test_biharmonic_solved_on_a_tube_far_from_the_origin(offset, most):
    V, F, known, D = tube()
    assert error(biharmonic(V + offset, F, known, D), biharmonic(V, F, known, D)) < most


@pytest.mark.parametrize("spoil, most", [
    (zero_area, 1e-9), (ugly.isolated, 1e-9), (ugly.some_faces_twice, 1e-9), (ugly.all_faces_twice, 1e-9), (ugly.both_sides, 1e-9),
    (ugly.flipped, 1e-9), (ugly.tenth_flipped, 1e-9), (ugly.needles, 1e-5), (flat_caps, 1e-2), (ugly.non_manifold, 3e-2),
])  # fmt: skip
def test_biharmonic_solved_on_an_ugly_tube(spoil, most):
    V, F, known, D = tube()
    assert error(biharmonic(*spoil(V, F), known, D), biharmonic(V, F, known, D)) < most


def test_biharmonic_solved_beside_a_component_of_its_own():
    V, F, known, D = tube()
    far_V, far_F = ugly.far_component(V, F)
    x = biharmonic(far_V, far_F, np.r_[known, len(V)], np.vstack([D, [[1.0, 2, 3]]]))
    assert error(x, biharmonic(V, F, known, D)) < 1e-9
    np.testing.assert_allclose(x[len(V) :], np.tile([1.0, 2, 3], (len(V), 1)), atol=1e-9)


def test_biharmonic_solved_on_a_sheet_full_of_holes():
    V, F, rings = sheet()
    inside = ~np.isin(F, rings).any(1)
    keep = ~inside | (np.random.default_rng(0).random(len(F)) > 0.15)
    F = F[keep]
    used = np.unique(F)
    D = biharmonic(V, F, rings, np.ones((len(rings), 3)))
    np.testing.assert_array_equal(D[used], 1)


@pytest.mark.parametrize("spoil", [ugly.seam, ugly.soup, ugly.copies, ugly.far_component])
def test_biharmonic_refuses_a_part_without_a_known_vertex(spoil):
    V, F, known, D = tube()
    with pytest.raises(InputError, match="biharmonic: known has no vertex in component [0-9]+ "):
        biharmonic(*spoil(V, F), known, D)


@pytest.mark.parametrize("scale", [1e-160, 1e-100, 1e100, 1e160])
def test_biharmonic_refuses_sizes_whose_powers_leave_the_range_of_doubles(scale):
    V, F, known, D = tube()
    with pytest.raises((InputError, SolveError), match="biharmonic: "):
        biharmonic(scale * V, F, known, D)


def test_biharmonic_refuses_what_is_empty_or_out_of_range():
    V, F, known, D = tube()
    none, bad = np.empty((0, 3)), F.copy()
    bad[9, 1] = len(V)
    cases = {
        "V is empty": (none, F, known, D),
        "F is empty": (V, none.astype(int), known, D),
        "known is empty": (V, F, known[:0], none),
        rf"F\[9\] holds vertex {len(V)}": (V, bad, known, D),
        rf"known\[3\] is {len(V)}": (V, F, np.r_[known[:3], len(V)], D[:4]),
        r"known\[2\] repeats vertex 0": (V, F, np.array([0, 1, 0]), D[:3]),
        f"D_known has 3 rows, known has {len(known)}": (V, F, known, D[:3]),
        "all faces of F have their corners in one point": (0 * V, F, known, D),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match="biharmonic: " + message):
            biharmonic(*case)
