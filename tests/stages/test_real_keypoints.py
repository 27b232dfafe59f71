"""OpenPose's detections in four calibrated videos of 1088x1920, whose residuals are of 8 to 10 px."""

import json

import numpy as np
import pytest

from toile.config import ReconstructSettings, preset
from toile.io.body import load_body_model
from toile.io.calibration import read_calibration
from toile.io.importing import moved
from toile.scene import Frame, Keypoints
from toile.stages.reconstruct import triangulate
from toile.stages.track import Tracker, prepare

# BODY_25B by number
SIDES = {
    "upperarm01": (5, 6), "lowerarm01": (7, 8), "wrist": (9, 10), "upperleg01": (11, 12), "lowerleg01": (13, 14),
    "foot": (15, 16), "big_toe": (19, 22), "small_toe": (20, 23), "heel": (21, 24),
}  # fmt: skip
NAMES = {f"body.{name}.{side}": pair[i] for name, pair in SIDES.items() for i, side in enumerate("LR")}


def keypoints_of(folder, number):
    points = {}
    for name in ("cam01", "cam02", "cam03", "cam04"):
        people = json.loads((folder / "pose" / f"{name}_json" / f"{name}.{number:04d}.json").read_text())["people"]
        if people:
            points[name] = np.array(people[0]["pose_keypoints_2d"]).reshape(-1, 3)[list(NAMES.values())]
    return Keypoints(tuple(NAMES), points)


@pytest.fixture(scope="module")
def data(shared_data):
    folder = shared_data / "pose2sim_calibrated_video"
    calibration = read_calibration("qualisys", folder / "calibration" / "Calib.qca.txt")
    cameras = moved(calibration, 0.001, np.eye(3))
    return cameras, [keypoints_of(folder, number) for number in (20, 40, 60, 80)]


def test_keypoints_of_a_large_picture_are_kept(data):
    cameras, frames = data
    settings = ReconstructSettings()
    found = [triangulate(keypoints, cameras, settings) for keypoints in frames]
    kept = np.mean([np.isfinite(points.points).all(1).mean() for points in found])
    fixed = settings.model_copy(update={"inlier_share": 8 / 1920, "inlier_range": (1.0, 1.0)})
    before = np.mean([np.isfinite(triangulate(k, cameras, fixed).points).all(1).mean() for k in frames])
    assert kept > 0.95 > 0.8 > before
    assert all(20 < points.gate < 90 for points in found)


def test_a_body_from_these_keypoints_alone_lies_under_them(data):
    cameras, frames = data
    settings, model = preset("draft"), load_body_model("anny")
    samples = [(Frame(i, None, k), triangulate(k, cameras, settings.reconstruct)) for i, k in enumerate(frames)]
    person, _ = prepare(model, samples, settings.track)
    tracker, off = Tracker(model, person, settings.track), []
    for frame, points in samples:
        tracked = tracker.track(frame, points)
        joints = model.joint_transforms(person.J, tracked.rotations, tracked.translation)[1]
        places = dict(zip(model.keypoint_names, model.keypoints(tracked.vertices, joints)))
        for name, seen in frame.keypoints.points.items():
            at = cameras[name].project(np.array([places[n] for n in NAMES]))[0]
            off.append(np.linalg.norm(at - seen[:, :2], axis=1)[seen[:, 2] > 0.3])
        assert tracked.diagnostics["keypoints_kept"] > 0.9 and tracked.diagnostics["keypoint_gate_px"] > 20
    assert np.median(np.concatenate(off)) < 25
