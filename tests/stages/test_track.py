"""The tracked surface: onto the scan, also where the pose is off."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.shapes import sphere
from toile.config import TrackSettings
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.scene import HIDDEN, OBSERVED, BodyModel, Frame, Mesh, Person, Points3D, Tracked
from toile.stages.track import Tracker


def pipe(rings=60, sectors=48):
    """One joint in the middle of a closed pipe 1 m long."""
    V, F = sphere(rings, sectors, 0.5)
    V = V * [0.2, 0.16, 1] + [0, 0, 0.5]
    bend = np.clip((V[:, 2] - 0.4) / 0.2, 0, 1)
    idx, val = np.tile([0, 1], (len(V), 1)), np.stack([1 - bend, bend], 1)
    J = np.array([[0, 0, 0.0], [0, 0, 0.5]])
    none = np.zeros((len(V), 3, 0))
    return BodyModel(V, F, J, np.array([-1, 0]), idx, val, none, np.zeros((2, 3, 0)), ("root", "elbow"))


def posed(model, angle):
    return model.skin(model.v_template, model.J, np.array([[0, 0, 0], [angle, 0, 0]]), np.zeros(3))


@pytest.fixture(scope="module")
def surface():
    model = pipe()
    return model, Tracker(model, Person(np.zeros(0), model.v_template, model.J), TrackSettings()).surface


@pytest.mark.parametrize("off", [0.03, 0.08, 0.12])
def test_the_surface_finds_its_scan_from_a_pose_whose_end_is_off(surface, off):
    model, surface = surface
    dense = pipe(90, 70)
    scan, true = Mesh(posed(dense, 0.4), dense.f), posed(model, 0.4)
    V, confidence = surface.fit(scan, posed(model, 0.4 + off / 0.5))
    assert np.linalg.norm(V - true, axis=1).max() < 0.01
    assert scan.index.closest(V)[3].max() < 0.001
    assert (confidence == OBSERVED).all()


def test_a_scan_elsewhere_is_refused(surface):
    model, surface = surface
    with pytest.raises(UserError, match="do not overlap"):
        surface.fit(Mesh(model.v_template + [5.0, 0, 0], model.f), model.v_template)


REST = np.zeros((2, 3)), np.zeros(3)


def tracker(**settings):
    model = pipe()
    rest = model.v_template * [1.1, 1.1, 1]  # a stouter person than the model's
    return Tracker(model, Person(np.zeros(0), rest, model.J), TrackSettings(**settings))


def test_the_pose_follows_the_turn_of_a_surface_about_a_limb_s_own_axis():
    found = tracker()
    turns, move = np.array([[0, 0, 0.1], [0.2, 0, 0.5]]), np.array([0.1, 0, 0.05])
    V = found.model.skin(found.person.rest, found.person.J, turns, move)
    seen = np.full(len(V), OBSERVED)
    rotations, translation = found.poser.pose(V, seen, None, REST)
    assert np.allclose(rotations, turns, atol=0.02) and np.allclose(translation, move, atol=0.002)
    wrong = V + np.where(V[:, 2] > 0.8, 0.02, 0)[:, None]  # which the scan did not show
    hidden = np.where(V[:, 2] > 0.8, HIDDEN, OBSERVED)
    far, near = (found.poser.pose(wrong, c, None, REST)[0] - turns for c in (seen, hidden))
    assert np.linalg.norm(near) < 0.6 * np.linalg.norm(far)


def test_keypoints_that_the_model_does_not_know_leave_the_pose_to_the_surface():
    found = tracker()
    V = found.model.skin(found.person.rest, found.person.J, *REST)
    points = Points3D(("nose",), np.array([[5.0, 0, 0]]), np.array([1e-3]), np.array([3]))
    seen = np.full(len(V), OBSERVED)
    with_points, without = (found.poser.pose(V, seen, p, REST)[0] for p in (points, None))
    assert np.array_equal(with_points, without)


def test_a_share_of_the_way_off_the_pose_is_carried_on_and_dies_away():
    found = tracker(carried_share=0.5, carried_reach=0.1)
    off = np.zeros_like(found.person.rest)
    off[3], off[4] = [0.02, 0, 0], [0, 0.4, 0]
    turns, move = np.array([[0, 0, 0.1], [0.3, 0, 0]]), np.array([0.1, 0, 0])
    V = found.model.skin(found.person.rest + off, found.person.J, turns, move)
    before = Tracked(V, turns, move, np.zeros((0, 3)), np.full(len(V), OBSERVED), {})
    assert np.allclose((found._start(before) - found.person.rest)[[3, 4, 5]], [[0.01, 0, 0], [0, 0.05, 0], [0, 0, 0]])
    assert np.array_equal(tracker(carried_share=0)._start(before), found.person.rest)


@pytest.mark.parametrize(("given", "away", "share"), [(29, 0, 0.0), (29, 29, 1.0), (6, 3, 0.5), (4, 4, None)])
def test_the_share_of_facial_keypoints_off_the_face_is_of_those_given_and_of_few_none_is_told(given, away, share):
    model = load_body_model("anny")
    person = Person(np.zeros(model.shapedirs.shape[2]), model.v_template, model.J)
    still = np.zeros((len(model.J), 3)), np.zeros(3)
    rows = [model.keypoint_names.index(name) for name in model.face_names]
    places = model.keypoints(model.v_template, model.J)[rows]
    places[given:] = np.nan
    places[:away] += [0.3, 0, 0]
    points = Points3D(tuple(model.face_names), places, np.full(len(places), 0.005), np.full(len(places), 4))
    fit = SimpleNamespace(rotations=still[0], translation=still[1], rms=0.0, iterations=1)
    seen = model.v_template, np.full(len(model.v_template), OBSERVED, np.uint8)
    found = Tracker(model, person, TrackSettings()).tracked(Frame(0, None), points, fit, seen)
    assert found.diagnostics.get("face_off") == share
