"""Keypoints that are of the other side, of nothing or of nobody, as inspect tells them."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.inspected import FRAMES, edited, person, texts
from toile.io.camera import read_cameras
from toile.measure.inspection.sides import other_side

AT = other_side(tuple(person(0)[0]))
ALL = "keypoints: left and right are exchanged: face, toes or bent knees point backwards in nearly all frames"
EXCHANGED = {"cam2": range(FRAMES), "cam0": (3, 4, 11)}


def turned_where(root, when):
    """Left and right are exchanged in the pictures of which `when(camera, frame)` says so."""
    edited(root, lambda name, t, rows: rows[t][name][AT] if when(name, t) else rows[t][name])


def test_the_other_side_of_a_name_is_found_in_each_way_of_writing_it_and_the_middle_is_its_own():
    names = ("body.wrist.L", "body.wrist.R", "hand_left.x.L", "hand_right.x.R", "face.nose_tip", "body.foot.L")
    assert other_side(names).tolist() == [1, 0, 3, 2, 4, 5]


def test_pictures_whose_sides_are_exchanged_are_named_with_their_frames_and_stop_nothing(walk):
    turned_where(walk, lambda name, t: t in EXCHANGED.get(name, ()))
    assert not texts(walk, serious=True)
    one, other = sorted(texts(walk))
    assert one.startswith("cam0: left and right are exchanged in 3 of its 30 frames") and one.endswith(": 3-4, 11")
    assert other.startswith("cam2: left and right are exchanged in 30 of its 30 frames") and other.endswith(": 0-29")


def test_sides_exchanged_in_most_cameras_leave_the_few_named_and_the_person_backwards(walk):
    turned_where(walk, lambda name, t: name != "cam2")
    assert texts(walk, serious=True) == [ALL]
    assert any(text.startswith("cam2: left and right are exchanged") for text in texts(walk))


def test_frames_whose_sides_are_exchanged_in_all_cameras_are_named_and_no_other_order_is_asked_for(walk):
    turned_where(walk, lambda name, t: t in (6, 7, 20))
    (said,) = texts(walk)
    assert said == "keypoints: left and right are exchanged in 3 frames, against those before and after: 6-7, 20"


@pytest.mark.parametrize("fps, told", [(30, True), (2, False)])
def test_who_may_have_turned_about_meanwhile_has_no_sides_exchanged(walk, fps, told):
    scene = walk / "scene.toml"
    scene.write_text(scene.read_text().replace("[scene]", f"[scene]\nfps = {fps}"))
    turned_where(walk, lambda name, t: t in (6, 7, 20))
    assert any("left and right" in text for text in texts(walk)) == told


def test_unseen_keypoints_that_are_written_as_the_corner_with_a_confidence_are_said_and_no_camera_is_blamed(walk):
    edited(walk, lambda name, t, rows: rows[t][name] * np.where(np.arange(len(AT)) % 3, 1, 0)[:, None] + [0, 0, 0.9])
    (said,) = texts(walk)
    assert "% of those with a confidence lie at (0, 0), in cam0, cam1, cam2, cam3, ...: give" in said


def test_a_camera_that_sees_no_keypoint_is_asked_about_and_disagrees_with_nobody(walk):
    edited(walk, lambda name, t, rows: rows[t][name] * [1, 1, name != "cam3"])
    (said,) = texts(walk)
    assert said == "cam3: no keypoint is seen there in any frame: does it show the person?"
    assert not texts(walk, serious=True)


def test_a_camera_that_no_frame_lists_is_not_asked_about(walk):
    for file in walk.glob("frames/*/keypoints.json"):
        data = json.loads(file.read_text())
        data["points"].pop("cam3")
        file.write_text(json.dumps(data))
    assert not texts(walk)


@pytest.mark.parametrize("seeing", [("cam0",), ("cam0", "cam1")])
def test_where_one_camera_or_two_see_keypoints_the_others_are_asked_about_and_no_calibration_is_blamed(walk, seeing):
    edited(walk, lambda name, t, rows: rows[t][name] * [1, 1, name in seeing])
    (said,) = texts(walk)
    assert said.endswith("no keypoint is seen there in any frame: does it show the person?")


def test_keypoints_that_all_lie_at_the_corner_are_said_to_and_no_calibration_is_blamed(walk):
    edited(walk, lambda name, t, rows: rows[t][name] * [0, 0, 1])
    (said,) = texts(walk)
    assert said.startswith("keypoints: 100 % of those with a confidence lie at (0, 0)")


def test_of_two_cameras_against_two_the_same_are_named_in_every_frame(walk):
    edited(
        walk,
        lambda name, t, rows: (
            (rows[t][name][AT] if name in ("cam2", "cam3") else rows[t][name]) * [1, 1, name != "cam4"]
        ),
    )
    blind, *told = texts(walk)
    assert blind.startswith("cam4: no keypoint")
    assert [text[:5] for text in told] == ["cam2:", "cam3:"] and all(text.endswith(": 0-29") for text in told)


def beside(root, when, way=0.6):
    """Of the pictures of which `when(camera, frame)` says so, keypoints of the same person `way` [m] to the side of both."""
    cameras = read_cameras(root / "cameras.json")

    def put(name, t, rows):
        camera, points = cameras[name], person(t)[1]
        moved = points + way * np.array([camera.T_camera_world[0, 0], camera.T_camera_world[0, 1], 0])
        return np.c_[camera.project(moved)[0], rows[t][name][:, 2]] if when(name, t) else rows[t][name]

    edited(root, put)


def test_pictures_with_keypoints_of_somebody_else_are_named_with_their_frames_and_stop_nothing(walk):
    beside(walk, lambda name, t: (name, t) in {("cam1", 4), ("cam1", 5), ("cam3", 5), ("cam3", 20)})
    one, other = sorted(texts(walk))
    whose = "frames are of somebody else, or of another moment, than those of the other cameras"
    assert one == f"cam1: its keypoints in 2 of 30 {whose}: 4-5"
    assert other == f"cam3: its keypoints in 2 of 30 {whose}: 5, 20"
    assert not texts(walk, serious=True)


def test_a_limb_that_is_mistaken_is_not_somebody_else_s(walk):
    k = len(AT) // 2
    edited(
        walk, lambda name, t, rows: rows[t][name] + (np.arange(len(AT)) < k)[:, None] * [80 * (name == "cam1"), 0, 0]
    )
    assert not any("somebody else" in text for text in texts(walk))


@pytest.mark.parametrize(
    "moved, words", [(range(18, 30), "18-29; all from then on"), (range(9), "0-8; all up to then")]
)
def test_a_camera_that_was_moved_on_the_way_is_asked_about_from_when(walk, moved, words):
    turn = Rotation.from_euler("y", 4, degrees=True).as_matrix()

    def put(name, t, rows):
        if name != "cam1" or t not in moved:
            return rows[t][name]
        camera = read_cameras(walk / "cameras.json")[name]
        at = camera.to_camera(person(t)[1]) @ turn.T @ camera.K.T
        return np.c_[at[:, :2] / at[:, 2:], rows[t][name][:, 2]]

    edited(walk, put)
    (said,) = texts(walk)
    assert said.startswith("cam1: ") and said.endswith(f": {words}: was the camera moved?")


def test_somebody_else_in_most_frames_is_a_camera_that_disagrees(walk):
    beside(walk, lambda name, t: name == "cam1" and t > 5)
    assert not any("somebody else" in text for text in texts(walk))
    assert any(text.startswith("cam1: its keypoints ") for text in texts(walk))


def test_frames_of_a_camera_out_of_step_are_named_by_its_own_numbers(walk):
    edited(walk, lambda name, t, rows: rows[max(t - 3, 0) if name == "cam2" else t][name])
    beside(walk, lambda name, t: name == "cam2" and t in (11, 12))
    said = [text for text in texts(walk) if text.startswith("cam2")]
    assert (
        len(said) == 2
        and any("out of step" in text for text in said)
        and any(text.endswith(": 11-12") for text in said)
    )
