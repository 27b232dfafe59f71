"""Limbs that nothing shows: what verdicts say of an arm, a leg or the head that scan, keypoints and pictures leave out."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from toile.config import VerdictSettings
from toile.io.body import load_body_model
from toile.io.layout import DOUBTFUL
from toile.measure.glimpse import glimpse
from toile.measure.limbs import limbs_shown
from toile.measure.verdicts import JudgedLayer, verdict
from toile.scene import HIDDEN, OBSERVED, Frame, Keypoints

FINE = {"observed": 0.9, "scan_to_surface_mm": 1.0, "two_sided_mm": 1.0, "keypoint_mm": 5.0, "silhouette_iou": 0.98}


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def cameras():
    """Three about the body, all of which show all of it."""
    lower = np.eye(4)
    lower[2, 3] = 0.9  # the ring stands about a point 1 m up, the model's origin is the hip
    return {n: replace(c, T_camera_world=c.T_camera_world @ lower) for n, c in ring_of_cameras(3).items()}


def tracked(model, unseen=()):
    """The body as the model has it; vertices `unseen` (n,) bool were not found on the scan."""
    found = np.full(len(model.v_template), OBSERVED, np.uint8)
    found[np.flatnonzero(unseen)] = HIDDEN
    return JudgedLayer("body", None, model.v_template, model.skin_faces, found, np.flatnonzero(~model.inside))


def below(model, height):
    """Vertices (n,) bool under a joint's height."""
    return model.v_template[:, 2] < model.J[model.joint(height), 2]


def cut(cameras, height):
    """The cameras with pictures that end above what lies under a height [m]."""
    rows = {name: int(camera.project(np.array([0, 0, height]))[0][1]) for name, camera in cameras.items()}
    return {name: replace(camera, height=rows[name]) for name, camera in cameras.items()}


def with_masks(cameras):
    return glimpse(Frame(0, None, masks={name: np.ones(camera.size, bool) for name, camera in cameras.items()}))


def with_keypoints(model, cameras, leave_out=()):
    """Of the body alone, seen by all cameras, those of `leave_out` by none."""
    rows = [i for i, name in enumerate(model.keypoint_names) if name.startswith("body.")]
    places = model.keypoints(model.v_template, model.J)[rows]
    names = tuple(model.keypoint_names[i] for i in rows)
    sure = [float(name not in leave_out) for name in names]
    return glimpse(Frame(0, None, Keypoints(names, {n: np.c_[c.project(places)[0], sure] for n, c in cameras.items()})))


def test_by_the_scan_alone_a_limb_is_told_by_its_own_share_and_by_its_place_in_the_body(model):
    nothing, whole = glimpse(Frame(0, None)), tracked(model)
    assert limbs_shown(nothing, {}, model, whole) == {"limb_observed": 1, "limb_inside": 0}
    elbow, wrist = (model.J[model.joint(f"{role}.L")] for role in ("lowerarm01", "wrist"))
    forearm = np.linalg.norm(model.v_template - wrist, axis=1) < 0.9 * np.linalg.norm(elbow - wrist)
    unseen = tracked(model, forearm)
    assert limbs_shown(nothing, {}, model, unseen)["limb_observed"] < 0.05
    assert unseen.confidence[unseen.looks].mean() > 1.5
    moved = model.v_template + np.outer(forearm, model.J[model.joint("spine03")] - wrist)
    assert limbs_shown(nothing, {}, model, replace(whole, vertices=moved))["limb_inside"] > 0.3


def test_legs_that_scan_and_every_picture_leave_out_are_doubtful_though_keypoints_and_masks_agree(model, cameras):
    legless, knee = tracked(model, below(model, "lowerleg01.L")), model.J[model.joint("lowerleg01.L"), 2]
    short = cut(cameras, knee + 0.1)
    for seen in (with_masks(short), with_keypoints(model, short)):
        found = limbs_shown(seen, short, model, legless)
        assert found["limb_observed"] < 0.05
        level, (reason,) = verdict(FINE | found, VerdictSettings())
        assert level == DOUBTFUL and "guessed" in reason


def test_a_limb_that_two_pictures_or_its_own_keypoints_show_needs_no_scan(model, cameras):
    legless = tracked(model, below(model, "lowerleg01.L"))
    for seen in (with_masks(cameras), with_keypoints(model, cameras)):
        assert limbs_shown(seen, cameras, model, legless) == {"limb_observed": 1, "limb_inside": 0}


def test_a_knee_tells_nothing_of_the_shank_below_it(model, cameras):
    legless = tracked(model, below(model, "lowerleg01.L"))
    feet = [n for n in model.keypoint_names if any(part in n for part in ("foot", "toe", "heel"))]
    assert limbs_shown(with_keypoints(model, cameras, feet), cameras, model, legless)["limb_observed"] < 0.05


def test_one_picture_of_several_shows_no_limb_and_the_only_one_does(model, cameras):
    legless, knee = tracked(model, below(model, "lowerleg01.L")), model.J[model.joint("lowerleg01.L"), 2]
    one_whole = cut(cameras, knee + 0.1) | {"cam0": cameras["cam0"]}
    assert limbs_shown(with_masks(one_whole), one_whole, model, legless)["limb_observed"] < 0.05
    alone = {"cam0": cameras["cam0"]}
    assert limbs_shown(with_masks(alone), alone, model, legless)["limb_observed"] == 1
