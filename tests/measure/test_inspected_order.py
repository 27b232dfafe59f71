"""What `inspect` says of the order in which frames follow one another."""

import numpy as np
import pytest

from tests.support.inspected import person, posed, recalibrated, texts
from toile.measure.inspection.order import leaps, out_of_order


def walking(frames, noise=0.01, seed=1):
    """Keypoints (T,K,3) [m] of a person who turns and walks, each as uncertain as triangulated ones are."""
    points = np.array([person(t)[1] for t in range(frames)])
    return points + np.random.default_rng(seed).normal(0, noise, points.shape)


@pytest.mark.parametrize("frames", (12, 30, 100))
def test_frames_that_are_permuted_are_said_and_those_in_order_or_backwards_are_not(frames):
    points, order = walking(frames), np.random.default_rng(3).permutation(frames)
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


def test_keypoints_of_another_person_in_few_frames_are_a_leap_and_no_other_order():
    points = walking(12)
    points[5:7] += [0.6, 0.4, 0]
    assert out_of_order(points) == []
    (said,) = leaps(points, 100, fps=30)
    assert "leap in 2 places" in said.text and "m from 104 to 105" in said.text and "m from 106 to 107" in said.text
    assert leaps(points, 100, fps=10) == [] and leaps(walking(30), 0, fps=30) == []


def test_keypoints_as_uncertain_as_they_are_leap_at_no_rate():
    still = np.repeat(walking(1, 0), 30, axis=0) + np.random.default_rng(2).normal(0, 0.02, (30, 1, 3))
    assert [leaps(still, 0, fps) for fps in (30, 240, 1000, 10_000)] == [[]] * 4
    still[12:] += [0.6, 0, 0]
    assert all(len(leaps(still, 0, fps)) == 1 for fps in (30, 1000))


def test_single_keypoints_that_are_mistaken_make_no_other_order():
    points, draw = walking(12), np.random.default_rng(5)
    mistaken = draw.random(points.shape[:2]) < 0.3
    points[mistaken] += draw.normal(0, 0.5, (mistaken.sum(), 3))
    assert out_of_order(points) == []


def test_a_frame_that_lacks_keypoints_gives_a_leap_its_time():
    points = np.repeat(np.arange(4.0)[:, None, None] * 0.2, 3, axis=2)
    points[1:3] = np.nan
    assert leaps(points[[0, 3]], 0, fps=30) and leaps(points, 0, fps=30) == []


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


def test_lengths_of_another_unit_are_said_and_make_no_leaps(walk):
    millimetres = np.array([[1, 1, 1, 1000.0]] * 3 + [[1, 1, 1, 1]])
    recalibrated(walk, posed(lambda T: T * millimetres))
    (said,) = texts(walk)
    assert said.startswith("units: ")
