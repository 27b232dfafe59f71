"""Laws of `biharmonic`: libigl's answer, exact translations and affine fields, one factorisation, honest refusals."""

import numpy as np
import pytest

from toile.kernels import BiharmonicSolver, InputError, biharmonic, cotangent_laplacian, voronoi_mass

AFFINE = np.array([[0.3, -0.2, 0.1], [0.05, 0.4, -0.3], [0.7, 0.2, 0.6]])


def sheet(n=12, seed=0, jitter=0.25):
    """A planar square of (n+1)^2 vertices, side 1, irregular inside; and the vertices of its border and of its one-ring."""
    x, y = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    depth = np.minimum.reduce([x, y, n - x, n - y]).ravel()
    rng = np.random.default_rng(seed)
    move = rng.uniform(-jitter, jitter, (2, n + 1, n + 1)) * (depth.reshape(x.shape) > 0)
    V = np.stack([x + move[0], y + move[1], 0 * x], -1).reshape(-1, 3) / n
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    F = np.concatenate([np.c_[a, a + 1, a + n + 2], np.c_[a, a + n + 2, a + n + 1]])
    return V, F, np.flatnonzero(depth == 0), np.flatnonzero(depth <= 1)


def dome(n=12):
    V, F, border, rings = sheet(n)
    V[:, 2] = 0.5 * np.sin(2 * V[:, 0]) * np.cos(1.5 * V[:, 1])
    return V, F, border, rings


def test_biharmonic_equals_libigl_on_max(shared_data):
    data = np.load(shared_data / "libigl_biharmonic" / "biharmonic_max_reference.npz")
    solver = BiharmonicSolver(data["V"], data["F"], data["b"])
    D = solver.solve(data["bc_disp"])
    assert np.abs(D - data["disp"]).max() <= 1e-8 * np.abs(data["disp"]).max()
    assert solver.mollified == 0 and solver.factorisations == 1


def test_biharmonic_equals_dense_minimiser():
    V, F, border, _ = dome(8)
    rng = np.random.default_rng(1)
    known, D_known = rng.permutation(border), rng.normal(size=(len(border), 3))
    L = cotangent_laplacian(V, F).toarray()
    Q = L @ np.diag(1 / voronoi_mass(V, F)) @ L
    free = np.setdiff1d(np.arange(len(V)), known)
    expected = np.zeros((len(V), 3))
    expected[known] = D_known
    expected[free] = np.linalg.solve(Q[np.ix_(free, free)], -Q[np.ix_(free, known)] @ D_known)
    np.testing.assert_allclose(biharmonic(V, F, known, D_known), expected, atol=1e-9)


def test_biharmonic_reproduces_translations_exactly():
    V, F, border, _ = dome()
    t = np.array([0.1, -1e6 / 3, 1e-9])
    np.testing.assert_array_equal(biharmonic(V, F, border, np.tile(t, (len(border), 1))), np.tile(t, (len(V), 1)))


def test_biharmonic_reproduces_affine_fields_on_planar_meshes_with_two_rings_fixed():
    V, F, _, rings = sheet()
    field = V @ AFFINE.T + [1, 2, 3]
    np.testing.assert_allclose(biharmonic(V, F, rings, field[rings]), field, atol=1e-12)


def test_biharmonic_turns_and_scales_with_the_mesh():
    V, F, border, _ = dome()
    D_known = np.random.default_rng(2).normal(size=(len(border), 3))
    D = biharmonic(V, F, border, D_known)
    R = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    for scale in (1e-6, 1.0, 1e3):
        turned = biharmonic(scale * V @ R.T + scale * np.array([5, -7, 9]), F, border, D_known @ R.T)
        np.testing.assert_allclose(turned, D @ R.T, atol=1e-8)


def test_biharmonic_does_not_depend_on_the_order_of_known():
    V, F, border, _ = dome()
    D_known = np.random.default_rng(4).normal(size=(len(border), 3))
    order = np.random.default_rng(5).permutation(len(border))
    np.testing.assert_allclose(
        biharmonic(V, F, border[order], D_known[order]), biharmonic(V, F, border, D_known), atol=1e-11
    )


def test_biharmonic_factors_once_for_any_number_of_solves():
    V, F, border, _ = dome()
    solver = BiharmonicSolver(V, F, border)
    for seed in range(5):
        D_known = np.random.default_rng(seed).normal(size=(len(border), 3))
        D = solver.solve(D_known)
        np.testing.assert_array_equal(D[border], D_known)
    assert solver.factorisations == 1


