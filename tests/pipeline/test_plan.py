"""`toile plan`: the stages that a capture asks for, whichever parts it lacks."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from toile.cli import app
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.pipeline.plan import plan

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def capture(tmp_path):
    return shutil.copytree(SAMPLE, tmp_path / "capture", ignore=shutil.ignore_patterns("truth", "00000[2-9]"))


def steps(capture):
    return {step.stage: step for step in plan(open_capture(capture))}


def spoil(frame):
    (frame / "scan.ply").write_text("no mesh")


def test_a_later_frame_without_a_scan_asks_for_one(capture):
    assert not steps(capture)["stereo"].runs
    (capture / "frames" / "000001" / "scan.ply").unlink()
    stereo = steps(capture)["stereo"]
    assert stereo.runs and stereo.why == "frame 1: no scan.ply; pictures with masks or labels"


def test_labels_of_a_later_frame_are_labels_and_their_lack_is_said(capture):
    shutil.rmtree(capture / "frames" / "000000" / "labels")
    assert steps(capture)["segment"].why.endswith("; labels/*.png")
    shutil.rmtree(capture / "frames" / "000001" / "labels")
    assert "no labels/*.png, no label of scan.ply, no [scene] segmenter" in steps(capture)["segment"].why


def test_a_face_is_no_stage_where_no_keypoint_is_facial(capture):
    assert steps(capture)["face"].runs
    for frame in (capture / "frames").iterdir():
        (frame / "keypoints.json").unlink()
    face = steps(capture)["face"]
    assert not face.runs and "no face.*" in face.why


def test_a_bad_first_frame_hides_no_plan_and_bad_frames_alone_are_refused(capture):
    whole = steps(capture)
    spoil(capture / "frames" / "000000")
    assert steps(capture) == whole
    spoil(capture / "frames" / "000001")
    with pytest.raises(UserError, match="000000/scan.ply"):
        plan(open_capture(capture))


def test_one_camera_triangulates_nothing_and_gives_no_look_by_view(capture):
    assert steps(capture)["reconstruct"].runs and steps(capture)["view"].runs
    file = capture / "cameras.json"
    cameras = json.loads(file.read_text())["cameras"]
    file.write_text(json.dumps({"cameras": cameras[:1]}))
    for frame in (capture / "frames").iterdir():
        keypoints = json.loads((frame / "keypoints.json").read_text())
        first = {name: rows for name, rows in keypoints["points"].items() if name == cameras[0]["name"]}
        (frame / "keypoints.json").write_text(json.dumps(keypoints | {"points": first}))
        for path in [path for kind in ("images", "masks", "labels") for path in (frame / kind).glob("*")]:
            if path.stem != cameras[0]["name"]:
                path.unlink()
    found = steps(capture)
    assert not found["reconstruct"].runs and found["reconstruct"].why == "keypoints.json of one camera alone"
    assert not found["view"].runs and found["view"].why == "one camera in cameras.json"


def test_smoothing_is_a_stage_where_frames_follow_one_another(capture):
    assert steps(capture)["motion"].runs
    shutil.rmtree(capture / "frames" / "000001")
    assert not steps(capture)["motion"].runs


@pytest.mark.parametrize("command", [["plan"], ["register", "run", "--check"]], ids=" ".join)
def test_frames_and_folders_of_names_that_are_not_read_are_said_before_a_run(capture, command):
    told = lambda: CliRunner().invoke(app, [command[0], str(capture), *command[1:]]).stderr
    assert "not read" not in told()
    frames = capture / "frames"
    (frames / "000001").rename(frames / "12")
    (frames / "000000" / "images").rename(frames / "000000" / "Images")
    assert [line.split(": ", 1)[1] for line in told().splitlines() if "not read" in line] == [
        "frames: 1 folders such as frames/12 are not read; six digits: frames/000012",
        "frames/000000/Images: not read, expected images",
    ]
