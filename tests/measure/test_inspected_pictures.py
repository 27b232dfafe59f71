"""Pictures exchanged between cameras: what `inspect` tells by outlines of masks and labels."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from toile.io.capture import open_capture
from toile.measure.inspection.colours import blue_faces
from toile.measure.inspection.outlines import exchanged
from toile.scene import Frame

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture(scope="module")
def talk():
    """Two frames of the packaged capture."""
    capture = open_capture(SAMPLE)
    return [capture.pictures(number) for number in (0, 5)]


@pytest.mark.parametrize("kind", ["masks", "labels"])
def test_whatever_pictures_are_exchanged_all_of_them_are_named_and_no_others(talk, kind):
    for order in ("0 1 2 3 4 5 6 7", "1 0 2 3 4 5 6 7", "0 1 5 2 4 3 6 7", "1 2 3 4 5 6 7 0", "0 1 2 3 4 5 6 0"):
        of = {f"cam0{i}": f"cam0{k}" for i, k in enumerate(order.split())}
        frames = [replace(frame, images={name: frame.images[of[name]] for name in of}) for frame in talk]
        said = exchanged([replace(frame, masks={}) for frame in frames] if kind == "labels" else frames)
        told = {text.split(":")[0]: text.split("outlines of ")[1][:5] for text in (finding.text for finding in said)}
        assert told == {name: other for name, other in of.items() if name != other}


TURNED = {
    "turned by half a turn": lambda image: image[::-1, ::-1],
    "turned to the left": lambda image: np.rot90(image),
    "turned to the right": lambda image: np.rot90(image, -1),
}


@pytest.mark.parametrize("how", TURNED)
def test_pictures_that_are_turned_against_their_masks_are_named_with_how_in_one_camera_and_in_all(talk, how):
    for cameras in (["cam02"], sorted(talk[0].images)):
        back = TURNED[how]
        frames = [replace(f, images=f.images | {n: back(f.images[n]).copy() for n in cameras}) for f in talk]
        told = {finding.text.split(":")[0]: finding.text for finding in exchanged(frames)}
        assert sorted(told) == cameras and all(f"outlines of its masks {how}" in text for text in told.values())


def test_a_picture_that_is_not_square_cannot_be_turned_to_a_side(talk):
    frames = [replace(f, images={n: i[20:-20] for n, i in f.images.items()}) for f in talk]
    frames = [replace(f, masks={n: m[20:-20] for n, m in f.masks.items()}, labels={}) for f in frames]
    half = [replace(f, images=f.images | {"cam02": f.images["cam02"][::-1, ::-1].copy()}) for f in frames]
    assert exchanged(frames) == [] and [finding.text[:5] for finding in exchanged(half)] == ["cam02"]


WORSE = {
    "moved": lambda mask: np.roll(mask, (17, -30), (0, 1)),
    "fat": lambda mask: cv2.dilate(mask.astype(np.uint8), np.ones((21, 21))) > 0,
    "mirrored": lambda mask: mask[:, ::-1].copy(),
    "full": np.ones_like,
    "empty": np.zeros_like,
}


@pytest.mark.parametrize("how", WORSE)
def test_a_mask_that_fits_its_picture_badly_names_no_other_camera(talk, how):
    for name in talk[0].images:
        said = exchanged([replace(f, masks=f.masks | {name: WORSE[how](f.masks[name])}) for f in talk])
        assert not any("exchanged" in finding.text for finding in said) and (not said or how == "mirrored")


@pytest.mark.parametrize(
    "how, back", [("turned by half a turn", lambda m: m[::-1, ::-1]), ("turned to the left", np.rot90)]
)
def test_of_turns_that_fit_alike_always_the_same_is_named(how, back):
    """A shape of two like halves shows the same outline mirrored or turned; the order of a set of words is another in each process."""
    bar, cross = np.zeros((2, 256, 256), bool)
    bar[96:160, 30:226], cross[40:200, 98:158], cross[60:90, 60:196] = True, True, True
    for mask in (bar,) if how.endswith("left") else (cross, cross.T):
        picture = np.where(back(mask)[..., None], 200, 40).astype(np.uint8).repeat(3, 2)
        (said,) = exchanged([Frame(0, None, images={"cam": picture}, masks={"cam": mask})])
        assert f"outlines of its masks {how}:" in said.text


@pytest.mark.parametrize("name", ["tshirt-talk", "tshirt-pictures"])
def test_red_and_blue_exchanged_in_all_pictures_are_said_by_faces_and_in_one_camera_or_in_grey_they_are_not(name):
    capture = open_capture(SAMPLE.parent / name)
    frame = capture.pictures(0)
    change = lambda cameras, how: replace(frame, images=frame.images | {n: how(frame.images[n]) for n in cameras})
    exchanged_colours = lambda image: image[..., ::-1]
    (said,) = blue_faces(capture, [change(frame.images, exchanged_colours)])
    assert said.text.startswith("images: faces are bluer than red in all ") and not said.serious
    grey = change(frame.images, lambda image: np.repeat(image[..., 1:2], 3, axis=2))
    for sound in (frame, grey, change(["cam00"], exchanged_colours), replace(frame, images={})):
        assert blue_faces(capture, [sound]) == []
