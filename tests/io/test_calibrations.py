"""A cube's corners land on the same pixels through every calibration format, each written by its own library where it has
one, and what cannot be read is refused by file and field."""

import json
import struct
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.calibrations import (
    FORMATS,
    opencv_parameters,
    spoil,
    storage,
    write_colmap_text,
    write_opencv_files,
    write_toml,
    written_as,
)
from tests.support.cube import CORNERS, check, views
from toile.errors import UserError
from toile.io.calibration import KINDS, find_calibration, read_calibration


@pytest.mark.parametrize("name", FORMATS)
def test_a_cube_lands_on_the_same_pixels_through_every_format(tmp_path, name):
    made, path, kind, metres = written_as(tmp_path, name)
    check(read_calibration(kind, path), made, metres, within=1e-3)
    check(read_calibration(kind, find_calibration(kind, tmp_path)), made, metres, within=1e-3)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
def test_models_that_colmap_itself_writes_are_read(tmp_path, binary):
    pycolmap = pytest.importorskip("pycolmap")
    made, model = views(distorted=False), pycolmap.Reconstruction()
    for i, v in enumerate(made, 1):
        lens = pycolmap.Camera(
            camera_id=i, model="PINHOLE", width=v.width, height=v.height, params=opencv_parameters(v)[:4]
        )
        model.add_camera_with_trivial_rig(lens)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(v.R), v.t)
        model.add_image_with_trivial_frame(pycolmap.Image(name=f"{v.name}.png", image_id=i, camera_id=i), pose)
        model.register_frame(i)
    (model.write_binary if binary else model.write_text)(str(tmp_path))
    check(read_calibration("colmap", find_calibration("colmap", tmp_path)), made, within=1e-3)


def test_the_chunk_s_transform_places_a_component_that_has_none(tmp_path):
    made, path, kind, _ = written_as(tmp_path, "metashape")
    tree = ElementTree.parse(path)
    component, chunk = tree.find("chunk/components/component"), tree.find("chunk")
    chunk.append(component.find("transform"))
    component.remove(component.find("transform"))
    tree.write(path)
    check(read_calibration(kind, path), made, within=1e-3)


def test_components_of_which_one_is_not_placed_are_refused(tmp_path):
    made, path, kind, _ = written_as(tmp_path, "metashape")
    spoil(path, 'sensor_id="1" component_id="0"', 'sensor_id="1" component_id="1"')
    spoil(path, "</components>", '<component id="1" /></components>')
    with pytest.raises(UserError, match=r"cameras\.xml: camera 'front': component 1 has no transform, .* the other 1"):
        read_calibration(kind, path)
    spoil(path, '<component id="1" />', '<component id="1"><transform><scale>2</scale></transform></component>')
    assert len(read_calibration(kind, path)) == len(made)


def in_a_system(path, made, tag="location"):
    """The export's cameras as one multi-camera system: all but the second lose their transform, sensors are placed from the first."""
    tree = ElementTree.parse(path)
    sensors, cameras = tree.findall("chunk/sensors/sensor"), tree.findall("chunk/cameras/camera")
    poses = [np.array(c.findtext("transform").split(), float).reshape(4, 4) for c in cameras[: len(made)]]
    for i, (sensor, camera) in enumerate(zip(sensors, cameras)):
        if i != 0:
            offset = np.linalg.inv(poses[0]) @ poses[i]
            sensor.set("master_id", "0")
            for name, value in {"rotation": offset[:3, :3], tag: offset[:3, 3]}.items():
                ElementTree.SubElement(sensor, name).text = " ".join(map(repr, value.ravel().tolist()))
        if i != 1:
            camera.set("master_id", "1")
            camera.remove(camera.find("transform"))
    tree.write(path)


