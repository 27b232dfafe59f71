"""What inspect says of the brightness of pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toile.io.capture import open_capture
from toile.measure.inspection.exposure import exposures

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture(scope="module")
def talk():
    """Five frames of the packaged capture."""
    capture = open_capture(SAMPLE)
    return [capture.pictures(number) for number in range(5)]


def exposed(frames, stops):
    """With pictures `stops(camera, frame)` brighter; sRGB's exponent."""
    brighter = lambda image, by: np.clip(image * 2 ** (by / 2.2), 0, 255).astype(np.uint8)
    return [replace(f, images={n: brighter(i, stops(n, f.number)) for n, i in f.images.items()}) for f in frames]


def said(frames):
    return [finding.text for finding in exposures(frames)]


def test_sound_pictures_and_small_differences_are_nothing(talk):
    assert said(talk) == []
    assert said(exposed(talk, lambda name, t: -0.6 * (t == 3))) == []


def test_a_frame_in_which_the_light_is_down_is_said_once_for_all_cameras(talk):
    (one,) = said(exposed(talk, lambda name, t: -2.0 * (t == 3)))
    assert one.startswith("frame 3: its pictures are about 2.") and "darker" in one and "flicker" in one


def test_a_camera_whose_exposure_changes_is_named_with_its_frames(talk):
    (one,) = said(exposed(talk, lambda name, t: -1.8 * (name == "cam04" and t in (0, 4))))
    assert one.startswith("cam04: in frames 0, 4 about 1.") and "darker than in its others" in one


def test_who_turns_a_brighter_side_to_a_camera_changes_no_exposure(talk):
    frames = [
        replace(
            f,
            images={
                n: np.where(f.masks[n][..., None], i // (4 if f.number == 2 else 1), i) for n, i in f.images.items()
            },
        )
        for f in talk
    ]
    assert said(frames) == []


def test_before_a_black_room_the_person_tells_what_all_cameras_show_alike_and_nothing_of_one(talk):
    black = [replace(f, images={n: i * f.masks[n][..., None] for n, i in f.images.items()}) for f in talk]
    (one,) = said(exposed(black, lambda name, t: -2.0 * (t == 1)))
    assert one.startswith("frame 1: ")
    assert said(exposed(black, lambda name, t: -2.0 * (t == 1 and name == "cam04"))) == []


def test_a_camera_that_is_darker_in_all_frames_is_named_against_the_others(talk):
    (one,) = said(exposed(talk, lambda name, t: -2.0 * (name == "cam01")))
    assert one.startswith("cam01: about ") and one.endswith("darker than the other cameras")


def test_the_light_is_down_in_cameras_before_a_black_wall_and_before_a_lit_one_alike(talk):
    walled = lambda name, image, mask: image if name in ("cam00", "cam01") else image * mask[..., None]
    frames = [replace(f, images={n: walled(n, i, f.masks[n]) for n, i in f.images.items()}) for f in talk]
    assert said(frames) == []
    (one,) = said(exposed(frames, lambda name, t: -2.0 * (t == 3)))
    assert one.startswith("frame 3: its pictures are about ")
