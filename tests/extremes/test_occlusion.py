"""ambient_occlusion at the edges of what it may be given: *solved* rows give the clean answer, *refused* rows name what is
wrong. The surface: a ball beside a smaller one, 256 rays; a vertex is off by the rays that graze."""

import numpy as np
import pytest

from toile.kernels import InputError, ambient_occlusion

from . import ugly
from .test_nricp import put
from .test_untangle import ball

RAYS = 256
ONE, G = ball(0.2)
V, F = np.r_[ONE, 0.5 * ONE + [0.32, 0.01, -0.02]], np.r_[G, G + len(ONE)].astype(np.int32)
CLEAN = ambient_occlusion(V, F, RAYS)


def off(found):
    """Largest and mean error of the first vertices."""
    difference = np.abs(found[: len(V)] - CLEAN)
    return difference.max(), difference.mean()


def test_the_clean_answer_shades_what_faces_the_other_ball_and_nothing_else():
    first = CLEAN[: len(ONE)]
    assert first[ONE[:, 0] < -0.1].min() == 1 and first[ONE[:, 0].argmax()] < 0.8 and CLEAN.min() > 0.05


@pytest.mark.parametrize("scale", [1e-25, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e25])
def test_occlusion_solved_in_any_unit(scale):
    assert off(ambient_occlusion(2.0 ** np.round(np.log2(scale)) * V, F, RAYS))[0] < 0.02


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_occlusion_solved_far_from_the_origin(offset):
    assert off(ambient_occlusion(V + offset, F, RAYS))[0] < 0.02


@pytest.mark.parametrize(
    "spoil", [ugly.zero_area, ugly.all_faces_twice, ugly.isolated, ugly.copies, ugly.needles, ugly.inner_component]
)
def test_occlusion_solved_on_ugly_meshes(spoil):
    """Their vertices' normals are the clean ones."""
    found = ambient_occlusion(*spoil(V, F), RAYS)
    assert np.isfinite(found).all() and off(found)[0] < 0.02


@pytest.mark.parametrize("spoil", [ugly.caps, ugly.some_faces_twice, ugly.far_component, ugly.tenth_flipped])
def test_occlusion_solved_where_normals_lean(spoil):
    """Faces listed twice or turned weigh in the normals; another diagonal moves where rays start."""
    found = ambient_occlusion(*spoil(V, F), RAYS)
    assert np.isfinite(found).all() and off(found)[1] < 0.03


def test_occlusion_of_a_mesh_turned_inside_out_is_total():
    assert ambient_occlusion(*ugly.flipped(V, F), RAYS).max() == 0


@pytest.mark.parametrize("spoil", [ugly.both_sides, ugly.soup])
def test_vertices_whose_normals_cancel_or_that_no_face_uses_are_open(spoil):
    assert ambient_occlusion(*spoil(V, F), RAYS)[: len(V)].min() == 1


@pytest.mark.parametrize("spoil", ugly.UGLY + ugly.HOLES)
def test_occlusion_is_a_share_whatever_the_mesh(spoil):
    found = ambient_occlusion(*spoil(V, F), 16)
    assert found.min() >= 0 and found.max() <= 1


def test_occlusion_solved_on_one_triangle_and_one_ray():
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
    assert ambient_occlusion(*triangle, rays=1).tolist() == [1, 1, 1]
    assert ambient_occlusion(*triangle, rays=65536).tolist() == [1, 1, 1]


def test_occlusion_solved_on_1_000_000_vertices():
    n = 1000
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    a = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    sheet = np.concatenate([np.c_[a, a + 1, a + n + 1], np.c_[a, a + n + 1, a + n]])
    wavy = np.stack([x, y, 0.05 * np.cos(20 * x)], -1).reshape(-1, 3)
    open_ = ambient_occlusion(wavy, sheet, rays=4).reshape(n, n)
    crest, trough = (np.abs(np.cos(20 * x[0]) - c) < 1e-3 for c in (1, -1))
    assert open_[:, crest].mean() == 1 and open_[:, trough].mean() < 0.9


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_occlusion_refuses_what_is_not_finite(value):
    with pytest.raises(InputError, match=r"V\[33\] is not finite"):
        ambient_occlusion(put(V, 33, 1, value), F)
    with pytest.raises(InputError, match="reach"):
        ambient_occlusion(V, F, reach=value)
    with pytest.raises(InputError, match="relative_offset"):
        ambient_occlusion(V, F, relative_offset=value)


@pytest.mark.parametrize("index", [-1, len(V), 2**31 - 1, 2**40])
def test_occlusion_refuses_indices_out_of_range(index):
    with pytest.raises(InputError, match="F"):
        ambient_occlusion(V, put(F.astype(np.int64), 5, 1, index))


@pytest.mark.parametrize(
    "V, F", [(np.zeros((0, 3)), F), (V, np.zeros((0, 3), int)), (V[:, :2], F), (V, F[:, :2]), (V * 1e60, F)]
)
def test_occlusion_refuses_empty_and_misshapen_meshes_and_coordinates_beyond_1e50(V, F):
    with pytest.raises(InputError):
        ambient_occlusion(V, F)


@pytest.mark.parametrize("seed", [0, 1, 2**64 - 1])
def test_occlusion_solved_with_any_seed(seed):
    assert off(ambient_occlusion(V, F, RAYS, seed=seed))[0] < 0.05


@pytest.mark.parametrize("seed", [-1, 2**64, 0.5])
def test_occlusion_refuses_seeds_that_are_none(seed):
    with pytest.raises((TypeError, InputError)):
        ambient_occlusion(V, F, seed=seed)
