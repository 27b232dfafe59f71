"""Scan and keypoints choose a pose together: a limb that the scan lacks stays where keypoints put it, one that the scan shows stays there
though keypoints put it elsewhere, and a limb that the frame before lost is found again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from toile.config import preset
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.pipeline.samples import points_of
from toile.scene import HIDDEN, Mesh, Person, Points3D
from toile.stages.track import Tracker, prepare
from toile.surface.keypoint_side import WEIGHT, KeypointSide
from toile.surface.pose_search import PoseSearch
from toile.surface.two_sided import FAR, TwoSided, outside_of

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SETTINGS = preset("draft").track
HIDING = {  # where the halves of a limb point, in (outwards, forwards, upwards), to lie within the rest of the body
    "arms": ((-1, 0, -0.3), (-0.5, 0, -1)),
    "legs": ((-0.16, 0, -1), (0, 0, -1)),
}
ELSEWHERE = {  # and other ways beside the trunk, across it and behind
    "arms": (
        HIDING["arms"],
        ((-1, 0, 0), (-1, 0, 0)),
        ((0, 0, -1), (0, 0, -1)),
        ((0.2, 0, 1), (-1, 0, 0)),
        ((0.2, 1, 0), (-0.5, -1, 0)),
    ),
    "legs": (
        HIDING["legs"],
        ((0.1, 1, -0.1), (0, -0.3, -1)),
        ((0.1, 1, 1), (0, -0.3, -1)),
        ((0.1, -0.5, -1), (0.1, -0.6, -1)),
    ),
}
STILL = np.zeros(3)


@pytest.fixture(scope="module")
def body():
    """(model, person, KeypointSide, PoseSearch) of the mean body."""
    model = load_body_model("anny")
    person = Person(np.zeros(model.shapedirs.shape[2]), model.v_template, model.J)
    return model, person, KeypointSide(model, person), PoseSearch(model, 8, SETTINGS.search, {}, person)


def keypoints_of(model, person, rotations):
    V = model.skin(person.rest, person.J, rotations, STILL)
    places = model.keypoints(V, model.joint_transforms(person.J, rotations, STILL)[1])
    return Points3D(tuple(model.keypoint_names), places, np.full(len(places), 0.005), np.full(len(places), 4))


def hiding(search, limb):
    """The pose at rest but for one limb, which lies within the others."""
    return search._laid(np.zeros((len(search.model.parents), 3)), limb, HIDING[limb[:-2]])


def test_a_limb_elsewhere_counts_by_its_share_of_the_surface_and_a_wrong_point_hardly(body):
    model, person, side, search = body
    rest = np.zeros((len(model.parents), 3))
    points = keypoints_of(model, person, rest)
    assert side(rest, STILL, points) == (pytest.approx(0, abs=1e-9), False, True)
    assert side(rest, STILL, None) == (0, False, False)
    assert side(rest, STILL, Points3D(("nobody's",), points.points[:1] + 9, points.sigma[:1], points.views[:1]))[0] == 0
    of_limbs = [side(hiding(search, limb), STILL, points) for limb in search.limbs]
    assert all(contradicted and not vouched for _, contradicted, vouched in of_limbs)
    assert [off for off, *_ in of_limbs] == pytest.approx(2 * FAR * WEIGHT * side.share[1:], rel=0.1)
    assert 0.05 < side.share[1] < 0.12 < side.share[3] < 0.25 and side.share.sum() == pytest.approx(1)
    wrong = points.points.copy()
    wrong[[points.names.index(name) for name in ("body.wrist.L", "body.head", "body.foot.R")]] += 1
    wrong[points.names.index("body.toe1-1.R")] = np.nan
    assert side(rest, STILL, replace(points, points=wrong)) == (pytest.approx(0, abs=1e-9), False, True)


def test_keypoints_vouch_for_no_limb_of_which_they_tell_too_little(body):
    """Else a scan that shows the limb elsewhere would not count against the pose."""
    model, person, side, _ = body
    rest = np.zeros((len(model.parents), 3))
    points = keypoints_of(model, person, rest)
    arm = [i for i, name in enumerate(points.names) if name.endswith(".L") and name.startswith(("body.", "hand_"))]
    arm = [i for i in arm if any(word in points.names[i] for word in ("upperarm", "lowerarm", "wrist", "finger"))]
    unseen = points.points.copy()
    unseen[arm] = np.nan
    assert side(rest, STILL, replace(points, points=unseen))[1:] == (False, False)
    main = [
        points.names.index(f"body.{role}.{at}")
        for at in "LR"
        for role in ("upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
    ]
    few = Points3D(tuple(points.names[i] for i in main), points.points[main], points.sigma[main], points.views[main])
    assert side(rest, STILL, few)[1:] == (False, True)
    wrist = few.points.copy()
    wrist[2] += 0.3  # the median does not see it
    assert side(rest, STILL, replace(few, points=wrist))[1:] == (False, False)


@pytest.mark.parametrize(
    "limb, way", [(f"{kind}.{side}", i) for kind in ELSEWHERE for side in "LR" for i in range(len(ELSEWHERE[kind]))]
)
def test_keypoints_hold_a_limb_that_the_scan_lacks_and_yield_to_one_that_it_shows(body, limb, way):
    model, person, side, search = body
    surfaces, right = Tracker(model, person, SETTINGS).surface, np.zeros((len(model.parents), 3))
    wrong = search._laid(right, limb, ELSEWHERE[limb[:-2]][way])
    below = np.isin(model.weights_idx[:, 0], search.limbs[limb][1])
    surface = {
        pose: model.skin(person.rest, person.J, turns, STILL) for pose, turns in (("right", right), ("wrong", wrong))
    }
    whole = Mesh(surface["right"], model.skin_faces)
    lacking = Mesh(whole.vertices, whole.faces[~below[whole.faces].all(1)])

    def cost(scan, turns, V, told):
        off, _, vouched = side(turns, STILL, keypoints_of(model, person, told))
        known = surfaces.lacking(scan, V) if vouched else None
        return TwoSided(scan, outside_of(model))(V, known)[0] + off

    without = [cost(lacking, turns, V, right) for turns, V in zip((right, wrong), surface.values())]
    astray = [cost(whole, turns, V, wrong) for turns, V in zip((right, wrong), surface.values())]
    assert without[0] < without[1] and astray[0] < astray[1]


@pytest.fixture(scope="module")
def tracked():
    """(model, person, Tracker, [(Frame, Points3D, its Tracked)]) of two frames whose scans show all."""
    capture, model = open_capture(SAMPLE), load_body_model("anny")
    frames = [capture.frame(n) for n in (2, 3)]
    seen = [(frame, points_of(capture, preset("draft"), frame)) for frame in frames]
    person, _ = prepare(model, seen[:1], SETTINGS)
    tracker = Tracker(model, person, SETTINGS)
    first = tracker.track(*seen[0])
    return model, person, tracker, [(*seen[0], first), (*seen[1], tracker.track(*seen[1], first))]


def without(model, tracker, frame, surface, limb):
    """The frame with a scan that lacks a limb of the surface (n,3)."""
    from scipy.spatial import cKDTree

    below = np.isin(model.weights_idx[:, 0], tracker.search.limbs[limb][1])
    gone = below[cKDTree(surface).query(frame.scan.vertices)[1]]
    return replace(frame, scan=Mesh(frame.scan.vertices, frame.scan.faces[~gone[frame.scan.faces].any(1)]))


@pytest.mark.parametrize("limb", ["arms.L", "arms.R", "legs.L", "legs.R"])
def test_a_limb_that_the_scan_of_a_frame_lacks_stays_where_its_keypoints_are(tracked, limb):
    model, person, tracker, (before, (frame, points, whole)) = tracked
    found = tracker.track(without(model, tracker, frame, whole.vertices, limb), points, before[2])
    places = [model.joint_transforms(person.J, t.rotations, t.translation)[1] for t in (found, whole)]
    assert np.linalg.norm(places[0] - places[1], axis=1)[tracker.search.limbs[limb][1]].max() < 0.03
    off = np.linalg.norm(found.vertices - whole.vertices, axis=1)
    below = np.isin(model.weights_idx[:, 0], tracker.search.limbs[limb][1]) & ~model.inside
    assert (
        off[below].mean() < 0.02 and (found.confidence[below] == HIDDEN).mean() > 0.7
    )  # its surface too, which nothing shows
    assert off[~below & ~model.inside].mean() < 0.002


def test_an_arm_that_the_frame_before_lost_is_found_again_by_keypoints(tracked):
    """That frame lay as far from its poor scan, so that nothing seems lost by the scan."""
    model, person, tracker, ((frame, points, found), _) = tracked
    rotations = tracker.search._laid(found.rotations, "arms.L", HIDING["arms"])
    V = model.skin(person.rest, person.J, rotations, found.translation)
    lost = replace(found, rotations=rotations, vertices=V, diagnostics=found.diagnostics | {"usual_mm": 100.0})
    again = tracker.track(frame, points, lost)
    assert 1e3 * np.linalg.norm(V - found.vertices, axis=1).mean() > 30
    assert 1e3 * np.linalg.norm(again.vertices - found.vertices, axis=1)[~model.inside].mean() < 3
