"""`toile detect`: programs and what they leave, views that disagree, and what is never run."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from tests.support.rig import ring_of_cameras
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.image import write_image
from toile.io.keypoints import read_keypoints
from toile.io.skeletons import SKELETONS, rows_of
from toile.pipeline.commands.pictures import detector_of
from toile.pipeline.detect import confirmed, detect
from toile.scene import Keypoints
from toile.surface.keypoints import mirrored
from toile.vision.detectors.program import Program, its_own

SAMPLE = Path(__file__).parents[3] / "data_samples" / "tshirt-talk"
WRITER = """
import json, sys
from pathlib import Path
for pictures, out in zip(sys.argv[1::2], sys.argv[2::2]):
    {body}
"""
COPIES = "(Path(out) / 'keypoints.json').write_text((Path(pictures).parent / 'kept.json').read_text())"


@pytest.fixture
def capture(tmp_path):
    """The sample with its keypoints put aside as kept.json."""
    root = shutil.copytree(SAMPLE, tmp_path / "capture")
    for file in sorted(root.glob("frames/*/keypoints.json")):
        file.rename(file.with_name("kept.json"))
    return root


def program(tmp_path, body):
    path = tmp_path / "program.py"
    path.write_text(WRITER.format(body=body))
    return Program(f"{sys.executable} {path}")


def test_a_program_gets_folders_and_its_files_become_the_frames(capture, tmp_path):
    opened = open_capture(capture)
    said = detect(opened, program(tmp_path, COPIES), opened.frames)
    assert said.written == opened.frames and not said.kept
    for number in opened.frames:
        kept = read_keypoints(opened.folder(number) / "kept.json", opened.cameras)
        found = read_keypoints(opened.folder(number) / "keypoints.json", opened.cameras)
        assert found.names == kept.names
        for name, rows in kept.points.items():
            assert np.abs(found.points[name][:, :2] - rows[:, :2]).max() <= 0.006


def test_frames_that_have_keypoints_are_left_alone_until_again(capture, tmp_path):
    opened = open_capture(capture)
    detect(opened, program(tmp_path, COPIES), opened.frames[:1])
    broken = program(tmp_path, "sys.exit('it ran')")
    assert detect(opened, broken, opened.frames[:1]).kept == opened.frames[:1]
    with pytest.raises(UserError, match="exit code 1: it ran"):
        detect(opened, broken, opened.frames[:1], again=True)


@pytest.mark.parametrize(
    "body, said",
    [
        ("pass", "--detector: what '.*' left of .*/frames/000000/images: keypoints.json: the file is missing"),
        ("(Path(out) / 'keypoints.json').write_text('[')", "keypoints.json: not JSON"),
        ('(Path(out) / \'keypoints.json\').write_text(\'{"names": [], "points": {"x": []}}\')', "points.x: no such"),
        ("raise SystemExit(3)", "exit code 3: it says nothing"),
    ],
)
def test_what_a_program_leaves_wrong_is_named_and_nothing_is_written(capture, tmp_path, body, said):
    opened = open_capture(capture)
    with pytest.raises(UserError, match=said):
        detect(opened, program(tmp_path, body), opened.frames)
    assert not list(capture.glob("frames/*/keypoints.json"))


MEDIAPIPE = """
from types import SimpleNamespace as Space
import numpy

class Holistic:
    __init__ = lambda self, **_: None
    __enter__ = lambda self: self
    __exit__ = lambda self, *_: None

    def process(self, picture):
        seen = picture[..., 1] > 100
        at = numpy.argwhere(seen)[0] / seen.shape
        marks = Space(landmark=[Space(x=at[1], y=at[0], visibility=1.0)] * 33)
        other = dict.fromkeys(("face_landmarks", "left_hand_landmarks", "right_hand_landmarks"))
        return Space(pose_landmarks=marks, segmentation_mask=1.0 * seen, **other)

