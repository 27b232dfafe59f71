"""Each mistake that captures contain is planted, and named by inspect with what mends it; a sound capture has none."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.inspected import FRAMES, PICTURED, edited, person, posed, recalibrated, texts
from tests.support.rig import ring_of_cameras
from toile.io.importing import cameras_json
from toile.measure.inspection import inspect
from toile.measure.inspection.body import BONES, check_bones, check_names, check_sides, check_units
from toile.measure.inspection.cameras import agrees
from toile.measure.inspection.page import write_inspection
from toile.measure.inspection.rays import Sighting

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
OPENGL = np.diag([1.0, -1, -1, 1])
LEG = ("upperleg01", "lowerleg01", "foot")


def test_a_sound_capture_has_no_findings_and_its_stature(sound):
    found = inspect(sound)
    alone = len(found.capture.frames) - len(list(sound.glob("frames/*/masks")))
    assert alone > 0 and found.facts["frames by keypoints alone"] == alone
    assert not found.findings and not found.wasted
    assert 1.4 < found.facts["stature m"] < 2.0 and found.facts["error px"] < 2 and found.facts["hull covers %"] > 90
    assert np.nanmax(found.lines) < 2.5 and found.labels["shirt"] == {f"cam{i}": 5 for i in range(5)}


CONVENTIONS = {
    "camera to world: T_camera_world": posed(np.linalg.inv),
    "OpenGL's axes": posed(lambda T: OPENGL @ T),
    "camera to world with OpenGL's axes": posed(lambda T: np.linalg.inv(OPENGL @ T)),
}


@pytest.mark.parametrize("masks_alone", [False, True], ids=["keypoints", "masks"])
@pytest.mark.parametrize("words", CONVENTIONS)
def test_a_calibration_of_another_convention_is_named(capture, words, masks_alone):
    recalibrated(capture, CONVENTIONS[words])
    for file in capture.glob("frames/*/keypoints.json") if masks_alone else ():
        file.unlink()
    said = texts(capture, serious=True)
    assert len(said) == 1 and f"px if it is {words}" in said[0]


def left_with(root, names):
    """The capture has these cameras alone."""
    from toile.io.camera import read_cameras

    cameras = read_cameras(root / "cameras.json")
    (root / "cameras.json").write_text(cameras_json({name: cameras[name] for name in names}))
    for file in root.glob("frames/*/keypoints.json"):
        data = json.loads(file.read_text())
        file.write_text(json.dumps(data | {"points": {name: data["points"][name] for name in names}}))


@pytest.mark.parametrize("words", ["", *CONVENTIONS])
def test_two_cameras_that_fit_are_sound_and_of_another_convention_they_are_named(walk, words):
    left_with(walk, ("cam0", "cam1"))
    if words:
        recalibrated(walk, CONVENTIONS[words])
        (said,) = texts(walk, serious=True)
        assert f"px if it is {words}" in said
    else:
        found = inspect(walk)
        assert not found.findings and found.facts["error px"] < 2 and 1.4 < found.facts["stature m"] < 2.0


def test_mirrored_pictures_are_named(walk):
    edited(walk, lambda name, t, rows: rows[t][name] * [-1, 1, 1] + [512, 0, 0])
    assert any("pictures that are mirrored" in text for text in texts(walk, serious=True))


@pytest.mark.parametrize("words", CONVENTIONS)
def test_one_camera_of_another_convention_is_named_alone(walk, words):
    recalibrated(walk, CONVENTIONS[words], only="cam3")
    said = [text for text in texts(walk) if "they would not if it is" in text]
    assert len(said) == 1 and said[0].startswith("cam3: ") and f"if it is {words}" in said[0]


@pytest.mark.parametrize("shift", [-6, -1, 2, 9])
def test_a_camera_out_of_step_is_named_with_its_shift(walk, shift):
    def change(name, t, rows):
        behind = t - shift
        if name != "cam1":
            return rows[t][name]
        return rows[behind][name] if 0 <= behind < FRAMES else rows[t][name] * [1, 1, 0]

    edited(walk, change)
    said = [text for text in texts(walk, serious=True) if "out of step" in text]
    assert len(said) == 1 and said[0].startswith("cam1: ") and said[0].endswith(f"--offset cam1={shift}")


@pytest.mark.parametrize("unseen", [0, 1, 2])
@pytest.mark.parametrize("frames", [3, 4, 6])
def test_no_camera_of_a_short_capture_in_step_is_called_out_of_step(tmp_path, frames, unseen):
    """Of the packaged capture, with every third keypoint unseen: a shift that fits better by luck is none."""
    for name in ("scene.toml", "cameras.json", "templates", *(f"frames/{t:06d}/keypoints.json" for t in range(frames))):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if name == "templates" else shutil.copy)(SAMPLE / name, tmp_path / name)
    edited(tmp_path, lambda name, t, rows: rows[t][name] * (np.arange(len(rows[t][name])) % 3 != unseen)[:, None])
    assert not [text for text in texts(tmp_path) if "out of step" in text]


def test_two_cameras_out_of_step_are_both_named(walk):
    late = {"cam0": 3, "cam4": -2}

    def change(name, t, rows):
        at = t - late.get(name, 0)
        return rows[at][name] if 0 <= at < FRAMES else rows[t][name] * [1, 1, 0]

    edited(walk, change)
    said = {text.split(":")[0]: text.rpartition("=")[2] for text in texts(walk, serious=True) if "out of step" in text}
    assert said == {"cam0": "3", "cam4": "-2"}


@pytest.mark.parametrize("late", [{"cam1": 0.4}, {"cam1": -0.3}, {"cam0": 0.5, "cam3": -0.25}, {"cam2": 2.3}], ids=str)
def test_cameras_out_of_step_by_parts_of_a_frame_are_named_with_these(walk, late):
    """Keypoints of 1 px noise that a camera sees the wrong fraction of a frame earlier; whole frames are named besides."""
    cameras, rng = ring_of_cameras(5), np.random.default_rng(2)

    def change(name, t, rows):
        if name not in late:
            return rows[t][name]
        uv = cameras[name].project(person(t - late[name])[1])[0]
        return np.c_[uv + rng.normal(0, 1, uv.shape), rows[t][name][:, 2]]

    edited(walk, change)
    said = [text for text in texts(walk) if "parts of a frame" in text]
    told = {
        text.split(":")[0]: float(text.split(" are ")[1].split()[0]) * (1 if "behind" in text else -1) for text in said
    }
    assert told.keys() == late.keys()
    assert all(abs(told[name] - (late[name] - round(late[name]))) <= 0.1 for name in late), told


def test_who_stands_still_or_is_seen_by_three_cameras_tells_no_part_of_a_frame(walk):
    still = lambda name, t, rows: rows[0][name] + np.r_[np.random.default_rng(t).normal(0, 1, 2), 0]
    edited(walk, still)
    assert not [text for text in texts(walk) if "parts of a frame" in text]


def test_few_frames_tell_no_part_of_a_frame_by_chance():
    """Of 12 frames two blocks of time that agree are no evidence: where all that a camera sees wanders, it looks like a step in each."""
    from toile.measure.inspection.fractions import fractions
    from toile.measure.inspection.rays import Sighting

    cameras, rng = tuple(ring_of_cameras(5).values()), np.random.default_rng(7)
    points = [person(t)[1] for t in range(12)]
    seen = np.stack([[camera.project(P)[0] for P in points] for camera in cameras])
    names, sure = tuple(map(str, range(seen.shape[2]))), np.ones(seen.shape[:3])
    wander = lambda: rng.normal(0, 3, (len(seen), 12, 1, 2)).cumsum(axis=1)
    named = [bool(fractions(Sighting(cameras, names, seen + wander(), sure))) for _ in range(20)]
    assert sum(named) <= 1


def test_detections_that_lie_aside_as_a_whole_are_named_with_their_offset(walk):
    edited(walk, lambda name, t, rows: rows[t][name] + ([14, -6, 0] if name == "cam2" else [0, 0, 0]))
    said = [text for text in texts(walk) if "off as a whole" in text]
    assert said and said[0].startswith("cam2: ")
    u, v = (float(x) for x in said[0].split("(")[1].split(")")[0].split(","))
    assert abs(u - 14) < 5 and abs(v + 6) < 4  # of which the others take a share


@pytest.mark.parametrize(
    "factor, words", [(1000, 'units = "mm"'), (100, 'units = "cm"'), (39.37, "inches"), (5, "scale lengths")]
)
def test_lengths_that_are_no_metres_are_named(walk, factor, words):
    def change(T):
        T = T.copy()
        T[:3, 3] *= factor
        return T

    recalibrated(walk, posed(change))
    assert any(text.startswith("units: ") and words in text for text in texts(walk, serious=True))


@pytest.mark.parametrize("masks_alone", [False, True], ids=["keypoints", "masks"])
def test_cameras_that_stand_in_one_place_are_one_line(capture, masks_alone):
    """Also those that stand in one place away from the origin."""
    for file in capture.glob("frames/*/keypoints.json") if masks_alone else ():
        file.unlink()
    for centre in ([0, 0, 0], [0.3, -2.1, 1.7]):
        recalibrated(capture, posed(lambda T, c=centre: np.vstack([np.c_[T[:3, :3], -T[:3, :3] @ c], [0, 0, 0, 1]])))
        said = texts(capture, serious=True)
        assert len(said) == 1 and said[0].startswith("cameras.json: all cameras stand in one place")


def test_a_person_without_a_length_is_said():
    assert check_units(0.0, "m").serious and "no length" in check_units(0.0, "m").text


def test_a_child_and_a_giant_are_said_but_stop_nothing():
    assert check_units(1.7, "m") is None
    for tall in (1.19, 2.21):
        assert not check_units(tall, "m").serious and f"{tall} m tall" in check_units(tall, "m").text
    for tall in (0.5, 5.6, 170):
        assert check_units(tall, "m").serious


def test_another_axis_that_is_up_and_a_person_upside_down_are_named(walk):
    scene = walk / "scene.toml"
    scene.write_text(scene.read_text().replace('up = "z"', 'up = "y"'))
    assert any('[scene] up = "z", not "y"' in text for text in texts(walk, serious=True))
    scene.write_text(scene.read_text().replace('up = "y"', 'up = "z"'))
    recalibrated(walk, posed(lambda T: T @ np.diag([1.0, -1, -1, 1])))
    assert any("head down along z" in text for text in texts(walk, serious=True))


def test_masks_name_the_camera_that_cuts_the_hull(capture):
    for number in PICTURED:
        path = capture / "frames" / f"{number:06d}" / "masks" / "cam2.png"
        mask = np.roll(np.asarray(Image.open(path)), 60, axis=1)
        Image.fromarray(mask).save(path)
    assert any("without cam2: its mask or its calibration is off" in text for text in texts(capture))


OFF = {
    "shares of the picture": (
        lambda rows: rows * [1 / 512, 1 / 512, 1],
        "are they shares of the picture? expected pixels",
    ),
    "another size": (
        lambda rows: rows * [2, 2, 1],
        "% lie off their pictures: were they found in pictures of another size?",
    ),
}


@pytest.mark.parametrize("way", OFF)
def test_keypoints_that_are_not_pixels_of_their_pictures_are_one_line(walk, way):
    change, words = OFF[way]
    edited(walk, lambda name, t, rows: change(rows[t][name]))
    (said,) = texts(walk)
    assert said.startswith("keypoints: ") and words in said


def test_a_camera_whose_k_is_of_another_size_is_named(walk):
    recalibrated(walk, lambda c: replace(c, K=np.diag([2.0, 2, 1]) @ c.K), only="cam1")
    assert any(
        text.startswith("cam1: its principal point (") and "512 x 512 pixels: is K of" in text for text in texts(walk)
    )


def test_bent_knees_tell_left_from_right_where_neither_face_nor_toes_are_detected_and_straight_ones_do_not():
    names = tuple(f"body.{joint}.{side}" for joint in ("upperarm01", *LEG) for side in "LR")
    height, ahead = np.repeat([1.4, 0.9, 0.5, 0.1], 2), np.repeat([0.0, 0.0, 1.0, 0.0], 2)

    def sides(bend, turn):
        points = np.c_[np.tile([turn * 0.2, -turn * 0.2], 4), -bend * ahead, height]
        return check_sides(names, np.tile(points, (6, 1, 1)))

    assert sides(0.3, 1) is None and "are exchanged" in sides(0.3, -1).text
    assert sides(0.05, 1) is sides(0.05, -1) is None


def test_pictures_exchanged_between_two_cameras_stop_by_both_names(tmp_path):
    shutil.copytree(SAMPLE, tmp_path / "talk", ignore=shutil.ignore_patterns("truth", "00000[345]"))
    for folder in (tmp_path / "talk").glob("frames/*/images"):
        for old, new in (("cam00", "aside"), ("cam03", "cam00"), ("aside", "cam03")):
            (folder / f"{old}.jpg").rename(folder / f"{new}.jpg")
    assert texts(tmp_path / "talk", serious=True) == [
        "cam00: its pictures show the outlines of cam03's masks, not of its own: were they exchanged?",
        "cam03: its pictures show the outlines of cam00's masks, not of its own: were they exchanged?",
    ]


def test_keypoints_that_the_model_does_not_know_or_that_are_all_unseen_are_said(walk):
    edited(walk, lambda name, t, before: before[t][name] * [1, 1, 0])
    assert [text for text in texts(walk) if "confidence" in text] == texts(walk) != []
    known = ("body.head", "body.wrist.L")
    assert check_names(known, known) is None
    some, none = check_names((*known, "body.wrist.l"), known), check_names(("nose", "neck"), known)
    assert "does not know 1 of 3 names" in some.text and "'body.wrist.l'" in some.text and not some.serious
    assert "knows none of their names: 'nose', 'neck'" in none.text and none.serious


def test_the_command_prints_a_line_a_problem_writes_a_page_and_says_by_its_code(capture, tmp_path):
    from typer.testing import CliRunner

    from toile.cli import app
    from toile.measure.command import inspect as command

    if "inspect" not in {c.name or c.callback.__name__ for c in app.registered_commands}:
        app.command()(command)
    result = CliRunner().invoke(app, ["inspect", str(capture), "--out", str(tmp_path / "page.html")])
    assert result.exit_code == 0 and "nothing was found" in result.output
    recalibrated(capture, CONVENTIONS["OpenGL's axes"])
    result = CliRunner().invoke(app, ["inspect", str(capture), "--out", str(tmp_path / "page.html")])
    assert result.exit_code == 1 and result.output.startswith("stops  cameras.json: ")
    page = (tmp_path / "page.html").read_text()
    assert page.count("<img") == 15 and "OpenGL&#x27;s axes" in page and "Distance from epipolar lines" in page


def test_a_page_holds_no_markup_of_the_capture(capture, tmp_path):
    found = inspect(capture)
    page = write_inspection(found, tmp_path / "page.html", "<script>x</script>").read_text()
    assert "<script" not in page


def test_real_detections_name_the_cameras_that_lie_aside(shared_data, tmp_path):
    pytest.importorskip("av")
    from toile.io.importing import write_capture
    from toile.io.rig import Options, chosen, read_rig

    source = shared_data / "pose2sim_calibrated_video"
    found = read_rig("qualisys", source, Options(up="z", skeleton="openpose25b", cropped=True))
    found = replace(chosen(found, range(40)), films={})
    write_capture(found, tmp_path / "walk", "test")
    said = inspect(tmp_path / "walk")
    assert not said.wasted and 1.6 < said.facts["stature m"] < 2.0
    assert any(f.text.startswith("cam03: its keypoints lie (+") for f in said.findings)


@pytest.mark.parametrize("side, px", [(2000, 56.6), (192, 8.0)])
def test_cameras_agree_to_a_share_of_the_picture_and_no_finer_than_detectors_do(side, px):
    cameras = tuple(replace(camera, width=side, height=side) for camera in ring_of_cameras(3).values())
    assert agrees(Sighting(cameras, (), np.zeros((3, 1, 0, 2)), np.zeros((3, 1, 0)))) == pytest.approx(px, abs=0.05)


def test_keypoints_that_were_named_by_another_list_are_named(shared_data, tmp_path):
    from toile.io.importing import write_capture
    from toile.io.rig import Options, chosen, read_rig

    source = shared_data / "pose2sim_calibrated_video"
    words = "are their names those of another list (toile import --skeleton)?"
    for skeleton, wrong in (("openpose25b", False), ("openpose25", True)):
        found = read_rig("qualisys", source, Options(skeleton=skeleton, cropped=True))
        write_capture(replace(chosen(found, range(0, 100, 5)), films={}), tmp_path / skeleton, "test")
        assert any(words in text for text in texts(tmp_path / skeleton, serious=True)) == wrong


def test_one_bone_that_is_badly_seen_names_no_other_list():
    names = tuple(f"{joint}.{side}" for bone in BONES.values() for joint in bone for side in "LR")
    names = tuple(dict.fromkeys(names))
    points = np.array([[[0.3 if n.endswith("L") else -0.3, 0, 0.4 * (i // 2)] for i, n in enumerate(names)]])
    assert check_bones(names, points) is None
    points[0, names.index("body.wrist.L")] += [0, 1.0, 0]
    assert check_bones(names, points) is None
    points[0, names.index("body.foot.L")] += [0, 2.0, 0]
    found = check_bones(names, points)
    assert found is not None and "shanks of" in found.text and "forearms of" in found.text
