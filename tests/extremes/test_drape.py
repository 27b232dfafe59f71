"""drape at the edges of what it may be given: each row is solved, said or refused, and no answer holds a NaN."""

import numpy as np
import pytest

from tests.extremes import ugly
from tests.support.cloths import GRAVITY, ball, edge_lengths, sheet, solver
from toile import kernels

FRAME = 1 / 30
BODY_V, BODY_F = ball()


def fallen(V, F, body_V=BODY_V, body_F=BODY_F, seconds=0.2, dt=FRAME, **options):
    """The result when a sheet has fallen on a ball."""
    cloth = solver(V, F, body_V, body_F, **options)
    cloth.start(V, body_V, settle=0)
    for _ in range(round(seconds / dt)):
        result = cloth.step(body_V, dt)
    return result


def clean():
    return sheet(across=17, along=17, height=0.21)


CLEAN = fallen(*clean()).V


@pytest.mark.parametrize("spoil", [ugly.needles, ugly.caps, ugly.zero_area, ugly.some_faces_twice, ugly.both_sides, ugly.isolated,
                                   ugly.non_manifold, ugly.tenth_flipped, ugly.flipped])  # fmt: skip
def test_ugly_cloth_falls_as_the_clean_one_does(spoil):
    V, F = spoil(*clean())
    result = fallen(V, F)
    assert np.isfinite(result.V).all() and result.inside == 0
    error = np.linalg.norm(result.V[: len(CLEAN)] - CLEAN, axis=1)
    assert error.mean() < 0.01 and np.abs(result.strain) < 0.5  # of a fall of 0.2 m


@pytest.mark.parametrize("spoil", [ugly.soup, ugly.seam, ugly.round_holes, ugly.third_missing])
def test_cloth_in_pieces_falls_in_pieces_and_stays_outside(spoil):
    V, F = spoil(*clean())
    result = fallen(V, F)
    assert np.isfinite(result.V).all() and result.inside == 0


@pytest.mark.parametrize("spoil", [ugly.needles, ugly.zero_area, ugly.some_faces_twice, ugly.isolated, ugly.far_component,
                                   ugly.flipped])  # fmt: skip
def test_an_ugly_body_holds_the_cloth_all_the_same(spoil):
    result = fallen(*clean(), *spoil(BODY_V, BODY_F))
    assert np.linalg.norm(result.V, axis=1).min() > 0.198
    assert np.linalg.norm(result.V - CLEAN, axis=1).mean() < 0.01


@pytest.mark.parametrize("spoil", [ugly.third_missing, ugly.non_manifold, ugly.tenth_flipped])
def test_a_body_that_is_no_solid_gives_no_nan(spoil):
    assert np.isfinite(fallen(*clean(), *spoil(BODY_V, BODY_F)).V).all()


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_far_from_the_origin_cloth_falls_alike(offset):
    V, F = clean()
    away = np.array([offset, -offset, offset])
    assert np.abs(fallen(V + away, F, BODY_V + away).V - away - CLEAN).max() < 0.005


@pytest.mark.parametrize("s", [1e-9, 1e-3, 1e3, 1e9])
def test_any_unit_of_length_is_solved_alike(s):
    V, F = clean()
    units = dict(
        gravity=(0, 0, -GRAVITY * s), margin=0.002 * s, max_depth=0.05 * s, stretch=500 * s**2, bending=1e-5 * s**4
    )
    assert np.abs(fallen(V * s, F, BODY_V * s, **units).V / s - CLEAN).max() < 1e-5


@pytest.mark.parametrize("s", [1e-3, 1e3, 1e6])
def test_wrong_units_give_no_nan_and_no_vertex_inside(s):
    """Millimetres taken for metres, and the like: options stay as they are."""
    V, F = clean()
    result = fallen(V * s, F, BODY_V * s)
    assert np.isfinite(result.V).all() and result.inside == 0


@pytest.mark.parametrize("s", [1e-3, 1e3])
def test_rest_lengths_in_other_units_than_the_cloth_are_said_by_the_strain(s):
    V, F = clean()
    cloth = kernels.DrapeSolver(F, len(V), edge_lengths(V, F) * s, BODY_F, len(BODY_V))
    cloth.start(V, BODY_V, settle=0)
    result = cloth.step(BODY_V, 1e-3)
    assert np.isfinite(result.V).all()
    assert result.strain > 1 if s < 1 else result.strain < -0.5
    assert np.isfinite(cloth.step(BODY_V, 0.1).V).all()


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 0.1, 1.0])
def test_steps_of_a_millisecond_to_a_second_end_alike(dt):
    V, F = clean()
    result = fallen(V, F, seconds=1.0, dt=dt, drag=2)
    assert result.inside == 0 and np.linalg.norm(result.V, axis=1).min() > 0.2
    assert np.abs(result.V.mean(0) - fallen(V, F, seconds=1.0, drag=2).V.mean(0)).max() < 0.01


@pytest.mark.parametrize("way", [1.0, 100.0])
def test_a_body_that_leaps_within_a_frame_gives_no_nan_and_leaves_no_vertex_inside(way):
    V, F = clean()
    cloth = solver(V, F, BODY_V, BODY_F)
    cloth.start(V, BODY_V, settle=0.2)
    result = cloth.step(BODY_V + [way, 0, 0], FRAME)
    assert np.isfinite(result.V).all() and result.inside == 0


def test_cloth_that_starts_inside_is_said_and_comes_out_without_a_leap():
    V, F = ball(0.19)
    cloth = solver(*ball(0.21), BODY_V, BODY_F)
    assert cloth.start(V, BODY_V, settle=0).inside == len(V)
    for _ in range(6):
        result = cloth.step(BODY_V, FRAME)
        assert np.linalg.norm(result.V, axis=1).max() < 0.25
    assert result.inside == 0


def test_a_body_through_the_cloth_at_the_start_is_seen_in_its_pairs():
    """A rod between the vertices of a sheet: no vertex is inside, and none can tell."""
    V, F = sheet(across=5, along=5)
    rod_V = np.array([[0.03, 0.03, -1], [0.05, 0.03, -1], [0.04, 0.05, -1], [0.04, 0.04, 1]])
    rod_F = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    result = fallen(V, F, rod_V, rod_F)
    assert np.isfinite(result.V).all() and result.inside == 0
    assert len(kernels.intersecting_pairs(result.V, F, rod_V, rod_F)) > 0


def test_a_million_substeps_is_the_most_and_places_beyond_1e30_are_refused():
    V, F = clean()
    cloth = solver(V, F, BODY_V, BODY_F)
    with pytest.raises(kernels.InputError, match=r"drape: V\[0\] lies beyond 1e30"):
        cloth.start(V * 1e31, BODY_V)
    cloth.start(V, BODY_V, settle=0)
    with pytest.raises(kernels.InputError, match="drape: dt is"):
        cloth.step(BODY_V, 1e3)
