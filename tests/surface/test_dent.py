"""Skin gives way to cloth that has no room."""

import numpy as np

from tests.support.kernel_calls import ball
from toile import kernels
from toile.surface.dent import MOST, SLOPE, STEP, dented


def sheet(height, n=21, half=0.2):
    """A flat cloth at z = `height` [m]: vertices (n*n,3) and faces."""
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-half, half, n)] * 2, indexing="ij"))
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    return np.stack([x, y, np.full(n * n, height)], 1), np.r_[np.c_[a, b, c], np.c_[a, c, d]].astype(np.int32)


def limb():
    V, F = ball(subdivisions=4)
    return 0.05 * V / np.linalg.norm(V, axis=1, keepdims=True), F


def test_skin_goes_back_until_it_meets_no_cloth_and_hardly_farther():
    V, F = limb()
    for poke in (0.0011, 0.004):
        skin = dented(V, F, [sheet(0.05 - poke)])
        assert len(kernels.intersecting_pairs(skin, F, *sheet(0.05 - poke))) == 0
        assert poke <= np.linalg.norm(skin - V, axis=1).max() <= 1.1 * poke + 4 * STEP


def test_a_dent_lies_along_the_normals_rises_by_its_slope_and_ends_near_the_cloth():
    V, F = limb()
    depth = -np.einsum("ni,ni->n", dented(V, F, [sheet(0.047)]) - V, kernels.vertex_normals(V, F))
    i, j = kernels.unique_edges(F).T
    assert (np.abs(depth[i] - depth[j]) <= SLOPE * np.linalg.norm(V[i] - V[j], axis=1) + 1e-12).all()
    assert depth.min() == 0 and (depth[V[:, 2] < 0.02] == 0).all()


def test_skin_that_meets_none_stays_and_what_is_deep_is_no_matter_of_room():
    V, F = limb()
    assert np.array_equal(dented(V, F, [sheet(0.06)]), V)
    assert dented(V, F, [sheet(0.05 - 1.5 * MOST)]) is None and dented(V, F, [sheet(0.0), sheet(0.06)]) is None


def test_a_skin_turned_inside_out_gives_way_alike():
    V, F = limb()
    assert np.abs(dented(V, F[:, ::-1], [sheet(0.047)]) - dented(V, F, [sheet(0.047)])).max() < 1e-12


def test_the_order_of_cloths_does_not_matter():
    V, F = limb()
    cloths = [sheet(0.048), sheet(-0.047)]
    assert np.array_equal(dented(V, F, cloths), dented(V, F, cloths[::-1]))
