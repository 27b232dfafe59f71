"""Operators on meshes and curves against the definition, written out."""

import numpy as np
import pytest

from tests.support.shapes import tube
from toile import kernels
from toile.surface.operators import (
    adjacency,
    border_sides,
    distance_to_polyline,
    neighbour_mean,
    offset_to_polyline,
    sides,
    smooth_on,
    umbrella_laplacian,
)


@pytest.fixture(scope="module")
def mesh():
    V, F = tube(5, 7, 0.1, 0.3)
    return np.concatenate([V, [[9.0, 9, 9]]]), F  # the last vertex lies alone


def neighbours(F, n):
    around = [set() for _ in range(n)]
    for a, b in sides(F).tolist():
        around[a].add(b)
        around[b].add(a)
    return around


def test_umbrella_steps_go_half_way_to_the_mean_of_the_neighbours(mesh):
    V, F = mesh
    wanted = V.copy()
    for _ in range(2):
        wanted = np.array([(v + np.mean([wanted[j] for j in js], 0)) / 2 if js else v / 2 for v, js in
                           zip(wanted, neighbours(F, len(V)))])  # fmt: skip
    np.testing.assert_allclose(smooth_on(F, V, 2)[:-1], wanted[:-1], atol=1e-15)
    flat = np.arange(2.0 * len(V))
    np.testing.assert_array_equal(smooth_on(F, flat[: len(V)], 3), smooth_on(F, flat[: len(V), None], 3)[:, 0])


def test_laplacian_sums_the_differences_to_the_neighbours(mesh):
    V, F = mesh
    wanted = [sum(V[i] - V[j] for j in js) + np.zeros(3) for i, js in enumerate(neighbours(F, len(V)))]
    np.testing.assert_allclose(umbrella_laplacian(F, len(V)) @ V, wanted, atol=1e-14)


def test_mean_of_equal_values_is_that_value_and_an_edge_given_twice_counts_once(mesh):
    V, F = mesh
    mean = neighbour_mean(adjacency(np.concatenate([sides(F), sides(F)[:, ::-1]]), len(V)))
    np.testing.assert_allclose(mean @ np.ones(len(V)), np.r_[np.ones(len(V) - 1), 0], atol=1e-15)


def test_border_is_what_the_boundary_loops_pass(mesh):
    V, F = mesh
    loops = np.concatenate(kernels.boundary_loops(F))
    assert np.array_equal(np.flatnonzero(kernels.border_vertices(F, len(V))), np.sort(loops))
    ends = sides(F)[border_sides(F)]
    assert len(ends) == len(loops) and np.array_equal(np.unique(ends), np.sort(loops))
    assert not kernels.border_vertices(np.zeros((0, 3), np.int32), 4).any()


def test_only_the_base_of_a_pyramid_is_its_border():
    pyramid = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32)
    assert kernels.border_vertices(pyramid, 5).tolist() == [True] * 4 + [False]


def test_offsets_end_on_the_nearest_point_of_a_square():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    points = np.array([[0.5, -2, 0], [2, 2, 0], [-0.25, 0.75, 1], [1, 0, 0]])
    np.testing.assert_allclose(offset_to_polyline(points, square), [[0, 2, 0], [-1, -1, 0], [0.25, 0, -1], [0, 0, 0]])
    np.testing.assert_allclose(distance_to_polyline(points, square), [2, 2**0.5, (1 / 16 + 1) ** 0.5, 0])
