"""How sure a scan is of its vertices, as weights of what pulls a template or a body to it."""

import numpy as np
import pytest

from tests.kernels.test_nricp import bend, bumpy, surface_distance
from toile.io.body import load_body_model
from toile.kernels import InputError, NricpSolver, SkeletonSolver, vertex_normals

OFF = 0.03  # m


def half_off(V, F):
    """A scan whose half x > 0 lies 30 mm off, and which vertices lie where they should."""
    good = V[:, 0] <= 0
    return np.where(good[:, None], V, V + OFF * vertex_normals(V, F)), good


@pytest.fixture(scope="module")
def problem():
    V, F = bumpy(4)
    scan_V, scan_F = bumpy(5, turn=0.4)
    true = bend(scan_V, 0.02)
    return NricpSolver(V, F), V, true, scan_F, *half_off(true, scan_F)


def test_a_half_of_no_confidence_is_as_though_it_was_not_there(problem):
    solver, V, true, F, scan, good = problem
    without = solver.solve(scan, F[good[F].all(1)])
    ignored = solver.solve(scan, F, scan_confidence=good.astype(float))
    assert np.array_equal(ignored.V, without.V) and np.array_equal(ignored.matched, without.matched)
    taken = solver.solve(scan, F).V
    far = V[:, 0] > 0.1
    assert surface_distance(ignored.V[far], true, F).mean() < 0.5 * surface_distance(taken[far], true, F).mean()


def test_full_confidence_gives_the_bits_of_none(problem):
    solver, _, _, F, scan, _ = problem
    plain, ones = solver.solve(scan, F), solver.solve(scan, F, scan_confidence=np.ones(len(scan)))
    assert (
        np.array_equal(plain.V, ones.V) and plain.energy == ones.energy and np.array_equal(plain.matched, ones.matched)
    )


def test_the_less_sure_a_half_is_the_less_it_pulls(problem):
    solver, V, true, F, scan, good = problem
    far, off = V[:, 0] > 0.1, []
    for c in (1.0, 0.03, 0.001):
        fit = solver.solve(scan, F, scan_confidence=np.where(good, 1, c))
        off.append(surface_distance(fit.V[far], scan, F).mean())
        assert fit.matched[far].max() <= c
    assert off[0] < off[1] < off[2] and off[2] > 5 * off[0]


def test_a_scan_of_no_confidence_overlaps_nothing(problem):
    solver, _, _, F, scan, _ = problem
    assert solver.solve(scan, F, scan_confidence=np.zeros(len(scan))).stop == "no_overlap"


@pytest.fixture(scope="module")
def body():
    model = load_body_model()
    rotations = np.zeros((len(model.parents), 3))
    rotations[model.joint("upperarm01.L")] = 0, 0.2, 0.1
    V = model.skin(model.v_template, model.J, rotations, np.array([0.02, 0.01, 0.0]))
    start = np.zeros_like(rotations), np.zeros(3), np.zeros(0)
    return SkeletonSolver(model, solve_shape=False, max_iterations=8), V, model.f, start


def test_a_body_is_posed_as_without_the_half_that_nobody_vouches_for(body):
    solver, V, F, start = body
    scan, good = half_off(V, F)
    without = solver.solve(scan, F[good[F].all(1)], start=start)
    ignored = solver.solve(scan, F, start=start, scan_confidence=good.astype(float))
    taken, ones = (solver.solve(scan, F, start=start, scan_confidence=c) for c in (None, np.ones(len(scan))))
    assert np.array_equal(ignored.V, without.V) and np.array_equal(taken.V, ones.V)
    doubted = solver.solve(scan, F, start=start, scan_confidence=np.where(good, 1, 0.01))
    taken_off, doubted_off = (surface_distance(fit.V[~good], scan, F).mean() for fit in (taken, doubted))
    assert taken_off < 0.95 * doubted_off


@pytest.mark.parametrize(
    "spoil, words",
    [
        (lambda c: c[1:], "scan_confidence has shape"),
        (lambda c: np.where(np.arange(len(c)) == 5, -0.1, c), r"scan_confidence\[5\] is not a number >= 0"),
        (lambda c: np.where(np.arange(len(c)) == 7, np.nan, c), r"scan_confidence\[7\] is not a number >= 0"),
        (lambda c: np.where(np.arange(len(c)) == 7, np.inf, c), r"scan_confidence\[7\] is not a number >= 0"),
    ],
)
def test_confidence_that_is_none_is_refused(problem, body, spoil, words):
    solver, _, _, F, scan, _ = problem
    with pytest.raises(InputError, match=f"nricp: {words}"):
        solver.solve(scan, F, scan_confidence=spoil(np.ones(len(scan))))
    skeleton, V, F, start = body
    with pytest.raises(InputError, match=f"skeleton: {words}"):
        skeleton.solve(V, F, start=start, scan_confidence=spoil(np.ones(len(V))))


def test_a_body_without_keypoints_needs_something_to_trust(body):
    solver, V, F, start = body
    with pytest.raises(InputError, match="neither scan_F nor keypoints"):
        solver.solve(V, F, start=start, scan_confidence=np.zeros(len(V)))