def test_biharmonic_unrefined_solves_are_as_accurate_as_promised():
    V, F, border, _ = dome(40)
    D_known = np.random.default_rng(6).normal(size=(len(border), 3))
    D = biharmonic(V, F, border, D_known)  # a trial shows one substitution to suffice
    refined = biharmonic(V, F, border, D_known, accuracy=1e-13)
    assert 0 < np.abs(D - refined).max() <= 1e-9 * np.abs(refined).max()


def test_biharmonic_without_refinement_mollifies_needles_or_refuses_them():
    V, F, rings = pinched(1e-3)
    field = V @ AFFINE.T
    solver = BiharmonicSolver(V, F, rings, refinements=0)
    assert solver.factor_error <= 1e-8
    assert np.abs(solver.solve(field[rings]) - field).max() < 1e-4  # 4e-5 on one processor, below 1e-5 on another


def test_biharmonic_keeps_its_own_copy_of_the_mesh():
    V, F, border, _ = dome()
    solver = BiharmonicSolver(V, F, border)
    before = solver.solve(V[border])
    V[:], F[:] = np.nan, -1
    np.testing.assert_array_equal(solver.solve(before[border]), before)


def pinched(amount):
    """A planar sheet with some inner edges shrunk to `amount` of their length: needles, none of them flipped."""
    V, F, border, rings = sheet(16, jitter=0)
    inner = np.setdiff1d(np.arange(len(V)), rings)
    for v in inner[(inner % 5 == 0) & ~np.isin(inner + 1, rings)]:
        V[v + 1] = V[v] + amount * (V[v + 1] - V[v])
    return V, F, rings


@pytest.mark.parametrize("amount", [1e-3, 1e-6, 1e-9, 0])
def test_biharmonic_survives_needles(amount):
    V, F, rings = pinched(amount)
    field = V @ AFFINE.T
    solver = BiharmonicSolver(V, F, rings)
    assert solver.factor_error <= 1e-8
    assert np.abs(solver.solve(field[rings]) - field).max() < 1e-7
    assert (solver.mollified > 0) == (amount < 1e-7)


