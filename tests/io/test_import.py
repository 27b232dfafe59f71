"""A calibration and the files about it become a capture, whole or not at all."""

import json
import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.support.calibrations import write_json, write_toml
from tests.support.cube import views
from tests.support.imported import imported, rig, save
from toile.cli import app
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.importing import cameras_json, up_of, write_capture
from toile.io.openpose import read_person
from toile.io.rig import Options, chosen, read_rig
from toile.io.skeletons import SKELETONS


def test_a_world_upside_down_is_turned_with_its_scans_and_said(tmp_path):
    made = rig(tmp_path / "their")
    found = read_rig("lists", tmp_path / "their", Options(up="-z"))
    assert found.up == "z" and any("half a turn" in note for note in found.notes)
    point = np.array([0.1, 0.2, 0.3])
    for v in made:
        turned = found.cameras[v.name].project(point * [1, -1, -1])[0]
        np.testing.assert_allclose(turned, v.pixels(point[None])[0], atol=1e-3)


def test_cameras_tell_which_axis_is_up_or_that_they_cannot(tmp_path):
    rig(tmp_path)
    found = read_rig("lists", tmp_path, Options())
    assert found.up == "z" and "up: told by the cameras" in found.notes
    one = found.cameras["front"]
    leaning = replace(
        one,
        T_camera_world=np.block([[Rotation.from_euler("x", 45, True).as_matrix(), np.zeros((3, 1))], [np.eye(4)[3:]]]),
    )
    assert up_of([leaning]) == ""


def test_keypoints_of_openpose_are_named_and_the_surest_person_is_taken(tmp_path):
    made, point = rig(tmp_path / "their", numbers=(0,)), np.zeros((25, 3))
    point[5] = 100.0, 50.0, 0.9  # BODY_25B: left shoulder; BODY_25: left shoulder too
    point[9] = 120.0, 90.0, 0.8  # left wrist; BODY_25: right hip
    other = {"pose_keypoints_2d": (0.5 * point).ravel().tolist()}
    people = {"people": [other, {"pose_keypoints_2d": point.ravel().tolist()}]}
    for v in made:
        path = tmp_path / "their" / "pose" / f"{v.name}_json" / f"{v.name}.0000.json"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(people))
    with pytest.raises(
        UserError, match=r"25 body points: say which list they are by --skeleton: openpose25, openpose25b"
    ):
        imported(tmp_path / "their", tmp_path / "ours")
    with pytest.raises(UserError, match="--skeleton openpose99: expected one of coco17, openpose18, "):
        imported(tmp_path / "their", tmp_path / "ours", skeleton="openpose99")
    imported(tmp_path / "their", tmp_path / "ours", skeleton="openpose25b")
    keypoints = open_capture(tmp_path / "ours").frame(0).keypoints
    assert keypoints.names == ("body.upperarm01.L", "body.wrist.L")
    np.testing.assert_allclose(keypoints.points["front"], [[100.5, 50.5, 0.9], [120.5, 90.5, 0.8]])
    assert read_person(path, "openpose25")[0].keys() == {"body.upperarm01.L", "body.upperleg01.R"}


def test_lists_of_openpose_and_halpe_of_other_lengths_hold_the_points_of_those_that_they_extend():
    openpose25, halpe26, coco133 = (SKELETONS[name] for name in ("openpose25", "halpe26", "coco_wholebody133"))
    assert SKELETONS["openpose18"] == (
        *openpose25[:8],
        *openpose25[9:19],
    )  # without the middle of the hips and the feet
    halpe136 = SKELETONS["halpe136"]
    assert halpe136[1:26] == halpe26[1:] and halpe136[26:] == coco133[23:] and len(halpe136) == 136
    assert len(set(filter(None, halpe136))) == len(list(filter(None, halpe136)))


def test_a_confidence_in_percent_is_refused_by_file_and_field(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"people": [{"pose_keypoints_2d": [10.0, 20.0, 95.0] * 17}]}))
    with pytest.raises(UserError, match=r"a\.json: people\.0\.pose_keypoints_2d: a confidence of 95, expected 0 to 1"):
        read_person(tmp_path / "a.json")