@pytest.mark.parametrize("tag", ["location", "translation"])
def test_cameras_of_a_metashape_system_are_placed_by_their_master(tmp_path, tag):
    made, path, kind, _ = written_as(tmp_path, "metashape")
    in_a_system(path, made, tag)
    notes = []
    check(read_calibration(kind, path, notes), made, within=1e-3)
    assert notes == ["left: 1 cameras that are not aligned: unaligned"]


@pytest.mark.parametrize(
    "old, new, why",
    [
        ('id="1" sensor_id', 'id="7" sensor_id', "whose master is not aligned: left, cam 3"),
        ("<location>", "<place>", "whose sensor has no rotation and location to its master's: left, cam 3"),
    ],
)
def test_cameras_of_a_metashape_system_that_nothing_places_are_said(tmp_path, old, new, why):
    made, path, kind, _ = written_as(tmp_path, "metashape")
    in_a_system(path, made)
    path.write_text(
        path.read_text().replace(old, new).replace("</location>", "</place>" if "place" in new else "</location>")
    )
    notes = []
    check(read_calibration(kind, path, notes), made[1:2], within=1e-3)
    assert notes[0] == f"left: 2 cameras {why}"


def test_inactive_cameras_of_qualisys_are_said(tmp_path):
    _, path, kind, _ = written_as(tmp_path, "qualisys")
    spoil(path, 'serial="front" active="1"', 'serial="front" active="0"')
    notes = []
    assert set(read_calibration(kind, path, notes)) == {"left", "cam 3"}
    assert notes == ["left: 1 cameras that are not active: front"]


def test_labels_of_metashape_lose_the_ending_of_a_picture_alone(tmp_path):
    _, path, kind, _ = written_as(tmp_path, "metashape")
    for old, new in (("left.jpg", "cam.1"), ("front.jpg", "cam.2.TIF")):
        spoil(path, f'label="{old}"', f'label="{new}"')
    assert list(read_calibration(kind, path)) == ["cam.1", "cam.2", "cam 3"]


def test_cameras_of_metashape_whose_labels_repeat_are_called_by_their_groups_or_it_is_said_what_to_do(tmp_path):
    made, path, kind, _ = written_as(tmp_path, "metashape")
    for v in made:
        spoil(path, f'label="{v.name}.jpg"', 'label="0001.jpg"')
    with pytest.raises(
        UserError, match=r"two cameras are called '0001': group each in Metashape under the name of its pic"
    ):
        read_calibration(kind, path)
    tree = ElementTree.parse(path)
    cameras = tree.find("chunk/cameras")
    for i, (v, camera) in enumerate(zip(made, list(cameras))):
        cameras.remove(camera)
        ElementTree.SubElement(cameras, "group", id=str(i), label=v.name, type="folder").append(camera)
    tree.write(path)
    notes = []
    check(read_calibration(kind, path, notes), made, within=1e-3)
    assert notes[0] == "cameras are called by their groups, as labels repeat: left, front, cam 3"


@pytest.mark.parametrize("word", ["pose", "lens"])
def test_pictures_of_a_colmap_folder_that_are_not_one_camera_s_are_refused(tmp_path, word):
    _, path, kind, _ = written_as(tmp_path, "colmap-text")
    images = tmp_path / "images.txt"
    line = next(row for row in images.read_text().splitlines() if row.endswith("left.png"))
    other = line.replace(" 1 left", " 2 left") if word == "lens" else line.replace(line.split()[5], "9.5")
    rows = "\n\n".join(row.replace("left.png", f"left/{i}.png") for i, row in enumerate((line, line, other)))
    images.write_text(rows + "\n")
    with pytest.raises(
        UserError, match=rf"left/2\.png: camera 'left', called by its folder, has another {word} than before"
    ):
        read_calibration(kind, path)


