"""What preparing says of the sampled frames."""

import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.shapes import sphere
from toile.config import preset
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.status import Status
from toile.pipeline.preparation import _fitted, _said, _said_of_masks, _said_of_scans, _say
from toile.scene import Frame, Mesh, Person, Points3D, Tracked
from toile.stages.track import Unmatched
from toile.vision.thin_pictures import thin_pictures

MODEL = load_body_model()
PERSON = Person(np.zeros(0), MODEL.v_template, MODEL.J)
SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


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


@pytest.mark.parametrize("side", (2048, 150))
def test_mirrored_scans_are_said_however_far_pictures_are_thinned(side):
    capture = open_capture(SAMPLE)
    frame = thin_pictures(capture.frame(0), side)
    mirrored = Mesh(frame.scan.vertices * [-1, 1, 1], frame.scan.faces[:, ::-1].copy())
    config = preset("draft").model_copy(update={"picture_side": side})
    (found,) = _said_of_masks(capture, config, [replace(frame, scan=mirrored)])
    assert found.startswith("scans: mirrored along x they fit the masks better")


@pytest.mark.parametrize("kind", ["masks", "labels"])
def test_mirrored_scans_and_bent_lenses_are_said_without_garments_whose_samples_hold_no_pictures(kind, tmp_path):
    shutil.copytree(SAMPLE, tmp_path / "bare", ignore=shutil.ignore_patterns("masks" if kind == "labels" else "labels"))
    text = (tmp_path / "bare" / "scene.toml").read_text()
    (tmp_path / "bare" / "scene.toml").write_text(text[: text.index("[[garment]]")] + text[text.index("[cameras]") :])
    capture, config = open_capture(tmp_path / "bare"), preset("draft")
    frames = [Frame(n, capture.scan(n)) for n in (0, 2, 3, 5)]
    assert _said_of_masks(capture, config, frames) == []
    mirrored = [replace(f, scan=Mesh(f.scan.vertices * [-1, 1, 1], f.scan.faces[:, ::-1].copy())) for f in frames]
    (found,) = _said_of_masks(capture, config, mirrored)
    assert found.startswith("scans: mirrored along x") and ("masks" if kind == "masks" else "label images") in found
    bent = {name: replace(c, distortion=c.distortion - 0.2 * np.eye(5)[0]) for name, c in capture.cameras.items()}
    (found,) = _said_of_masks(replace(capture, cameras=bent), config, frames)
    assert found.startswith("scans: they fit") and "distortion" in found


def standing(number, lost=False):
    """A frame whose keypoints show the body at rest, as does its scan, unless that is a ball metres away."""
    names, n = MODEL.keypoint_names, len(MODEL.keypoint_names)
    points = Points3D(names, MODEL.keypoints(MODEL.v_template, MODEL.J), np.full(n, 0.005), np.full(n, 4))
    V, F = sphere(8, 12, 0.02) if lost else (MODEL.v_template, MODEL.skin_faces)
    return Frame(number=number, scan=Mesh(V + [9.0 * lost, 0, 0], F)), points


def test_a_sampled_frame_that_fits_no_body_is_left_out_by_its_number_and_the_person_is_the_others():
    settings = preset("draft").track
    samples, person, tracked, words = _fitted(MODEL, [standing(0), standing(4, True), standing(7)], settings)
    assert [frame.number for frame, _ in samples] == [0, 7] and len(tracked) == 2
    assert len(words) == 1 and words[0].startswith("frame 4: ") and words[0].endswith("the person is made without")
    alone = _fitted(MODEL, [standing(0), standing(7)], settings)
    assert np.array_equal(person.rest, alone[1].rest) and alone[3] == []
    with pytest.raises(UserError, match="frames 3-4: "):
        _fitted(MODEL, [standing(3, True), standing(4, True)], settings)


def test_which_frames_fit_no_body_is_known_from_another_process():
    error = pickle.loads(pickle.dumps(Unmatched.of([3, 4], "said")))
    assert error.numbers == (3, 4) and str(error) == "frames 3-4: said"


def test_pictures_exchanged_between_two_cameras_are_said():
    capture = open_capture(SAMPLE)
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