def test_cameras_without_distortion_are_named(tmp_path):
    made = rig(tmp_path)
    words = lambda: [note for note in read_rig("lists", tmp_path, Options()).notes if note.startswith("distortion")]
    assert words() == []
    straight = views(distorted=False)
    write_json(tmp_path, [*straight[:1], *made[1:]])
    assert words() == [f"distortion: none of {made[0].name}: such pictures are taken as they are"]
    write_json(tmp_path, straight)
    assert words() == ["distortion: none of any camera: such pictures are taken as they are"]


def huge_png(path, width=40_000, height=25_000):
    """A PNG whose header claims 10^9 pixels, of a few bytes."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", b"") + chunk(b"IEND", b""))


def other_cameras(folder):
    (folder / "images").rename(folder / "aside")
    save(folder / "images" / "kitchen" / "0.jpg", (480, 360))


SPOILT = {
    "another size": (lambda f: save(f / "images/left/000002.jpg", (48, 36)), r"000002\.jpg: 48 x 36 pixels, the calib"),
    "unreadable": (lambda f: (f / "images/left/000002.jpg").write_bytes(b"no"), "cannot be read as a PNG or JPEG"),
    "huge header": (lambda f: huge_png(f / "images/front/000011.png"), r"their/images/front/000011\.png: .*1000000000 pixels"),
    "two of a frame": (lambda f: save(f / "images/left/2.png", (480, 360)), "camera 'left' has frame 2 in"),
    "16 bits": (
        lambda f: Image.fromarray(np.full((360, 480), 40_000, np.uint16)).save(f / "images/front/000011.png"),
        r"front/000011\.png: 16 bits a channel, expected 8",
    ),
    "another set": (other_cameras, r"images: pictures of no camera of the calibration: kitchen/0\.jpg; its cameras: left"),
    "seven digits": (lambda f: save(f / "images/left/1234567.jpg", (480, 360)), "at most six digits"),
    "keypoints": (
        lambda f: [(f / "pose/left").mkdir(parents=True), (f / "pose/left/1.json").write_text('{"people": 3}')],
        r"1\.json: people: expected a list",
    ),
    "no picture": (lambda f: (f / "images").rename(f / "videos"), r"no pictures of the cameras"),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_bad_input_is_refused_and_leaves_nothing_behind(tmp_path, name):
    spoil, message = SPOILT[name]
    rig(tmp_path / "their")
    spoil(tmp_path / "their")
    with pytest.raises(UserError, match=message):
        imported(tmp_path / "their", tmp_path / "ours")
    assert [p.name for p in tmp_path.iterdir()] == ["their"]


def test_a_capture_that_is_there_is_not_written_over(tmp_path):
    rig(tmp_path / "their")
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "mine.txt").write_text("keep")
    with pytest.raises(UserError, match="ours: is there already"):
        imported(tmp_path / "their", tmp_path / "ours")
    assert (tmp_path / "ours" / "mine.txt").read_text() == "keep"


def test_what_a_killed_import_left_goes_with_the_next(tmp_path):
    rig(tmp_path / "their")
    left = tmp_path / ".ours.0123456789ab.part"
    left.mkdir()
    (left / ".busy").touch()  # which nobody holds
    imported(tmp_path / "their", tmp_path / "ours")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ours", "their"]
    assert sorted(p.name for p in (tmp_path / "ours").iterdir()) == ["cameras.json", "frames", "scene.toml"]


def test_cropped_pictures_are_taken_when_said(tmp_path):
    made = rig(tmp_path / "their", numbers=())
    for v in made:
        save(tmp_path / "their" / "images" / v.name / "0.jpg", (v.width - 8, v.height))
    with pytest.raises(UserError, match="--cropped"):
        imported(tmp_path / "their", tmp_path / "ours")
    imported(tmp_path / "their", tmp_path / "ours", cropped=True)
    camera = open_capture(tmp_path / "ours").cameras["left"]
    assert camera.size == (360, 472)
    np.testing.assert_allclose(camera.K, made[0].K_half)


@pytest.mark.parametrize("ratio", [0.5, 1 / 3, 1.5, 0.2031])
def test_points_lie_on_scaled_pictures_where_they_lay_times_the_ratio_of_the_sides(tmp_path, ratio):
    made, points = rig(tmp_path / "their", numbers=()), np.random.default_rng(1).uniform(-0.3, 0.3, (20, 3))
    sizes = {v.name: (round(ratio * v.width), round(ratio * v.height)) for v in made}
    for name, size in sizes.items():
        save(tmp_path / "their" / "images" / name / "0.jpg", size)
    with pytest.raises(
        UserError, match=r"the calibration of camera .* is for .*: --cropped; were they scaled since: --sc"
    ):
        imported(tmp_path / "their", tmp_path / "ours")
    notes = imported(tmp_path / "their", tmp_path / "ours", scaled=True).notes
    (width, height), said = sizes["left"], "calibration scaled to the pictures: left from 480 x 360 to"
    assert any(note.startswith(f"{said} {width} x {height}, ") for note in notes)
    for v in made:
        camera = open_capture(tmp_path / "ours").cameras[v.name]
        assert (camera.width, camera.height) == sizes[v.name]
        expected = v.pixels(points) * np.divide(sizes[v.name], (v.width, v.height))
        np.testing.assert_allclose(camera.project(points)[0], expected, atol=1e-3)


def test_pictures_of_another_shape_are_no_scaled_ones(tmp_path):
    made = rig(tmp_path / "their", numbers=())
    for v in made:
        save(tmp_path / "their" / "images" / v.name / "0.jpg", (240, 178))
    for options in ({}, {"scaled": True}):
        with pytest.raises(UserError, match=r"240 x 178 pixels, .*: --cropped; scaled they were not by one factor"):
            imported(tmp_path / "their", tmp_path / "ours", **options)
    with pytest.raises(UserError, match="--cropped, --scaled: of pictures that were cut and scaled nothing tells"):
        imported(tmp_path / "their", tmp_path / "ours", scaled=True, cropped=True)


def test_the_command_makes_a_capture_that_plan_opens(tmp_path):
    from typer.testing import CliRunner

    from toile.io.command import import_capture

    made = views()
    (tmp_path / "their").mkdir()
    write_toml(tmp_path / "their", made)
    for v in made:
        save(tmp_path / "their" / f"{v.name}.png", (v.width, v.height))
    if "import" not in {command.name for command in app.registered_commands}:
        app.command("import")(import_capture)
    result = CliRunner().invoke(app, ["import", "pose2sim", str(tmp_path / "their"), str(tmp_path / "ours")])
    assert result.exit_code == 0 and "1 frames, 3 cameras, up z" in result.output
    assert "unit m" in result.output and open_capture(tmp_path / "ours").frames == (0,)
    assert json.loads(cameras_json(open_capture(tmp_path / "ours").cameras))["cameras"][0]["name"] == "left"
    result = CliRunner().invoke(app, ["import", "shoebox", str(tmp_path), str(tmp_path / "other")])
    assert isinstance(result.exception, UserError) and "expected one of opencv" in str(result.exception)


def test_real_folders_become_captures(shared_data, tmp_path):
    pytest.importorskip("av")
    source = shared_data / "pose2sim_calibrated_video"
    found = read_rig("qualisys", source, Options(up="z", skeleton="openpose25b", cropped=True))
    write_capture(chosen(found, (3,)), tmp_path / "walk", "test")
    frame = open_capture(tmp_path / "walk").frame(3)
    assert {image.shape for image in frame.images.values()} == {(1920, 1080, 3), (1920, 1088, 3)}  # three were cut
    assert all((rows[:, 2] > 0.3).sum() > 15 for rows in frame.keypoints.points.values())
    imported(shared_data / "middlebury_temple", tmp_path / "temple")
    assert len(open_capture(tmp_path / "temple").frame(0).images) == 16
