"""Laws of what faces say by themselves."""

from collections import Counter

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


def test_boundary_loops_hold_every_border_half_edge_once_on_any_faces():
    rng = np.random.default_rng(2)
    for n, m in ((4, 3), (6, 8), (30, 25), (30, 60)):
        F = rng.integers(0, n, (m, 3))
        loops = kernels.boundary_loops(F)
        half = [(a, b) for f in F.tolist() for a, b in zip(f, f[1:] + f[:1]) if a != b]
        faces = Counter(tuple(sorted(side)) for side in half)
        expected = Counter(side for side in half if faces[tuple(sorted(side))] == 1)
        around = Counter(pair for loop in loops for pair in zip(loop.tolist(), loop.tolist()[1:]))
        closing = Counter((int(loop[-1]), int(loop[0])) for loop in loops)  # of an open chain there is no such side
        assert not around - expected and not expected - around - closing
        assert [len(loop) for loop in loops] == sorted((len(loop) for loop in loops), reverse=True)