@pytest.mark.parametrize("folders", [["images"], ["000000", "000001"]])
def test_pictures_of_a_colmap_folder_that_are_as_many_cameras_are_called_by_their_own_names(tmp_path, folders):
    made, path, kind, _ = written_as(tmp_path, "colmap-text")
    images = tmp_path / "images.txt"
    rows = [row for row in images.read_text().splitlines() if row.endswith(".png")]
    lying = [" ".join([*row.split(" ")[:9], f"{f}/{' '.join(row.split(' ')[9:])}"]) for f in folders for row in rows]
    images.write_text("\n\n".join(lying) + "\n")
    check(read_calibration(kind, path), made)


def test_pictures_of_one_lens_and_several_poses_are_said_to_be_one_moving_camera_perhaps(tmp_path):
    made, path, kind, _ = written_as(tmp_path, "colmap-text")
    notes = []
    assert read_calibration(kind, path, notes) and not notes
    for i, name in ((1, "left"), (2, "front"), (3, "cam 3")):
        spoil(tmp_path / "images.txt", f" {i} {name}.png", f" 1 film/{i:04d}.png")
    assert list(read_calibration(kind, path, notes)) == ["0001", "0002", "0003"]
    assert (
        len(notes) == 1
        and "3 pictures share lens 1 and became a camera each: 0001.png, 0002.png, 0003.png;" in notes[0]
    )


def test_several_models_of_colmap_are_refused_until_one_is_named(tmp_path):
    made = views()
    for model in ("0", "1"):
        (tmp_path / "sparse" / model).mkdir(parents=True)
        write_colmap_text(tmp_path / "sparse" / model, made)
    with pytest.raises(
        UserError, match=r"sparse/0/cameras\.txt and sparse/1/cameras\.txt may both be the calibration: name one"
    ):
        find_calibration("colmap", tmp_path)
    one = tmp_path / "sparse" / "1" / "cameras.txt"
    assert find_calibration("colmap", one) == one


def test_settings_of_pose2sim_beside_its_calibration_are_not_taken_for_it(tmp_path):
    (tmp_path / "calibration").mkdir()
    (tmp_path / "Config.toml").write_text("[project]\nframe_rate = 60\n")
    with pytest.raises(UserError, match="no calibration of kind 'pose2sim'"):
        find_calibration("pose2sim", tmp_path)
    written = write_toml(tmp_path / "calibration", views())
    assert find_calibration("pose2sim", tmp_path) == written


def test_the_half_pixel_between_opencv_and_here_is_kept_apart(tmp_path):
    made, path, kind, _ = written_as(tmp_path, "json")
    data = json.loads(path.read_text()) | {"pixel_centre": 0.5}
    path.write_text(json.dumps(data))
    pixels = read_calibration(kind, path)["front"].project(CORNERS)[0]
    np.testing.assert_allclose(made[1].pixels() - pixels, 0.5, atol=1e-6)


