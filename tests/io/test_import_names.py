"""Which camera and which frame a file is of, told by how it and its folders are called."""

from dataclasses import replace
from pathlib import Path
from unicodedata import normalize

import pytest

from tests.support.calibrations import write_json
from tests.support.cube import check, views
from tests.support.imported import imported, rig, save
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.places import place
from toile.io.rig import Options, read_rig

LAYOUTS = {  # of a camera's frame
    "camera folders": "images/{camera}/{number:06d}.jpg",
    "frame folders, unpadded": "images/{number}/{camera}.jpg",
    "one folder": "images/{camera}_{number:04d}.jpg",
    "beside the calibration": "{camera}/img_{number}.jpg",
    "of Windows": "Images/{camera}/{number:06d}.JPG",
    "words between": "rgbs/{camera}/{camera}_rgb{number:06d}.jpg",
}


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_pictures_are_found_and_linked_in_every_layout(tmp_path, layout):
    made = rig(tmp_path / "their", layout)
    imported(tmp_path / "their", tmp_path / "ours")
    capture = open_capture(tmp_path / "ours")
    check(capture.cameras, made, within=1e-3)
    assert capture.frames == (0, 2, 10) and capture.scene.up == "z"
    for number in capture.frames:
        frame = capture.frame(number)
        assert list(frame.images) == [v.name for v in made]
        assert all(abs(int(image[0, 0, 0]) - 10 - number) < 4 for image in frame.images.values())
    theirs = [path for ending in ("jpg", "JPG") for path in (tmp_path / "their").rglob(f"*.{ending}")]
    ours = (tmp_path / "ours").rglob("*.jpg")
    assert {p.stat().st_ino for p in ours} == {p.stat().st_ino for p in theirs}  # not a byte was copied


def test_folders_are_found_in_whatever_case_they_are_called_and_hold_nothing_of_another_kind(tmp_path):
    rig(tmp_path / "their", "{camera}/{number}.jpg", numbers=(0,))
    for v in views():
        save(tmp_path / "their" / "Masks" / v.name / "0.png", (v.width, v.height), 200, mode="L")
    imported(tmp_path / "their", tmp_path / "ours")
    frame = open_capture(tmp_path / "ours").frame(0)
    assert set(frame.images) == set(frame.masks) == {v.name for v in views()}


def test_pictures_before_frame_0_are_said(tmp_path):
    rig(tmp_path)
    found = read_rig("lists", tmp_path, Options(offsets={"left": 99, "front": 1}))
    assert "left: images before frame 0, as --offset says: 1 of front, 3 of left" in found.notes


def test_pictures_that_are_neither_png_nor_jpeg_are_said(tmp_path):
    made = rig(tmp_path)
    for number in (0, 2, 10):
        save(tmp_path / "images" / "left" / f"{number}.TIF", (made[0].width, made[0].height))
        (tmp_path / "images" / "left" / f"{number:06d}.jpg").unlink()
    found = read_rig("lists", tmp_path, Options())
    assert "left: 3 images that are neither PNG nor JPEG: left/0.TIF, left/10.TIF, left/2.TIF" in found.notes
    for path in (tmp_path / "images").rglob("*.jpg"):
        path.unlink()
    with pytest.raises(
        UserError, match="no pictures of the cameras .*; left: 3 images that are neither PNG nor JPEG: left/0.TIF"
    ):
        read_rig("lists", tmp_path, Options())


@pytest.mark.parametrize("forms", [("NFC", "NFD"), ("NFD", "NFC")])
def test_a_camera_s_name_is_the_same_in_either_form_of_its_accents(tmp_path, forms):
    of_calibration, of_folder = (normalize(form, "Kamera Süd") for form in forms)
    write_json(tmp_path, [replace(views()[0], name=of_calibration), *views()[1:]])
    for v, name in zip(views(), (of_folder, *(v.name for v in views()[1:]))):
        save(tmp_path / "images" / name / "3.jpg", (v.width, v.height))
    imported(tmp_path, tmp_path / "ours")
    assert set(open_capture(tmp_path / "ours").frame(3).images) == {"Kamera Süd", "front", "cam 3"}


@pytest.mark.parametrize(
    "path, camera, number",
    [
        ("cam1/000012.jpg", "cam1", 12), ("12/cam10.jpg", "cam10", 12), ("cam1.0003.json", "cam1", 3),
        ("cam10_json/cam10_000007_keypoints.json", "cam10", 7), ("000002_cam1.png", "cam1", 2), ("cam1.png", "cam1", 0),
        ("cam100/3.jpg", None, 0), ("xcam1/3.jpg", None, 0), ("cam1_12-30-05.png", "cam1", 0), ("cam1_12h30m05.png", "cam1", 0),
        ("cam1_20261128_123005.png", "cam1", 0), ("cam1_2026-11-28T123005.123.png", "cam1", 0), ("cam1_12-30-05_000012.png", "cam1", 12),
        ("12_30_05/cam1/7.png", "cam1", 7), ("cam1_12-30-65.png", "cam1", 65), ("cam1_012-030-005.png", "cam1", 5),
        ("cam1_20261128_000012.png", "cam1", 12), ("cam1_2026-11-28-000159.png", "cam1", 159), ("cam1_20261128001530.png", "cam1", 0),
    ],
)  # fmt: skip
def test_names_tell_camera_and_frame(path, camera, number):
    assert place(Path(path), ["cam10", "cam1"]) == (camera, number)


def test_pictures_that_only_times_of_day_tell_apart_are_refused(tmp_path):
    made = rig(tmp_path, numbers=())
    for v in made:
        for time in ("12-30-58", "12-31-03"):
            save(tmp_path / "images" / f"{v.name}_{time}.jpg", (v.width, v.height))
    with pytest.raises(
        UserError, match=r"12-31-03\.jpg: camera '.*' has frame 0 in .*12-30-58\.jpg too: times of day number no frames"
    ):
        imported(tmp_path, tmp_path / "ours")


@pytest.mark.parametrize(
    "layout", ["images/{camera}/{number}.jpg", "images/{number}/{camera}.jpg", "images/{camera}_{number:02d}.jpg"]
)
def test_cameras_called_by_numbers_are_told_from_frames(tmp_path, layout):
    numbered = [replace(v, name=str(i), width=480, height=360) for i, v in enumerate(views(), 1)]
    write_json(tmp_path, numbered)
    for i, v in enumerate(numbered, 1):
        for number in range(1, 6):
            save(tmp_path / layout.format(camera=v.name, number=number), (480, 360), 10 * i + 40 * number)
    imported(tmp_path, tmp_path / "ours")
    capture = open_capture(tmp_path / "ours")
    assert capture.frames == (1, 2, 3, 4, 5)
    for number in capture.frames:
        seen = {camera: round(int(image[0, 0, 0]) / 10) for camera, image in capture.frame(number).images.items()}
        assert seen == {v.name: i + 4 * number for i, v in enumerate(numbered, 1)}


def test_frames_and_cameras_of_the_same_numbers_are_refused_by_a_file_s_name(tmp_path):
    numbered = [replace(v, name=str(i), width=480, height=360) for i, v in enumerate(views(), 1)]
    write_json(tmp_path, numbered)
    for v in numbered:
        for number in range(1, 4):
            save(tmp_path / "images" / v.name / f"{number}.jpg", (480, 360))
    with pytest.raises(UserError, match=r"images/1/2\.jpg: 1 and 2 are both cameras: which of them is the frame\?"):
        imported(tmp_path, tmp_path / "ours")
