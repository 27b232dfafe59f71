"""What `inspect` says of the order in which frames follow one another."""

import numpy as np
import pytest

from tests.support.inspected import person, texts
from toile.measure.inspection.order import out_of_order


def walking(frames, noise=0.01, seed=1):
    """Keypoints (T,K,3) [m] of a person who turns and walks, each as uncertain as triangulated ones are."""
    points = np.array([person(t)[1] for t in range(frames)])
    return points + np.random.default_rng(seed).normal(0, noise, points.shape)


@pytest.mark.parametrize("frames", (12, 30, 100))
def test_frames_that_are_permuted_are_said_and_those_in_order_or_backwards_are_not(frames):
    points, order = walking(frames), np.random.default_rng(2).permutation(frames)
    assert out_of_order(points) == out_of_order(points[::-1]) == out_of_order(points[: frames // 2]) == []
    (said,) = out_of_order(points[order])
    assert "numbered in the order of time?" in said.text and not said.serious


def test_a_person_who_stands_still_or_a_motion_that_repeats_is_in_order():
    still = walking(1, 0) + np.random.default_rng(3).normal(0, 0.01, (60, 1, 1))
    assert out_of_order(still + np.random.default_rng(4).normal(0, 0.02, (60, still.shape[1], 3))) == []
    cycle = walking(25)
    assert out_of_order(np.concatenate([cycle, cycle[::-1], cycle])) == []


def test_a_step_to_a_frame_that_is_the_same_has_no_length():
    straight = np.repeat(np.arange(20) * [[0.02], [0], [0]], 2, axis=1).T[:, None]
    (said,) = out_of_order(straight[np.random.default_rng(1).permutation(40)])
    assert out_of_order(straight) == [] and "would need steps of 10;" in said.text  # 19 of 20 mm among 39


def test_unknown_keypoints_and_frames_are_left_out():
    points = walking(30)
    points[4:9] = np.nan
    points[::3, ::2] = np.nan
    assert out_of_order(points) == [] and out_of_order(np.full((30, 5, 3), np.nan)) == []
    assert len(out_of_order(points[np.random.default_rng(2).permutation(30)])) == 1


def test_inspect_says_that_the_frames_of_a_capture_are_permuted(walk):
    folders = sorted((walk / "frames").iterdir())
    for folder in folders:
        folder.rename(folder.with_name(f"_{folder.name}"))
    for folder, to in zip(folders, np.random.default_rng(2).permutation(len(folders))):
        folder.with_name(f"_{folder.name}").rename(folders[to])
    assert [text[:7] for text in texts(walk)] == ["frames:"]