@pytest.mark.parametrize(
    "name, file, old, new, message",
    [
        ("easymocap", "extri.yml", "R_left", "R_other", r"extri\.yml: Rot_left: camera 'left' of intri.yml has no pose"),
        ("easymocap", "intri.yml", "names:", "fisheye_model_left: 1\nnames:", r"intri\.yml: camera 'left': .*a fisheye"),
        ("easymocap", "intri.yml", "names:", "fisheye_model_front: 1\nnames:", r"intri\.yml: camera 'front': .*a fisheye"),
        ("easymocap", "intri.yml", "names:", "k4_left: 0.1\nnames:", r"camera 'left': k4: coefficients are read from dist alone"),
        ("easymocap", "intri.yml", "rows: 3", "rows: 1000000000", r"intri\.yml: a matrix of 1000000000 rows"),
        ("easymocap", "intri.yml", "rows: 3", "rows: [", r"intri\.yml: OpenCV cannot read it"),
        ("toml", "Calib.toml", "fisheye = false", "fisheye = true", r"cam_0\.fisheye"),
        ("toml", "Calib.toml", "300.0", "1e9", r"Calib\.toml: camera 'front': 1000000000 x 400 pixels, at most"),
        ("qualisys", "Calib.qca.txt", 'r11="', 'r11="9', r"left: not a rotation"),
        ("qualisys", "Calib.qca.txt", "<calibration>", "<!DOCTYPE a><calibration>", "declares a document type"),
        ("metashape", "cameras.xml", 'type="frame"', 'type="fisheye"', r"camera 'left': a sensor of type 'fisheye'"),
        ("metashape", "cameras.xml", "<k1>", "<k4>0.1</k4><k1>", r"camera 'left': k4 are not zero"),
        ("metashape", "cameras.xml", "<scale>0", "<scale>-0", r"cameras\.xml: transform\.scale: -0\.37, expected a positive"),
        ("metashape", "cameras.xml", "</chunk>", "</chunk><chunk />", r"cameras\.xml: 2 chunks: export one"),
        ("colmap-text", "cameras.txt", "OPENCV", "OPENCV_FISHEYE", r"camera 'left': camera model OPENCV_FISHEYE: a fisheye: such lenses are not read: undistort"),
        ("colmap-text", "images.txt", " 1 left", " 7 left", r"images\.txt: left\.png: no camera 7 in cameras\.txt"),
        ("json", "calibration.json", '"intrinsics"', '"lens"', r"calibration\.json: camera 'left': K is missing"),
        ("json", "calibration.json", '"left"', '"../left"', r"its name cannot be a file's"),
        ("middlebury", "temple_par.txt", "left.png 4", "left.png nan 4", r"temple_par\.txt: line 2: expected finite numbers"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_by_file_and_field(tmp_path, name, file, old, new, message):
    _, path, kind, _ = written_as(tmp_path, name)
    assert old in (tmp_path / file).read_text()
    spoil(tmp_path / file, old, new)
    with pytest.raises(UserError, match=message):
        read_calibration(kind, path)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_a_binary_model_that_is_cut_or_claims_too_much_is_refused(tmp_path, file):
    _, path, kind, _ = written_as(tmp_path, "colmap-binary")
    whole = (tmp_path / file).read_bytes()
    for spoilt in (whole[:-5], struct.pack("<Q", 2**62) + whole[8:], whole[:40]):
        (tmp_path / file).write_bytes(spoilt)
        with pytest.raises(UserError, match=rf"{file}: (ends at byte|a name without|camera model)"):
            read_calibration(kind, path)


def test_a_mirrored_rotation_and_lenses_beyond_five_coefficients_are_refused(tmp_path):
    _, path, kind, _ = written_as(tmp_path, "json")
    data = json.loads(path.read_text())
    data["left"]["R"][0] = [-x for x in data["left"]["R"][0]]
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match="camera 'left': R: a mirrored rotation"):
        read_calibration(kind, path)
    del data["left"]
    data["front"]["dist"] += [0.0, 0.1, 0.0]
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match="camera 'front': distortion .* beyond k1 k2 p1 p2 k3"):
        read_calibration(kind, path)


@pytest.mark.parametrize(
    "field, value, message",
    [
        (
            "model",
            "OPENCV_FISHEYE",
            "model: a fisheye: such lenses are not read: undistort the pictures first, or by --undistort",
        ),
        ("distortion_model", "equidistant", "distortion_model: a fisheye: such lenses are not read"),
        ("fisheye", True, "fisheye: a fisheye: such lenses are not read"),
        ("distortions", [0.1, 0, 0, 0], "distortions: coefficients are read from dist, D, .* alone"),
        ("k1", -0.2, "k1: coefficients are read from dist"),
    ],
)
def test_a_lens_that_is_not_taken_is_refused_and_not_left(tmp_path, field, value, message):
    _, path, kind, _ = written_as(tmp_path, "json")
    data = json.loads(path.read_text())
    harmless = {"fisheye": False, "distortion_model": "plumb_bob", "distance": 3.0, "k1": 0.0, "name": "a"}
    data["left"] |= harmless
    path.write_text(json.dumps(data))
    assert set(read_calibration(kind, path)) == {"a", "front", "cam 3"}
    data["front"] |= {"dist": data["front"]["dist"][:4], field: value}
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match=f"calibration.json: camera 'front': {message}"):
        read_calibration(kind, path)