def sliver_tube(amount, around=14, rings=12):
    """A dented tube with two open loops, in which nine inner edges are shrunk to `amount` of their length."""
    angle, z = np.meshgrid(2 * np.pi * np.arange(around) / around, np.linspace(0, 0.6, rings))
    r = 0.2 + 0.03 * np.sin(2 * angle + 5 * z)
    V = np.stack([r * np.cos(angle), 0.7 * r * np.sin(angle), z], -1).reshape(-1, 3)
    i = np.arange(rings * around).reshape(rings, around)
    a, b, c, d = (k.ravel() for k in (i[:-1], np.roll(i, -1, 1)[:-1], i[1:], np.roll(i, -1, 1)[1:]))
    for k in range(9):
        p, q = i[2 + 3 * (k // 3), 4 * (k % 3)], i[2 + 3 * (k // 3), 4 * (k % 3) + 1]
        V[q] = V[p] + amount * (V[q] - V[p])
    return V, np.r_[np.c_[a, b, d], np.c_[a, d, c]], np.r_[i[0], i[-1]]


def minimiser_in_80_bits(V, F, known, D_known):
    """The dense minimiser with 64-bit mantissas: cotangents, mixed Voronoi areas, elimination with pivots."""
    V, n = V.astype(np.longdouble), len(V)
    L, mass = np.zeros((n, n), np.longdouble), np.zeros(n, np.longdouble)
    for f in F:
        side = V[np.roll(f, -2)] - V[np.roll(f, -1)]  # opposite each corner
        area = np.sqrt((np.cross(side[0], side[1]) ** 2).sum()) / 2
        length = (side**2).sum(1)
        cot = (length.sum() - 2 * length) / (4 * area)
        for c in range(3):
            j, k = f[(c + 1) % 3], f[(c + 2) % 3]
            L[[j, k], [k, j]] += cot[c] / 2
            L[[j, k], [j, k]] -= cot[c] / 2
        if cot.min() < 0:
            mass[f] += area * np.where(cot < 0, 0.5, 0.25)
        else:
            mass[f] += np.roll(length * cot, -1) / 8 + np.roll(length * cot, -2) / 8
    Q = L @ (L / mass[:, None])
    free = np.setdiff1d(np.arange(n), known)
    A = np.concatenate([Q[np.ix_(free, free)], -Q[np.ix_(free, known)] @ D_known.astype(np.longdouble)], axis=1)
    for k in range(len(free)):
        p = k + np.abs(A[k:, k]).argmax()
        A[[k, p]] = A[[p, k]]
        A[k] /= A[k, k]
        others = np.arange(len(free)) != k
        A[others] -= A[others, k][:, None] * A[k]
    D = np.zeros((n, 3))
    D[known], D[free] = D_known, A[:, len(free) :]
    return D


@pytest.mark.parametrize("amount", [1, 1e-3, 1e-6])
def test_biharmonic_on_a_curved_tube_with_slivers_is_accurate_to_1e_minus_6(amount):
    V, F, known = sliver_tube(amount)
    D_known = 0.05 * np.random.default_rng(7).normal(size=(len(known), 3))
    expected = minimiser_in_80_bits(V, F, known, D_known)
    assert np.abs(biharmonic(V, F, known, D_known) - expected).max() <= 1e-6 * np.abs(expected).max()


def test_biharmonic_mollifies_only_where_the_factor_fails_and_says_so():
    V, F, border, _ = dome()
    assert BiharmonicSolver(V, F, border).mollified == 0
    V[F[40]] = V[F[40, 0]]  # one face shrunk to a point
    solver = BiharmonicSolver(V, F, border)
    assert 0 < solver.mollified < 0.01 and solver.factorisations >= 1
    np.testing.assert_array_equal(solver.solve(np.ones((len(border), 3))), np.ones((len(V), 3)))


def test_biharmonic_leaves_unreferenced_vertices_at_zero_and_drops_faces_of_two_vertices():
    V, F, border, _ = dome()
    D = biharmonic(V, F, border, V[border])
    more = biharmonic(np.r_[V, [[9.0, 9, 9]]], np.r_[F, [[3, 3, 4]]], border, V[border])
    np.testing.assert_array_equal(more, np.r_[D, np.zeros((1, 3))])


def test_biharmonic_with_every_vertex_known_returns_them():
    V, F, _, _ = dome()
    np.testing.assert_array_equal(biharmonic(V, F, np.arange(len(V))[::-1], V[::-1]), V)


def test_biharmonic_components_do_not_feel_each_other():
    V, F, border, _ = dome()
    V2, F2, border2 = np.r_[V, V + 3], np.r_[F, F + len(V)], np.r_[border, border + len(V)]
    both = biharmonic(V2, F2, border2, np.r_[V[border], 0 * V[border]])
    np.testing.assert_allclose(both[: len(V)], biharmonic(V, F, border, V[border]), atol=1e-11)
    np.testing.assert_allclose(both[len(V) :], 0, atol=1e-11)


def test_biharmonic_bits_do_not_depend_on_threads(threads):
    V, F, border, _ = dome(30)
    results = []
    for n in (1, 2, 3, 8):
        threads(n)
        results.append(biharmonic(V, F, border, V[border]).tobytes())
    assert all(r == results[0] for r in results)


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(known=[]), "known is empty|known has dtype"),
        (dict(known=[0, 5, 0]), r"known\[2\] repeats vertex 0 of known\[0\]"),
        (dict(known=[0, 5, 400]), r"known\[2\] is 400"),
        (dict(known=[0, -1, 3]), r"known\[1\] is -1"),
        (dict(D_known=np.zeros((2, 3))), "D_known has 2 rows, known has 3"),
        (dict(D_known=np.zeros((3, 2))), r"D_known has shape \(3, 2\)"),
        (dict(D_known=np.array([[0, 0, 0], [0, 0, np.inf], [0, 0, 0.0]])), r"D_known\[1\] is not finite"),
        (dict(V=np.zeros((0, 3))), "V is empty"),
        (dict(F=np.zeros((0, 3), int)), "F is empty"),
        (dict(F=[[0, 1, 999]]), r"F\[0\] holds vertex 999"),
        (dict(V=np.zeros((169, 3))), "one point"),
        (dict(accuracy=0.0), "accuracy"),
    ],
)
def test_biharmonic_refuses_bad_input_by_name(change, message):
    V, F, border, _ = dome()
    arguments = dict(V=V, F=F, known=[0, 5, 3], D_known=np.zeros((3, 3))) | change
    with pytest.raises(InputError, match=message):
        biharmonic(**arguments)


def test_biharmonic_refuses_a_component_without_a_known_vertex():
    V, F, border, _ = dome()
    with pytest.raises(InputError, match=r"known has no vertex in component 1 \(169 vertices"):
        biharmonic(np.r_[V, V + 3], np.r_[F, F + len(V)], border, V[border])


def test_biharmonic_unknown_option_is_a_type_error():
    V, F, border, _ = dome()
    with pytest.raises(TypeError, match="degree"):
        biharmonic(V, F, border, V[border], degree=3)
