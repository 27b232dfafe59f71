"""A first frame faces anywhere, a lost frame is found again: the search for a pose, on scans without keypoints."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.config import changed, preset
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.pipeline.samples import points_of
from toile.scene import Mesh
from toile.stages.track import Tracker, prepare
from toile.surface.pose_search import PoseSearch, shortest_turn, without_ground
from toile.surface.two_sided import TwoSided

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SETTINGS = preset("draft").track


@pytest.fixture(scope="module")
def known():
    """(model, frame, its keypoints in space, person and Tracked by them)."""
    capture, model = open_capture(SAMPLE), load_body_model("anny")
    frame = capture.frame(2)
    points = points_of(capture, preset("draft"), frame)
    person, _ = prepare(model, [(frame, points)], SETTINGS)
    return model, frame, person, Tracker(model, person, SETTINGS).track(frame, points)


def turned(frame, turn):
    scan = Mesh(frame.scan.vertices @ turn.as_matrix().T + [0.3, -2, 0.5], frame.scan.faces)
    return replace(frame, keypoints=None, scan=scan)


def off_mm(model, vertices, known, turn):
    """Mean distance of the outside vertices to where the keypoints put them."""
    there = known.vertices @ turn.as_matrix().T + [0.3, -2, 0.5]
    return 1e3 * np.linalg.norm(vertices - there, axis=1)[~model.inside].mean()


TURNS = {f"heading {angle}": Rotation.from_rotvec([0, 0, np.radians(angle)]) for angle in (45, 90, 180)}
TURNS |= {"lying": Rotation.from_rotvec([np.pi / 2, 0, 0]), "upside down": Rotation.from_rotvec([np.pi, 0, 0])}


@pytest.mark.parametrize("name", TURNS)
def test_a_person_is_found_whichever_way_she_faces(known, name):
    model, frame, person, there = known
    found = Tracker(model, person, SETTINGS).track(turned(frame, TURNS[name]), None)
    assert off_mm(model, found.vertices, there, TURNS[name]) < 5
    assert found.diagnostics["searched"] == 1 and found.diagnostics["astray"] < 0.02


POSES = {  # rotations [rad] in the model's axes: left x, backwards y, up z
    "sitting, hands on the knees": {"upperleg01.L": [-1.4, 0, 0], "upperleg01.R": [-1.4, 0, 0]}
    | {"lowerleg01.L": [1.4, 0, 0], "lowerleg01.R": [1.4, 0, 0]}
    | {"upperarm01.L": [-0.5, 0.6, 0], "upperarm01.R": [-0.5, -0.6, 0]},
    "an arm up, the other forwards": {"upperarm01.L": [0, -2.0, 0], "upperarm01.R": [0, 0, 1.3]},
    "a long stride": {"upperleg01.L": [-0.7, 0, 0], "upperleg01.R": [0.6, 0, 0]}
    | {"upperarm01.L": [0, 0.8, 0], "upperarm01.R": [0, -0.8, 0]},
}


@pytest.mark.slow(seconds=30)
@pytest.mark.parametrize("name", POSES)
def test_a_person_on_a_floor_is_found_in_poses_far_from_rest(known, name):
    """The scan is the model itself; its twists are not seen, so that parts count, each by its middle."""
    model, _, person, there = known
    rotations = np.zeros_like(there.rotations)
    for joint, turn in POSES[name].items():
        rotations[model.joint(joint)] = turn
    rotations[0] = [0, 0, 3.6]
    V = model.skin(person.rest, person.J, rotations, np.array([0.3, -2, 0.5]))
    scan = on_floor(V, model.skin_faces)
    found = PoseSearch(model, SETTINGS.headings, SETTINGS.search, SETTINGS.skeleton.model_dump(), person)
    pose, distance = found.pose(scan)
    off = model.skin(person.rest, person.J, *pose[:2]) - V
    part = np.take_along_axis(model.weights_idx, model.weights_val.argmax(1)[:, None], 1)[:, 0]
    parts = [off[(part == k) & ~model.inside] for k in np.unique(part[~model.inside])]
    assert sum(len(p) * np.linalg.norm(p.mean(0)) for p in parts) / sum(map(len, parts)) < 0.02
    assert distance < 0.015


def on_floor(V, F):
    """With a floor of 2 m under a surface, in the middle of which she does not stand."""
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(-0.4, 1.6, 21), np.linspace(-0.3, 1.7, 21)))
    P = np.stack([V[:, 0].mean() + x, V[:, 1].mean() + y, np.full(len(x), V[:, 2].min() - 0.002)], 1)
    i = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel() + len(V)
    squares = np.concatenate([np.stack([i, i + 1, i + 22], 1), np.stack([i, i + 22, i + 21], 1)])
    return Mesh(np.concatenate([V, P]), np.concatenate([F, squares]).astype(np.int32))


def test_a_floor_is_left_out_and_a_person_alone_is_not_touched(known):
    model, frame, _, there = known
    up, s = np.array([0, 0, 1.0]), SETTINGS.search
    assert without_ground(frame.scan, up, s.ground_height, s.ground_share) is frame.scan
    on = on_floor(frame.scan.vertices, frame.scan.faces)
    left = without_ground(on, up, s.ground_height, s.ground_share)
    assert not (left.faces >= len(frame.scan.vertices)).any() and len(left.faces) > 0.9 * len(frame.scan.faces)


@pytest.mark.parametrize(
    "a, b",
    [([1, 0, 0], [0, 2, 0]), ([0, 1, 1], [0, 1, 1]), ([0, 0, 3], [0, 0, -1]), ([1, 1, 1], [-2, -2, -2])],
)
def test_the_shortest_turn_lays_one_direction_along_another_by_their_angle(a, b):
    a, b = np.array(a, float), np.array(b, float)
    turn = shortest_turn(a, b)
    assert np.allclose(turn.apply(a / np.linalg.norm(a)), b / np.linalg.norm(b))
    cosine = np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)
    assert turn.magnitude() == pytest.approx(np.arccos(cosine), abs=1e-7)


def test_the_shared_fit_finds_a_person_who_faces_away(known):
    model, frame, _, there = known
    frame = turned(frame, TURNS["heading 180"])
    person, _ = prepare(model, [(frame, None)], SETTINGS)
    found = Tracker(model, person, SETTINGS).track(frame, None)
    assert off_mm(model, found.vertices, there, TURNS["heading 180"]) < 8


def off_after(model, frame, person, there, headings, **lost):
    """Mean distance [mm] to the truth of a frame tracked after `there` with these changes; and whether it was searched."""
    tracker = Tracker(model, person, changed(preset("draft"), {"quality": "draft", "track.headings": headings}).track)
    found = tracker.track(replace(frame, keypoints=None), None, replace(there, **lost))
    off = 1e3 * np.linalg.norm(found.vertices - there.vertices, axis=1)[~model.inside].mean()
    return off, found.diagnostics["searched"]


def test_a_frame_lost_by_pose_and_surface_is_found_again_by_the_search(known):
    *_, there = known
    away = np.array([2.0, 0, 0])
    lost = {"translation": there.translation + away, "vertices": there.vertices + away}
    off, searched = off_after(*known, headings=8, **lost)
    assert off < 5 and searched


def test_a_pose_that_is_lost_is_found_again_by_the_surface_before_without_a_search(known):
    *_, there = known
    rotations = there.rotations.copy()
    rotations[0] = (TURNS["heading 90"] * Rotation.from_rotvec(rotations[0])).as_rotvec()
    off, searched = off_after(*known, headings=0, rotations=rotations)
    assert off < 5 and not searched


@pytest.mark.parametrize("others", [True, False])
def test_an_arm_and_a_leg_that_go_half_a_metre_in_a_frame_are_followed_by_other_starts_alone(known, others):
    """Without other starts and the search, closest points leave them behind."""
    model, frame, person, there = known
    rotations = there.rotations.copy()
    rotations[model.joint("upperarm01.L")] += [0.5, -0.9, 0]
    rotations[model.joint("upperleg01.R")] += [-1.0, 0, 0]
    V = model.skin(person.rest, person.J, rotations, there.translation)
    assert np.linalg.norm(V - there.vertices, axis=1).max() > 0.5
    doubtful = {} if others else {"track.starts.doubtful": 1e9}
    settings = changed(preset("draft"), {"quality": "draft", "track.headings": 0, **doubtful}).track
    moved = replace(frame, scan=replace(frame.scan, vertices=V, faces=model.skin_faces), keypoints=None)
    found = Tracker(model, person, settings).track(moved, None, there)
    off = 1e3 * np.linalg.norm(found.vertices - V, axis=1)[~model.inside]
    assert (off.mean() < 6 and np.percentile(off, 99) < 40) if others else off.mean() > 30


def test_a_frame_that_its_start_explains_is_not_searched(known, monkeypatch):
    model, frame, person, there = known
    monkeypatch.setattr(PoseSearch, "pose", lambda *_: pytest.fail("searched"))
    found = Tracker(model, person, SETTINGS).track(replace(frame, keypoints=None), None, there)
    assert found.diagnostics["searched"] == 0


def test_what_only_one_side_lacks_is_not_astray(known):
    """A scan without legs, and one with a table beside: neither says that the body lies elsewhere; a moved body does."""
    model, frame, _, there = known
    looks, V, F = np.flatnonzero(~model.inside), frame.scan.vertices, frame.scan.faces
    cut = Mesh(V, F[V[F][:, :, 2].mean(1) > 0.8])
    table = np.array([[1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 1, 0.0]])
    beside = Mesh(
        np.concatenate([V, table]), np.concatenate([F, len(V) + np.array([[0, 1, 2], [0, 2, 3]])]).astype(np.int32)
    )
    for scan in (cut, beside):
        assert TwoSided(scan, looks)(there.vertices)[1] < 0.01
    distance, astray = TwoSided(frame.scan, looks)(there.vertices + [0.3, 0, 0])
    assert astray > 0.3 and distance > 0.05
    assert TwoSided(frame.scan, looks)(there.vertices)[0] < 0.01
