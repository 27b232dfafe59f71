"""Following a sequence: a fast limb is not lost, a lost one is found again, nothing drifts."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.support.shapes import sphere
from toile import kernels
from toile.kernels import NricpTracker


def limbs(rings, sectors):
    """A closed pipe 1 m long that bends in its middle by an angle [rad]: (place of the vertices at an angle, faces)."""
    V, F = sphere(rings, sectors, 0.5)
    V = V * [0.16, 0.24, 1.0]
    V[:, 0] += 0.02 * np.sin(9 * V[:, 2])

    def bent(angle):
        share = np.clip((V[:, 2] + 0.05) / 0.1, 0, 1) * angle
        c, s = np.cos(share), np.sin(share)
        return np.stack([c * V[:, 0] + s * V[:, 2], V[:, 1], c * V[:, 2] - s * V[:, 0]], 1)

    return bent, F


BENT, F = limbs(36, 24)
SCAN, SCAN_F = limbs(50, 41)


def scan(angle):
    """Another tessellation, its vertices in another order."""
    order = np.random.default_rng(3).permutation(len(SCAN(0)))
    return SCAN(angle)[order], np.argsort(order)[SCAN_F].astype(np.int32)


def errors(fit, angles):
    """Mean distance [m] of the vertices to their true places, an angle."""
    return [np.linalg.norm(fit(*scan(a)).V - BENT(a), axis=1).mean() for a in angles]


FAST = np.radians([0, 10, 40, 75, 105, 120, 110, 80, 45, 10, 0])


def test_a_fast_limb_that_a_warm_start_loses_is_followed():
    solver, last = kernels.NricpSolver(BENT(0), F, large_motion=False), [BENT(0)]

    def warm(*target):
        result = solver.solve(*target, start=last[0])
        last[0] = result.V
        return result

    assert max(errors(warm, FAST)) > 0.05
    found = errors(NricpTracker(BENT(0), F).next, FAST)
    assert max(found) < 0.025 and found[-1] < 0.004


def test_a_still_sequence_does_not_drift():
    tracker = NricpTracker(BENT(0), F)
    found = errors(tracker.next, [0.6] * 8)
    assert found[-1] < 1.1 * found[0] + 1e-4 and found[-1] < 0.006


def test_no_overlap_leaves_the_state_as_it_was():
    tracker, undisturbed = NricpTracker(BENT(0), F), NricpTracker(BENT(0), F)
    for one in (tracker, undisturbed):
        one.next(*scan(0.3))
    far, faces = scan(0.3)
    assert tracker.next(far + [50.0, 0, 0], faces).stop == "no_overlap"
    np.testing.assert_array_equal(tracker.next(*scan(0.5)).V, undisturbed.next(*scan(0.5)).V)


def test_after_reset_and_after_pickling_a_sequence_gives_the_same_bits():
    tracker = NricpTracker(BENT(0), F, preset="draft")
    first = [tracker.next(*scan(a)).V for a in (0.2, 0.5)]
    tracker.reset()
    for one in (tracker, pickle.loads(pickle.dumps(tracker))):
        np.testing.assert_array_equal([one.next(*scan(a)).V for a in (0.2, 0.5)], first)


def test_options_that_are_the_tracker_s_own_are_refused():
    with pytest.raises(TypeError, match="rebase is the tracker's own"):
        NricpTracker(BENT(0), F, rebase=True)


def test_a_scan_is_refused_while_another_thread_fits_one_and_leaves_no_trace():
    tracker, alone = NricpTracker(BENT(0), F, preset="draft"), NricpTracker(BENT(0), F, preset="draft")
    first, second = scan(0.3), scan(0.5)
    with ThreadPoolExecutor(1) as pool:
        fitting = pool.submit(tracker.next, *first)
        while not tracker._turn.locked() and not fitting.done():
            pass
        with pytest.raises(kernels.InputError, match="nricp: another thread is at work on this object"):
            tracker.next(*second)
        np.testing.assert_array_equal(fitting.result().V, alone.next(*first).V)
    np.testing.assert_array_equal(tracker.next(*second).V, alone.next(*second).V)
