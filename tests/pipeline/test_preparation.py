"""What preparing says of the sampled frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toile.config import preset
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.status import Status
from toile.pipeline.preparation import _said, _said_of_scans, _say
from toile.scene import Frame, Mesh, Person, Tracked

MODEL = load_body_model()
PERSON = Person(np.zeros(0), MODEL.v_template, MODEL.J)


def sample(turn=(0, 0, 0), faces=MODEL.skin_faces):
    """A frame whose scan is the body at rest, turned as a whole, and how it was tracked."""
    R = Rotation.from_rotvec(turn)
    rotations = np.zeros((len(MODEL.J), 3))
    rotations[0] = turn
    scan = Mesh(R.apply(MODEL.v_template), faces)
    tracked = Tracked(scan.vertices, rotations, np.zeros(3), np.zeros((0, 3)), np.zeros(len(scan.vertices)), {})
    return Frame(number=3, scan=scan), tracked


def said(*samples, up="z"):
    frames, tracked = zip(*samples, strict=True)
    return _said_of_scans(MODEL, PERSON, up, [(frame,) for frame in frames], tracked)


def test_nothing_is_said_of_a_body_that_stands_up_however_it_turns():
    assert said(sample(), sample((0, 0, 2.0)), sample((0.5, 0, 0))) == []


def test_a_body_that_stands_along_another_axis_than_the_scene_s_is_named():
    assert said(sample(), up="y") == ['up: the person stands along z: [scene] up = "z", not "y"']
    (lying,) = said(sample((np.pi / 2, 0, 0)))
    assert lying.startswith("up: the person stands")


def test_scans_that_look_inwards_are_named():
    (found,) = said(sample(), sample(faces=MODEL.skin_faces[:, ::-1]))
    assert found.startswith("scan.ply of frame 3: 100 % of its faces look inwards")


def test_pictures_exchanged_between_two_cameras_are_said():
    capture = open_capture(Path(__file__).parents[2] / "data_samples" / "tshirt-talk")
    shown = [capture.pictures(number) for number in (0, 5)]
    other = {"cam00": "cam03", "cam03": "cam00"}
    images = [{name: frame.images[other.get(name, name)] for name in frame.images} for frame in shown]
    told = lambda frames: [
        text
        for text in _said(
            capture.scene, MODEL, capture.cameras, [(f, sample()[1]) for f in frames], None, preset("draft")
        )
        if "were they exchanged" in text
    ]
    assert told(shown) == []
    assert len(told([replace(frame, images=of) for frame, of in zip(shown, images)])) == 2


def test_what_a_stage_warned_of_gives_way_to_what_it_warns_of_now(tmp_path):
    status = Status.of(tmp_path)
    _say(status, "prepare", ["one", "two"])
    _say(status, "dress", ["three"])
    _say(status, "prepare", ["four"])
    assert status.warnings() == ["three", "four"]