solutions = Space(holistic=Space(Holistic=Holistic))
"""


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_looked_at_as_they_are_stored_however_their_headers_turn_them(tmp_path, monkeypatch, orientation):
    (tmp_path / "mediapipe.py").write_text(MEDIAPIPE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (camera,) = (replace(c, name="cam", width=48, height=32) for c in ring_of_cameras(1).values())
    pixels, header = np.zeros((32, 48, 3), np.uint8), Image.Exif()
    pixels[8:16, 32:40], header[ExifTags.Base.Orientation] = 255, orientation
    (tmp_path / "images").mkdir()
    Image.fromarray(pixels).save(tmp_path / "images" / "cam.jpg", quality=100, exif=header)
    (found,) = its_own(Path(sys.executable)).detect([tmp_path / "images"], {"cam": camera})
    assert np.abs(found.keypoints.points["cam"][0, :2] - [32, 8]).max() <= 1
    assert found.masks["cam"][9:15, 33:39].all() and found.masks["cam"].sum() < 120


def test_pictures_that_ask_to_be_turned_are_said(capture, tmp_path):
    header = Image.Exif()
    header[ExifTags.Base.Orientation] = 6
    path = min(capture.glob("frames/000000/images/*"))
    Image.open(path).convert("RGB").save(path, "JPEG", exif=header)
    opened = open_capture(capture)
    (said,) = detect(opened, program(tmp_path, COPIES), opened.frames[:1]).warnings
    assert said.startswith(f"{path.stem}: their pictures ask to be turned (EXIF)")


@pytest.mark.parametrize("command, said", [("", "no command"), ("/no/such", "cannot be run"), ('"', "quotation")])
def test_a_command_that_is_none_is_refused(capture, command, said):
    opened = open_capture(capture)
    with pytest.raises(UserError, match=said):
        detect(opened, Program(command), opened.frames)


def test_keypoints_are_the_same_by_one_process_and_by_two_workers(capture, tmp_path):
    found, opened = [], open_capture(capture)
    detector = program(tmp_path, COPIES)
    detector.at_once = 1
    for workers in (1, 2):
        said = detect(opened, detector, opened.frames, True, workers=workers)
        assert said.written == opened.frames
        found.append([(opened.folder(number) / "keypoints.json").read_bytes() for number in opened.frames])
    assert found[0] == found[1] and len(found[0]) > 1


def test_a_command_is_never_run_by_a_shell_nor_taken_from_a_capture(capture, tmp_path):
    opened = open_capture(capture)
    with pytest.raises(UserError):
        detect(opened, Program(f"true; touch {tmp_path}/run"), opened.frames[:1])
    assert not (tmp_path / "run").exists()
    scene = capture / "scene.toml"
    scene.write_text(scene.read_text().replace("[scene]", f'[scene]\nkeypoints = "touch {tmp_path}/run"'))
    with pytest.raises(UserError, match="scene.keypoints: .* a program is never taken from a capture"):
        open_capture(capture)
    scene.write_text(scene.read_text().replace("keypoints = ", "detector = ", 1))
    with pytest.raises(UserError, match="scene.toml: scene.detector"):
        open_capture(capture)


def test_without_any_detector_the_line_says_how_to_get_one(capture, monkeypatch):
    monkeypatch.setattr(sys, "prefix", str(capture))
    with pytest.raises(UserError, match="make detector"):
        detector_of(open_capture(capture), None, None)


def seen_by(cameras, X):
    names = tuple(rows_of("halpe26"))
    return Keypoints(names, {n: np.column_stack([c.project(X)[0], np.ones(len(X))]) for n, c in cameras.items()})


@pytest.fixture
def person():
    return np.random.default_rng(0).uniform([-0.4, -0.2, 0], [0.4, 0.2, 1.8], (len(rows_of("halpe26")), 3))


def test_nobody_and_somebody_else_are_said_and_not_used(person):
    cameras = ring_of_cameras(6)
    keypoints = seen_by(cameras, person)
    assert confirmed(keypoints, cameras)[1] == []
    keypoints.points["cam3"] = seen_by(cameras, person + [0.8, 0.8, 0]).points["cam3"]
    left, said = confirmed(keypoints, cameras)
    assert len(said) == 1 and said[0].startswith("cam3: other views confirm")
    assert (left.points["cam3"][:, 2] == 0).all() and (left.points["cam2"][:, 2] == 1).all()
    nobody = Keypoints(keypoints.names, {n: 0 * rows for n, rows in keypoints.points.items()})
    assert confirmed(nobody, cameras)[1] == ["nobody was found in any picture"]


def test_points_in_space_that_win_and_a_camera_alone_are_said(capture, tmp_path):
    opened = open_capture(capture)
    (opened.folder(opened.frames[1]) / "keypoints3d.json").write_text("{}")
    (said,) = detect(opened, program(tmp_path, COPIES), opened.frames).warnings
    assert said.startswith(f"frames {opened.frames[1]}: keypoints3d.json")
    name, camera = next(iter(opened.cameras.items()))
    for path in (opened.folder(opened.frames[0]) / "images").iterdir():
        if path.stem != name:
            path.unlink()
    kept = json.loads((opened.folder(opened.frames[0]) / "kept.json").read_text())
    kept["points"] = {name: kept["points"][name]}
    (opened.folder(opened.frames[0]) / "kept.json").write_text(json.dumps(kept))
    alone = replace(opened, cameras={name: camera})
    assert any(
        "one camera" in said for said in detect(alone, program(tmp_path, COPIES), opened.frames[:1], True).warnings
    )


def test_what_one_view_alone_of_several_sees_is_not_used(person):
    """A mirror, a poster, a dog: a detection that no other view confirms puts no body into the air."""
    cameras = ring_of_cameras(6)
    keypoints = seen_by(cameras, person)
    alone = Keypoints(keypoints.names, {"cam0": keypoints.points["cam0"]})
    left, said = confirmed(alone, cameras)
    assert (left.points["cam0"][:, 2] == 0).all() and len(said) == 1


def test_every_table_names_points_of_the_body_model_and_both_sides(body_model=None):
    from toile.io.body import load_body_model

    known = set(load_body_model("anny").keypoint_names)
    for rows in map(rows_of, SKELETONS):
        assert set(rows) <= known and len(set(rows.values())) == len(rows)
        assert {mirrored(name) for name in rows} == set(rows)


def test_pictures_that_are_none_or_of_another_size_are_refused_before_anything_is_run(capture, tmp_path):
    opened, never = open_capture(capture), Program(f"touch {tmp_path}/run")
    name, camera = next(iter(opened.cameras.items()))
    folder = opened.folder(opened.frames[0]) / "images"
    shutil.rmtree(folder)
    with pytest.raises(UserError, match="images: no pictures"):
        detect(opened, never, opened.frames)
    write_image(folder / f"{name}.png", np.zeros((camera.size[0], camera.size[1] + 8, 3), np.uint8))
    with pytest.raises(UserError, match="cameras.json says"):
        detect(opened, never, opened.frames)
    (folder / f"{name}.png").write_text("no picture")
    with pytest.raises(UserError, match="cannot be read as a PNG or JPEG"):
        detect(opened, never, opened.frames)
    assert not (tmp_path / "run").exists()


def test_masks_that_are_there_stay(capture, tmp_path):
    opened = open_capture(capture)
    number = opened.frames[0]
    name, camera = next(iter(opened.cameras.items()))
    mask = opened.folder(number) / "masks" / f"{name}.png"
    before = mask.read_bytes() if mask.exists() else None
    if before is None:
        write_image(mask, np.full(camera.size, 255, np.uint8))
        before = mask.read_bytes()
    import_image = f"from PIL import Image; (Path(out) / 'masks').mkdir(); Image.new('L', {camera.size[::-1]}).save"
    body = f"{COPIES}\n    {import_image}(Path(out) / 'masks' / '{name}.png')"
    detect(opened, program(tmp_path, body), [number])
    assert mask.read_bytes() == before
    assert json.loads((opened.folder(number) / "keypoints.json").read_text())["names"]
