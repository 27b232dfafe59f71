"""Slides found on a printed tube: what is known of them exactly."""

import numpy as np
import pytest

from tests.support.printed_tube import HEIGHT, RADIUS, around_and_up, dots, tube
from toile import kernels
from toile.align.settings import AlignSettings
from toile.prints.lengths import Lengths
from toile.prints.matching import Matcher
from toile.prints.sliding import SlidingSurface

SETTINGS = AlignSettings(lattice_spacing=0.006)


@pytest.fixture(scope="module")
def matcher():
    V, F = tube()
    return Matcher(SlidingSurface(V, F, kernels.boundary_loops(F), SETTINGS.lattice_spacing), V, SETTINGS)


def slide_of(matcher, picture, reference, seen=None):
    """The Matched slide of one print upon another, both functions of points."""
    points = matcher.surface.lattice.positions
    ones = np.ones(len(points))
    frame = matcher.pyramid(picture(points), ones if seen is None else seen(points))
    return matcher.match(frame, matcher.target(reference(points), ones), matcher.surface.rest)


@pytest.mark.parametrize("turn", [-0.018, 0.004, 0.018])
def test_a_turned_print_is_found_again(matcher, turn):
    matched = slide_of(matcher, lambda p: dots(p, turn), dots)
    around, up = around_and_up(matcher, matched.d)
    inside = ~matcher.surface.on_loop
    assert np.abs(around[inside] - turn).mean() < 0.05 * abs(turn) and np.abs(up[inside]).mean() < 5e-4
    assert matched.after < 0.2 * matched.before


def test_a_print_that_lies_right_stays(matcher):
    assert np.abs(slide_of(matcher, dots, dots).d).max() < 1e-9


def test_plain_cloth_stays_under_changing_light(matcher):
    plain = lambda p: np.tile([0.3, 0.1, -0.2], (len(p), 1))
    lit = lambda p: plain(p) + [0.2, 0, 0] * np.sin(p[:, :1] / RADIUS)
    assert np.abs(slide_of(matcher, lit, plain).d).max() < 1e-4
    assert np.abs(slide_of(matcher, plain, plain, lambda p: np.zeros(len(p))).d).max() < 1e-9


def test_light_and_the_cameras_colour_do_not_move_a_print(matcher):
    lit = lambda p: dots(p, 0.01) + [0.3, 0.1, -0.1] + [0.2, 0, 0] * np.sin(p[:, :1] / RADIUS)
    around, _ = around_and_up(matcher, slide_of(matcher, lit, dots).d)
    assert np.abs(around[~matcher.surface.on_loop] - 0.01).mean() < 1e-3


def test_unseen_cloth_follows_its_neighbours(matcher):
    unseen = lambda p: (np.abs(np.arctan2(p[:, 1], p[:, 0])) > 0.4).astype(float)
    around, _ = around_and_up(matcher, slide_of(matcher, lambda p: dots(p, 0.01), dots, unseen).d)
    hidden = np.abs(np.arctan2(*matcher.surface.rest[:, 1::-1].T)) < 0.3
    assert np.abs(around[hidden & ~matcher.surface.on_loop] - 0.01).max() < 2e-3


def test_a_slide_that_leaves_what_is_seen_fits_nothing(matcher):
    points, rest = matcher.surface.lattice.positions, matcher.surface.rest
    patch = (np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.25).astype(float)
    frame = matcher.pyramid(dots(points, 0.01) + 0.1 * dots(points, seed=1), patch)
    target = matcher.target(dots(points), patch)
    one, other = (np.stack(around_and_up(matcher, np.tile(d, (len(rest), 1))), 1) for d in ([1.0, 0], [0, 1.0]))
    away = np.linalg.solve(np.stack([one, other], 2), np.tile([1.6 * RADIUS, 0], (len(rest), 1))[..., None])[..., 0]
    near, far = matcher.match(frame, target, rest), matcher.match(frame, target, rest, away)
    assert far.kept < 0.5 * far.seen and far.after < near.after
    assert np.array_equal(matcher.best(frame, target, rest, [away, None]).d, near.d)


