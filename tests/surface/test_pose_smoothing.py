"""Poses smoothed over time: what moves evenly stays, by the dense solution, and at nearly the strength that truth would choose."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.surface.pose_smoothing import (
    STRENGTHS,
    foretelling_errors,
    foretelling_strength,
    smooth_poses,
    turn_differences,
)


def still(T, K=2):
    return np.zeros((T, K, 3)), np.zeros((T, 3))


def test_an_even_acceleration_passes_unchanged():
    t = np.arange(20.0)
    turns, moves = still(20)
    moves[:, 0], turns[:, 1, 2] = 0.01 * t**2, 0.002 * t**2  # a joint that turns about one axis
    smoothed = smooth_poses(turns, moves, np.ones(20), 100.0)
    assert np.allclose(smoothed[0], turns, atol=1e-12) and np.allclose(smoothed[1], moves, atol=1e-12)


def test_places_move_by_the_dense_solution():
    rng = np.random.default_rng(0)
    T, strength, weight = 15, 7.0, rng.uniform(0.1, 1, 15)
    turns, moves = still(T)
    moves[:] = 0.01 * rng.standard_normal((T, 3))
    D = np.diff(np.eye(T), 3, axis=0)
    expected = np.linalg.solve(np.diag(weight) + strength * D.T @ D, weight[:, None] * moves)
    assert np.allclose(smooth_poses(turns, moves, weight, strength)[1], expected, atol=1e-12)


def test_turns_about_one_axis_are_smoothed_as_places_are():
    rng = np.random.default_rng(1)
    angles, weight = 0.1 * rng.standard_normal((12, 3)), np.ones(12)
    turns, moves = still(12)
    turns[:, 1] = angles[:, [0]] * [0.6, 0, 0.8]
    smoothed = smooth_poses(turns, angles, weight, 2.0)
    assert np.allclose(smoothed[0][:, 1], smoothed[1][:, [0]] * [0.6, 0, 0.8], atol=1e-12)


def test_a_turned_world_is_smoothed_alike():
    rng = np.random.default_rng(2)
    turns, moves = 0.3 * rng.standard_normal((2, 14, 3))
    R = Rotation.from_rotvec([0.4, -1.0, 0.2])
    turned = (R * Rotation.from_rotvec(turns)).as_rotvec()
    one = smooth_poses(turns[:, None], moves, np.ones(14), 3.0)
    other = smooth_poses(turned[:, None], R.apply(moves), np.ones(14), 3.0)
    assert np.allclose(
        (R * Rotation.from_rotvec(one[0][:, 0])).as_matrix(), Rotation.from_rotvec(other[0][:, 0]).as_matrix()
    )
    assert np.allclose(R.apply(one[1]), other[1])


def test_few_frames_and_no_strength_leave_poses_as_they_are():
    turns, moves = np.random.default_rng(3).standard_normal((2, 9, 3))
    for frames, strength in ((3, 5.0), (9, 0.0)):
        found = smooth_poses(turns[:frames, None], moves[:frames], np.ones(frames), strength)
        assert np.array_equal(found[0], turns[:frames, None]) and np.array_equal(found[1], moves[:frames])
    assert turn_differences(np.zeros((2, 1, 3))).shape == (0, 1, 3)
    assert (
        not foretelling_errors(moves[:8, None], np.ones(8))[0].any()
        and foretelling_errors(moves[:, None], np.ones(9))[0].all()
    )


@pytest.mark.parametrize("noise", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("between", [1.0, 0.1])
def test_what_foretells_places_left_out_is_nearly_what_truth_would_choose(noise, between):
    """Places whose third differences are white, and noise; of `between` weight, and as noisy as that tells, five frames of six."""
    rng, T, K = np.random.default_rng(4), 200, 10
    weight = np.where(np.arange(T) % 6 == 0, 1.0, between)
    true = np.cumsum(np.cumsum(np.cumsum(rng.standard_normal((T, 3 * K)), 0), 0), 0)
    found = true + noise / np.sqrt(weight)[:, None] * rng.standard_normal(true.shape)
    strength = foretelling_strength(*foretelling_errors(1e-4 * found.reshape(T, K, 3), weight))
    turns = np.zeros((T, 1, 3))

    def error(strength):
        parts = [smooth_poses(turns, found[:, k : k + 3], weight, strength)[1] for k in range(0, 3 * K, 3)]
        return np.sqrt(np.mean((np.concatenate(parts, 1) - true) ** 2))

    assert error(strength) < 1.05 * min(map(error, STRENGTHS))
    assert error(strength) < 0.95 * noise / np.sqrt(weight.mean())


@pytest.mark.parametrize("period", [2.7, 3.3, 4.3, 5.3])
def test_frames_too_far_apart_to_foretell_one_another_stay_as_they_are(period):
    """Swings of few frames, which their mean would foretell best or nearly so."""
    swings = 0.2 * np.sin(2 * np.pi * np.arange(60)[:, None, None] / period + np.arange(3.0))
    assert foretelling_strength(*foretelling_errors(swings, np.ones(60))) == 0
    assert foretelling_strength(*foretelling_errors(0.01 * swings, np.ones(60))) > 0 or period > 4


def test_of_errors_that_rise_and_fall_again_the_first_least_counts():
    missed = 1e-4 * np.r_[5.0, 4.0, 4.1, 3.0, 4.0, 5.0, np.zeros(len(STRENGTHS) - 6)]
    assert foretelling_strength(missed, 1.0) == STRENGTHS[3]
    assert foretelling_strength(missed, 0.1) == foretelling_strength(0 * missed, 0.0) == 0
