"""A calibration and the files about it become a capture: found by how they are called, linked, whole or not at all."""

import json
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from unicodedata import normalize

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.io.test_calibrations import write_json, write_toml
from tests.support.cube import check, views
from toile.cli import app
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.importing import cameras_json, up_of, write_capture
from toile.io.openpose import read_person
from toile.io.places import place
from toile.io.rig import Options, chosen, read_rig
from toile.io.skeletons import SKELETONS

LAYOUTS = {  # of a camera's frame
    "camera folders": "images/{camera}/{number:06d}.jpg",
    "frame folders, unpadded": "images/{number}/{camera}.jpg",
    "one folder": "images/{camera}_{number:04d}.jpg",
    "beside the calibration": "{camera}/img_{number}.jpg",
    "words between": "rgbs/{camera}/{camera}_rgb{number:06d}.jpg",
}


def save(path, size, value=90, mode="RGB"):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size, (value, 0, 0) if mode == "RGB" else value).save(path)


def rig(folder, layout="images/{camera}/{number:06d}.jpg", numbers=(0, 2, 10)):
    made = views()
    folder.mkdir(exist_ok=True)
    write_json(folder, made)
    for v in made:
        for number in numbers:
            save(folder / layout.format(camera=v.name, number=number), (v.width, v.height), 10 + number)
    return made


def imported(folder, out, **options):
    return write_capture(read_rig("lists", folder, Options(up="z", **options)), out, "test")


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
    theirs, ours = (tmp_path / "their").rglob("*.jpg"), (tmp_path / "ours").rglob("*.jpg")
    assert {p.stat().st_ino for p in ours} == {p.stat().st_ino for p in theirs}  # not a byte was copied


def test_masks_scans_units_and_offsets_arrive(tmp_path):
    from toile.io.mesh import write_mesh
    from toile.scene import Mesh

    made = rig(tmp_path / "their", numbers=(0, 1, 2, 3, 4))
    for v in made:
        save(tmp_path / "their" / "masks" / v.name / "2.png", (v.width, v.height), 255)  # in colour
    triangle = Mesh(np.array([[0, 0, 0], [0, 0, 1700.0], [100, 0, 0]]), np.array([[0, 1, 2]]))
    write_mesh(tmp_path / "their" / "scans" / "mesh_000001.obj", triangle)
    imported(tmp_path / "their", tmp_path / "ours", units="mm", offsets={"left": 2})
    capture = open_capture(tmp_path / "ours")
    check(capture.cameras, made, metres=1000, within=1e-3)
    first = capture.frame(0)
    assert int(first.images["left"][0, 0, 0]) - int(first.images["front"][0, 0, 0]) == 2  # its third picture
    assert capture.frame(0).masks["left"].all() and capture.frame(2).masks["front"].all()
    np.testing.assert_allclose(np.ptp(capture.frame(1).scan.vertices, axis=0), [0.1, 0, 1.7], atol=1e-6)


def test_pictures_before_frame_0_are_said(tmp_path):
    rig(tmp_path)
    found = read_rig("lists", tmp_path, Options(offsets={"left": 99, "front": 1}))
    assert "left: images before frame 0, as --offset says: 1 of front, 3 of left" in found.notes


def in_palette(mask):
    image = Image.fromarray((mask > 0).astype(np.uint8)).convert("P")
    image.putpalette([20, 0, 0, 200, 255, 0])
    return image