def test_a_slide_is_the_same_in_any_pose_and_numbering(matcher):
    turned = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turned *= np.sign(np.linalg.det(turned))
    order = np.random.default_rng(4).permutation(len(matcher.surface.rest))
    V, F = tube()
    F2 = np.argsort(order)[F].astype(np.int32)
    moved = V[order] @ turned.T + 3
    other = Matcher(SlidingSurface(moved, F2, kernels.boundary_loops(F2), SETTINGS.lattice_spacing), moved, SETTINGS)
    back = lambda f: lambda p: f((p - 3) @ turned)
    found = slide_of(matcher, lambda p: dots(p, 0.012), dots).d
    again = slide_of(other, back(lambda p: dots(p, 0.012)), back(dots)).d
    assert np.abs(matcher.surface.vectors(found)[order] @ turned.T - other.surface.vectors(again)).max() < 1e-6


def test_vertices_slide_on_the_surface_and_loops_on_themselves(matcher):
    surface = matcher.surface
    d = np.random.default_rng(0).normal(0, 0.01, (len(surface.rest), 2))
    face, bary = surface.slid(d)
    moved = surface.points_at(surface.rest, face, bary)
    assert surface.index.closest(moved)[3].max() < 1e-9
    for loop in surface.loops:
        assert np.ptp(moved[loop][:, 2]) < 1e-12
    assert np.abs(surface.points_at(surface.rest, *surface.slid(0 * d)) - surface.rest).max() < 1e-12


def test_slid_vertices_cut_no_corners(matcher):
    surface, d = matcher.surface, np.random.default_rng(0).normal(0, 0.01, (len(matcher.surface.rest), 2))
    places = surface.slid(d)
    sag = [
        RADIUS - np.linalg.norm(f(surface.rest, *places)[:, :2], axis=1)
        for f in (surface.points_at, surface.curved_points_at)
    ]
    for on in (surface.on_loop, ~surface.on_loop):
        assert np.abs(sag[1][on]).mean() < 0.6 * np.abs(sag[0][on]).mean()
    assert np.abs(surface.curved_points_at(surface.rest, *surface.slid(0 * d)) - surface.rest).max() < 1e-12


def test_a_slide_does_not_depend_on_threads(matcher, threads):
    found = []
    for count in (1, 2, 3, 8):
        threads(count)
        found.append(slide_of(matcher, lambda p: dots(p, 0.01), dots).d)
    assert all(np.array_equal(found[0], d) for d in found)


def test_cloth_that_slipped_returns_to_the_lengths_of_its_template(matcher):
    surface = matcher.surface
    slip = np.zeros((len(surface.rest), 2))
    up = np.einsum("gai,i->ga", surface.frames, [0, 0, 1.0])
    slip[:] = 0.012 * np.sin(2 * np.pi * surface.rest[:, 2:] / HEIGHT) * up
    slipped = surface.points_at(surface.rest, *surface.slid(slip))
    left = surface.points_at(slipped, *surface.slid(matcher.unstretched([slipped]))) - surface.rest
    error = np.abs(np.stack([slipped - surface.rest, left])[..., 2]).mean(1)
    assert error[0] > 0.006 and error[1] < 0.25 * error[0]


def test_gradients_of_the_lengths_are_their_differences(matcher):
    surface, rng = matcher.surface, np.random.default_rng(2)
    loose = Lengths(surface, surface.rest, SETTINGS.model_copy(update={"edge_outlier": 1e6}))
    posed = surface.rest * [1.2, 1.1, 0.9]
    d, step = np.zeros((len(surface.rest), 2)), 1e-6

    def energy(d):
        x = surface.points_at(posed, *surface.slid(d))
        length = np.linalg.norm(x[loose.i] - x[loose.j], axis=1)
        rest = np.linalg.norm(posed[loose.i] - posed[loose.j], axis=1)
        scale = np.median(rest / loose.lengths)  # held, as the equations do
        return (
            0.5
            * (
                loose.areas
                / (SETTINGS.strain_length * SETTINGS.edge_strain) ** 2
                * (length / (scale * loose.lengths) - 1) ** 2
            ).sum()
        )

    _, right = loose.equations(posed, surface.slid(d))
    toward = rng.normal(size=d.shape)
    toward[surface.on_loop] = 0
    slope = (energy(d + step * toward) - energy(d - step * toward)) / (2 * step)
    assert slope == pytest.approx((right * toward).sum(), rel=0.05)