def test_opencv_s_own_file_of_a_fisheye_lens_is_refused(tmp_path):
    path = write_opencv_files(tmp_path, views())
    spoil(path, "image_width", "fisheye_model: 0\nimage_width")
    assert read_calibration("opencv", path)
    spoil(path, "fisheye_model: 0", "fisheye_model: 1")
    with pytest.raises(
        UserError, match=r"left\.yml: distortion: 5 numbers, a fisheye \(fisheye_model\) has k1 k2 k3 k4"
    ):
        read_calibration("opencv", path)
    storage(path, {"camera_matrix": np.eye(3), "D": np.zeros(4), "R": np.eye(3), "T": np.ones(3), "fisheye_model": 1})
    with pytest.raises(
        UserError, match=r"left\.yml: camera 'left': fisheye_model: a fisheye: such lenses are not read"
    ):
        read_calibration("opencv", path)


def test_a_camera_that_stands_twice_in_a_json_is_refused(tmp_path):
    _, path, kind, _ = written_as(tmp_path, "json")
    spoil(path, '"front"', '"left"')
    with pytest.raises(UserError, match=r"calibration\.json: not JSON: 'left' stands twice in one object"):
        read_calibration(kind, path)


@pytest.mark.parametrize("word", ["RT", "camera_to_world"])
def test_a_pose_whose_translation_lies_in_its_last_row_is_refused(tmp_path, word):
    _, path, kind, _ = written_as(tmp_path, "json")
    data, T = json.loads(path.read_text()), np.eye(4)
    T[3, :3] = 0.1, 0.2, 3.0
    data["left"] = {k: v for k, v in data["left"].items() if k not in ("R", "t")} | {word: T.tolist()}
    path.write_text(json.dumps(data))
    with pytest.raises(UserError, match=rf"camera 'left': {word}: its last row is \[0.1, 0.2, 3.0, 1.0\].*transposed"):
        read_calibration(kind, path)


def test_a_colmap_text_whose_lines_of_points_are_missing_is_refused(tmp_path):
    _, path, kind, _ = written_as(tmp_path, "colmap-text")
    images = tmp_path / "images.txt"
    kept = [line for line in images.read_text().split("\n") if line.strip()]
    images.write_text("\n".join(kept) + "\n")
    with pytest.raises(UserError, match=r"images\.txt: line \d+: not X Y POINT3D_ID"):
        read_calibration(kind, path)


def test_a_folder_without_the_calibration_or_with_two_is_refused(tmp_path):
    with pytest.raises(UserError, match="no calibration of kind 'qualisys'"):
        find_calibration("qualisys", tmp_path)
    for name in ("a.toml", "b.toml"):
        (tmp_path / name).write_text("")
    with pytest.raises(UserError, match="a.toml and b.toml may both be the calibration"):
        find_calibration("pose2sim", tmp_path)
    with pytest.raises(UserError, match="no camera in it"):
        read_calibration("pose2sim", tmp_path / "a.toml")
    assert set(KINDS) == {kind for _, kind, _, _ in FORMATS.values()}


def test_real_calibrations_are_read(shared_data):
    cameras = read_calibration("lists", shared_data / "middlebury_temple" / "templeSR_par.txt")
    assert len(cameras) == 16
    inside = np.array([[-0.073568, 0.021728, -0.012445], [0.028855, 0.181892, 0.062736]])  # bounding box of README.txt
    pixels = np.stack([camera.project(inside.mean(0))[0] for camera in cameras.values()])
    assert (np.abs(pixels - [320, 240]) < 60).all()  # in the middle of every picture
    path = find_calibration("qualisys", shared_data / "pose2sim_calibrated_video")
    found = read_calibration("qualisys", path)
    assert [camera.size for camera in found.values()] == [(1920, 1088)] * 4