SAVED = {  # ways in which a mask of 0 and 255 is saved
    "in colour": lambda mask: Image.fromarray(np.dstack([0 * mask, mask, mask])),
    "in colour and opaque": lambda mask: Image.fromarray(np.dstack([mask, mask, mask, 0 * mask + 255])),
    "in a palette": in_palette,
    "as a picture's alpha": lambda mask: Image.fromarray(np.dstack([255 - mask // 2, mask, 0 * mask + 90, mask])),
    "as alpha of grey": lambda mask: Image.fromarray(np.dstack([0 * mask + 255, mask])),
}


@pytest.mark.parametrize("way", SAVED)
def test_a_mask_is_the_same_in_whatever_way_it_was_saved(tmp_path, way):
    for v in rig(tmp_path / "their", numbers=(0,)):
        mask = np.zeros((v.height, v.width), np.uint8)
        mask[10:40, 20:50] = 255
        path = tmp_path / "their" / "masks" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        SAVED[way](mask).save(path)
    imported(tmp_path / "their", tmp_path / "ours")
    for mask in open_capture(tmp_path / "ours").frame(0).masks.values():
        assert mask[10:40, 20:50].all() and mask.sum() == 900


def test_masks_of_0_and_1_are_refused_by_name_but_not_an_empty_one_among_others(tmp_path):
    made = rig(tmp_path / "their", numbers=(0,))
    for v in made:
        save(tmp_path / "their" / "masks" / v.name / "0.png", (v.width, v.height), 1, "L")
    with pytest.raises(UserError, match=r"masks.*0\.png: a mask of 0 and 1, expected 0 and 255"):
        imported(tmp_path / "their", tmp_path / "ours")
    save(tmp_path / "their" / "masks" / made[0].name / "0.png", (made[0].width, made[0].height), 255, "L")
    imported(tmp_path / "their", tmp_path / "ours")


def test_masks_in_jpeg_arrive_and_labels_in_jpeg_are_refused_by_name(tmp_path):
    for v in rig(tmp_path / "their", numbers=(0,)):
        mask = np.zeros((v.height, v.width), np.uint8)
        mask[16:48, 24:56] = 255
        for kind in ("masks", "labels"):
            path = tmp_path / "their" / kind / v.name / "0.jpg"
            path.parent.mkdir(parents=True)
            Image.fromarray(mask).save(path, quality=60)
    with pytest.raises(
        UserError, match=r"labels/cam 3/0\.jpg: a JPEG, which changes label ids at their borders: expected a PNG"
    ):
        imported(tmp_path / "their", tmp_path / "ours")
    (tmp_path / "their" / "labels").rename(tmp_path / "their" / "videos")
    imported(tmp_path / "their", tmp_path / "ours")
    for mask in open_capture(tmp_path / "ours").frame(0).masks.values():
        assert mask[16:48, 24:56].all() and mask.sum() == 32 * 32


@pytest.mark.parametrize("mode", ["RGB", "LA"])
def test_label_images_of_several_channels_are_refused_when_imported(tmp_path, mode):
    for v in rig(tmp_path / "their", numbers=(0,)):
        path = tmp_path / "their" / "labels" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        Image.new(mode, (v.width, v.height)).save(path)
    with pytest.raises(UserError, match=rf"labels/cam 3/0\.png: mode {mode}, expected one channel of 8 bits"):
        imported(tmp_path / "their", tmp_path / "ours")


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


def test_pictures_of_films_are_decoded_with_their_offset(tmp_path):
    pytest.importorskip("av")
    from toile.io.video import VideoWriter

    made = views()
    (tmp_path / "their").mkdir()
    write_json(tmp_path / "their", made)
    for v in made:
        with VideoWriter(tmp_path / "their" / "videos" / f"{v.name}.mp4", 30) as film:
            for i in range(6):
                film.add(np.full((v.height, v.width, 3), 20 + 30 * i, np.uint8))
    imported(tmp_path / "their", tmp_path / "ours", offsets={"front": 2})
    capture = open_capture(tmp_path / "ours")
    assert capture.frames == (0, 1, 2, 3, 4, 5) and capture.scene.fps == 30
    images = capture.frame(1).images
    assert {name: round((int(image.mean()) - 20) / 30) for name, image in images.items()} == {
        "left": 1, "front": 3, "cam 3": 1,
    }  # fmt: skip
    assert "front" not in capture.frame(5).images


def film(path, view, times, rate=30):
    """A film of a picture at each of `times` [1/rate s]."""
    import av

    path.parent.mkdir(exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        for time in times:
            picture = av.VideoFrame.from_ndarray(np.full((view.height, view.width, 3), time, np.uint8), "rgb24")
            picture.pts = time
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def test_a_film_that_dropped_pictures_or_ends_early_says_so(tmp_path):
    pytest.importorskip("av")
    made = views()
    write_json(tmp_path, made)
    times = {"left": range(9), "front": [0, 1, 2, 5, 6, 7, 8, 10, 11], made[2].name: range(6)}
    for v in made:
        film(tmp_path / "videos" / f"{v.name}.mp4", v, times[v.name])
    notes = imported(tmp_path, tmp_path / "ours", fps=30.0).notes
    said = [note for note in notes if ".mp4" in note]
    assert said == [
        "front.mp4: lacks 3 pictures by its times: from picture 3 on it is out of step",
        f"{made[2].name}.mp4: no pictures of 3 frames: 6-8",
    ]
    assert all(f"# {line}\n" in (tmp_path / "ours" / "scene.toml").read_text() for line in said)


def test_a_film_without_a_picture_is_refused(tmp_path):
    pytest.importorskip("av")
    made = views()
    write_json(tmp_path, made)
    for v in made:
        film(tmp_path / "videos" / f"{v.name}.mkv", v, range(3))
    path = tmp_path / "videos" / "left.mkv"
    path.write_bytes(path.read_bytes()[:700])
    with pytest.raises(UserError, match=r"videos/left\.mkv: no picture in it"):
        imported(tmp_path, tmp_path / "ours", fps=30.0)
    assert not (tmp_path / "ours").exists()


def test_frames_follow_as_fast_as_those_of_the_films(tmp_path):
    pytest.importorskip("av")
    from toile.io.video import VideoWriter

    made = views()
    write_json(tmp_path, made)

    def filmed(*rates):
        for v, rate in zip(made, rates):
            with VideoWriter(tmp_path / "videos" / f"{v.name}.mp4", rate) as film:
                for _ in range(6):
                    film.add(np.zeros((v.height, v.width, 3), np.uint8))

    filmed(60, 60, 60)
    found = read_rig("lists", tmp_path, Options())
    assert found.fps == 60 and "frames a second: 60" in found.notes
    filmed(60, 25)
    with pytest.raises(UserError, match=r"left.mp4 has 60 .*|.*.mp4 has 25 pictures a second, .*mp4 60: .* --fps"):
        read_rig("lists", tmp_path, Options())
    assert read_rig("lists", tmp_path, Options(fps=50.0)).fps == 50
    rig(tmp_path / "pictures")
    silent = read_rig("lists", tmp_path / "pictures", Options())
    assert silent.fps == 30 and "frames a second: 30 (assumed, give them by --fps)" in silent.notes


def test_cameras_without_distortion_are_named(tmp_path):
    made = rig(tmp_path)
    words = lambda: [note for note in read_rig("lists", tmp_path, Options()).notes if note.startswith("distortion")]
    assert words() == []
    straight = views(distorted=False)
    write_json(tmp_path, [*straight[:1], *made[1:]])
    assert words() == [f"distortion: none of {made[0].name}: such pictures are taken as they are"]
    write_json(tmp_path, straight)
    assert words() == ["distortion: none of any camera: such pictures are taken as they are"]


def test_the_confidence_of_a_scan_is_kept_in_other_units(tmp_path):
    from toile.io.mesh import write_mesh
    from toile.scene import Mesh

    rig(tmp_path / "their", numbers=(0,))
    corners, confidence = np.array([[0, 0, 0], [0, 0, 1700.0], [100, 0, 0]]), np.array([1.0, 0.0, 0.5])
    write_mesh(tmp_path / "their" / "scans" / "0.ply", Mesh(corners, np.array([[0, 1, 2]]), confidence=confidence))
    imported(tmp_path / "their", tmp_path / "ours", units="mm")
    scan = open_capture(tmp_path / "ours").frame(0).scan
    assert np.allclose(scan.confidence, confidence, atol=1e-6) and np.allclose(scan.vertices[1], [0, 0, 1.7])


@pytest.mark.parametrize("forms", [("NFC", "NFD"), ("NFD", "NFC")])
def test_a_camera_s_name_is_the_same_in_either_form_of_its_accents(tmp_path, forms):
    of_calibration, of_folder = (normalize(form, "Kamera Süd") for form in forms)
    write_json(tmp_path, [replace(views()[0], name=of_calibration), *views()[1:]])
    for v, name in zip(views(), (of_folder, *(v.name for v in views()[1:]))):
        save(tmp_path / "images" / name / "3.jpg", (v.width, v.height))
    imported(tmp_path, tmp_path / "ours")
    assert set(open_capture(tmp_path / "ours").frame(3).images) == {"Kamera Süd", "front", "cam 3"}


@pytest.mark.parametrize("ending", ["ply", "obj", "off", "stl"])
def test_scans_of_every_ending_arrive_and_those_of_other_frames_are_said(tmp_path, ending):
    import trimesh

    rig(tmp_path, numbers=(1, 2, 3))
    (tmp_path / "scans").mkdir()
    for number in (0, 1, 2):
        trimesh.creation.box((0.5, 0.4, 1.7)).export(tmp_path / "scans" / f"body{number:04d}.{ending}")
    found = imported(tmp_path, tmp_path / "ours")
    assert "left: 1 scans of other frames: 0" in found.notes
    scan = open_capture(tmp_path / "ours").frame(2).scan
    np.testing.assert_allclose(np.ptp(scan.vertices, axis=0), [0.5, 0.4, 1.7], atol=1e-6)


def test_scans_of_no_frame_are_refused_with_the_numbers_of_both(tmp_path):
    rig(tmp_path, numbers=(1, 2, 3))
    (tmp_path / "scans").mkdir()
    with pytest.raises(UserError, match=r"scans: no scan of the frames 1-3: no \.ply, .* with a number"):
        read_rig("lists", tmp_path, Options())
    (tmp_path / "scans" / "body101.ply").write_bytes(b"")
    with pytest.raises(UserError, match=r"scans: no scan of the frames 1-3: its numbers are 101"):
        read_rig("lists", tmp_path, Options())


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


@pytest.mark.parametrize(
    "path, camera, number",
    [
        ("cam1/000012.jpg", "cam1", 12), ("12/cam10.jpg", "cam10", 12), ("cam1.0003.json", "cam1", 3),
        ("cam10_json/cam10_000007_keypoints.json", "cam10", 7), ("000002_cam1.png", "cam1", 2), ("cam1.png", "cam1", 0),
        ("cam100/3.jpg", None, 0), ("xcam1/3.jpg", None, 0), ("cam1_12-30-05.png", "cam1", 0), ("cam1_12h30m05.png", "cam1", 0),
        ("cam1_20261128_123005.png", "cam1", 0), ("cam1_2026-11-28T123005.123.png", "cam1", 0), ("cam1_12-30-05_000012.png", "cam1", 12),
        ("12_30_05/cam1/7.png", "cam1", 7), ("cam1_12-30-65.png", "cam1", 65), ("cam1_012-030-005.png", "cam1", 5),
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
