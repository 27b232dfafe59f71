"""Laws of what faces say by themselves."""

from collections import Counter

import networkx as nx
import numpy as np
import pytest

from toile import kernels

SHEET = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 6], [0, 6, 1]])  # six faces about vertex 0
CUBE = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
                 [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]])  # fmt: skip


def plain_border(F, n):
    """The definition, edge by edge."""
    faces = Counter(tuple(sorted(side)) for f in F.tolist() for side in zip(f, f[1:] + f[:1]) if side[0] != side[1])
    border = np.zeros(n, bool)
    for edge, count in faces.items():
        if count == 1:
            border[list(edge)] = True
    return border


def test_border_of_a_sheet_is_its_outline_and_a_closed_mesh_has_none():
    border = kernels.border_vertices(SHEET, 8)
    assert border.dtype == bool and border.tolist() == [False] + 6 * [True] + [False]  # vertex 7 has no face
    assert not kernels.border_vertices(CUBE, 8).any() and kernels.border_vertices(CUBE[1:], 8).sum() == 3
    assert kernels.border_vertices(np.zeros((0, 3), int), 0).shape == (0,)


def test_border_equals_the_edge_count_on_any_faces():
    rng = np.random.default_rng(0)
    for n in (3, 6, 30):  # with repeated corners, faces listed twice and edges of many faces
        for m in (1, 5, 40):
            F = rng.integers(0, n, (m, 3))
            F = np.concatenate([F, F[: m // 3]])
            assert (kernels.border_vertices(F, n) == plain_border(F, n)).all()


def test_border_does_not_know_the_faces_orientation_or_the_vertices_order():
    order = np.random.default_rng(1).permutation(7)
    flipped = SHEET.copy()
    flipped[::2] = flipped[::2, ::-1]
    assert (kernels.border_vertices(flipped, 7) == kernels.border_vertices(SHEET, 7)).all()
    assert (kernels.border_vertices(order[SHEET], 7)[order] == kernels.border_vertices(SHEET, 7)).all()


def test_border_holds_every_boundary_loop():
    loops = kernels.boundary_loops(SHEET)
    assert len(loops) == 1 and set(loops[0]) == set(np.flatnonzero(kernels.border_vertices(SHEET, 7)))


def test_border_refuses_an_index_beyond_n_and_a_negative_n():
    with pytest.raises(kernels.InputError, match=r"border_vertices: F\[4\]"):
        kernels.border_vertices(SHEET, 6)
    with pytest.raises(kernels.InputError, match="border_vertices: n is -1"):
        kernels.border_vertices(SHEET, -1)


@pytest.mark.parametrize("of_faces_alone", ["boundary_loops", "face_neighbours", "unique_edges"])
def test_faces_alone_are_refused_without_a_word_of_vertices(of_faces_alone):
    with pytest.raises(kernels.InputError, match=rf"{of_faces_alone}: F\[0\] holds vertex -1, expected 0 to \d+$"):
        getattr(kernels, of_faces_alone)([[0, -1, 2]])


def sides_of(loop):
    return list(zip(loop.tolist(), np.roll(loop, -1).tolist()))


def test_on_any_faces_boundary_loops_are_cycles_of_border_sides_and_leave_out_what_lies_on_none():
    rng = np.random.default_rng(2)
    for n, m in ((4, 3), (6, 8), (30, 25), (30, 60)):
        for F in rng.integers(0, n, (20, m, 3)):
            loops = kernels.boundary_loops(F)
            half = [(a, b) for f in F.tolist() for a, b in zip(f, f[1:] + f[:1]) if a != b]
            faces = Counter(tuple(sorted(side)) for side in half)
            border = {side for side, count in faces.items() if count == 1}
            around = [tuple(sorted(side)) for loop in loops for side in sides_of(loop)]
            assert len(set(around)) == len(around) and set(around) <= border
            left = nx.Graph(border - set(around))
            assert len(left) == 0 or nx.is_forest(left)
            assert all(len(set(loop.tolist())) == len(loop) >= 3 and loop[0] == loop.min() for loop in loops)
            assert [len(loop) for loop in loops] == sorted((len(loop) for loop in loops), reverse=True)


def grid_without(squares, n=5):
    """Faces of a square grid of n x n vertices without those squares."""
    i = np.arange(n * n).reshape(n, n)
    corners = [i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]]
    kept = np.ones((n - 1, n - 1), bool)
    kept[tuple(np.transpose(squares))] = False
    a, b, c, d = (corner[kept] for corner in corners)
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


@pytest.mark.parametrize(
    "squares, lengths",
    [([(1, 1), (2, 2)], [16, 4, 4]), ([(1, 2), (2, 1)], [16, 4, 4]), ([(0, 1), (1, 2), (2, 1), (3, 2)], [20, 4, 4])],
)
def test_boundary_loops_that_touch_are_loops_each_however_vertices_are_numbered(squares, lengths):
    F = grid_without(squares)
    loops = kernels.boundary_loops(F)
    cycles = {frozenset(sides_of(loop)) for loop in loops}
    for seed in range(20):
        number = np.random.default_rng(seed).permutation(25)
        found = kernels.boundary_loops(number[F])
        assert all(loop[0] == loop.min() and len(set(loop.tolist())) == len(loop) for loop in found)
        assert {frozenset(sides_of(np.argsort(number)[loop])) for loop in found} == cycles
    assert [len(loop) for loop in loops][-len(lengths) :] == lengths


def test_faces_that_run_the_other_way_cut_no_boundary_loop():
    for turned in range(1, 2 ** len(SHEET)):
        F = [f[::-1] if turned >> k & 1 else f for k, f in enumerate(SHEET)]
        (loop,) = kernels.boundary_loops(F)
        assert {frozenset(side) for side in sides_of(loop)} == {frozenset((k, k % 6 + 1)) for k in range(1, 7)}


def test_a_fin_on_a_closed_surface_has_no_boundary_loop():
    assert kernels.boundary_loops(np.concatenate([CUBE, [[0, 2, 8]]])) == []
