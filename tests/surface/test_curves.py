"""Isolines, and loops that find their openings."""

import numpy as np
import pytest

from tests.support.shapes import sphere
from toile.config import LoopSettings
from toile.surface.curves import Curve, isolines, resample, tangents
from toile.surface.loops import match_loops


def test_isoline_of_height_on_sphere_is_a_circle_with_high_side_left():
    V, F = sphere()
    curves = isolines(V, F, V[:, 2], 0.3)
    assert len(curves) == 1 and curves[0].closed
    r = np.sqrt(1 - 0.09)
    assert curves[0].length == pytest.approx(2 * np.pi * r, rel=2e-3)
    np.testing.assert_allclose(curves[0].points[:, 2], 0.3, atol=1e-12)
    p = curves[0].points
    left = np.cross(p / np.linalg.norm(p, axis=1, keepdims=True), tangents(curves[0]))
    assert (left[:, 2] > 0.8).all()


def test_isolines_do_not_depend_on_order_of_faces():
    V, F = sphere(20, 30)
    shuffled = F[np.random.default_rng(0).permutation(len(F))]
    lengths = [sum(c.length for c in isolines(V, f, V[:, 0] * V[:, 1], 0.1)) for f in (F, shuffled)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)


def test_isoline_ends_where_the_surface_ends():
    V, F = sphere()
    cut = F[V[F].mean(1)[:, 0] < 0.5]
    (curve,) = isolines(V, cut, V[:, 2], 0.01)
    assert not curve.closed
    assert curve.length == pytest.approx(2 * np.pi * (120 / 180), rel=0.05)  # all but the 120 degrees with x > 0.5


def test_no_isoline_where_nothing_crosses():
    V, F = sphere(8, 8)
    assert isolines(V, F, np.ones(len(V))) == []


def circle(radius, z, count=90, arc=2 * np.pi):
    a = np.linspace(0, arc, count, endpoint=arc < 2 * np.pi - 1e-9)
    return np.stack([radius * np.cos(a), radius * np.sin(a), z + 0 * a], 1)


def test_loop_finds_its_opening_and_leaves_the_opposite_one():
    own = Curve(circle(0.21, 0.03, 400), True)
    strange = Curve(circle(0.205, 0.01, 400)[::-1], True)  # the other way round: garment on its other side
    (match,), _ = match_loops([circle(0.2, 0.0)], [own, strange], LoopSettings())
    np.testing.assert_allclose(match.target, circle(0.21, 0.03), atol=1e-3)
    assert match.observed.all()


def test_gap_in_opening_is_bridged_and_reported():
    opening = circle(0.21, 0.02, 300, arc=2 * np.pi * 0.75)
    (match,), _ = match_loops([circle(0.2, 0.0)], [Curve(opening, False)], LoopSettings())
    assert 0.7 < match.observed.mean() < 0.85
    assert np.abs(np.hypot(*match.target[:, :2].T) - 0.21).max() < 0.006
    assert np.abs(match.target[:, 2] - 0.02).max() < 0.006


def test_missing_opening_leaves_loop_unobserved_in_place():
    low, high = circle(0.2, 0.0), circle(0.2, 0.5)
    (a, b), _ = match_loops([low, high], [Curve(circle(0.2, 0.51, 300), True)], LoopSettings())
    assert not a.observed.any() and np.array_equal(a.target, low)
    assert b.observed.all()


def test_resampling_keeps_length_and_spacing():
    curve = resample(Curve(circle(1.0, 0.0, 1000), True), 0.01)
    assert curve.length == pytest.approx(2 * np.pi, rel=1e-4)
    step = np.linalg.norm(np.diff(curve.points, axis=0), axis=1)
    assert step.max() / step.min() < 1.01
