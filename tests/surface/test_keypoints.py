"""Keypoints that a detector puts beside the body model's."""

from dataclasses import replace

import numpy as np
import pytest

from toile import kernels, load_body_model
from toile.config import TrackSettings
from toile.scene import HIDDEN, INTERPOLATED, OBSERVED, Points3D
from toile.surface.keypoints import facial_places, learnt_offsets, with_offsets

NAMES = tuple(f"body.{bone}.{side}" for bone in ("upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
              for side in "LR") + ("face.nose_tip", "face.ear.L", "hand_left.finger2-tip.L")  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def offsets(model):
    return 0.03 * np.random.default_rng(1).standard_normal((len(model.keypoint_names), 3))


def poses_of(model, count):
    rng, (V, J) = np.random.default_rng(2), model.rest(np.zeros(0))
    for _ in range(count):
        rotations, translation = 0.3 * rng.standard_normal((len(J), 3)), rng.standard_normal(3)
        yield rotations, translation, model.skin(V, J, rotations, translation)


def detected(model, offsets, pose):
    """Points3D of NAMES as a detector of these offsets sees a pose of the mean body."""
    beside, rotations, translation = with_offsets(model, offsets), *pose[:2]
    V, J = beside.rest(np.zeros(0))
    x = beside.joint_transforms(J, rotations, translation)[1]
    places = beside.keypoints(beside.skin(V, J, rotations, translation), x)
    rows = [model.keypoint_names.index(name) for name in NAMES]
    return Points3D(NAMES, places[rows], np.full(len(rows), 0.01), np.full(len(rows), 4))


def test_without_offsets_the_joints_keypoints_are_the_models_in_every_pose(model):
    zero = np.zeros((len(model.keypoint_names), 3))
    for pose in poses_of(model, 3):
        x = model.joint_transforms(model.J, *pose[:2])[1]
        places = dict(zip(model.keypoint_names, model.keypoints(pose[2], x)))
        joints = [name for name, joint in zip(model.keypoint_names, model.keypoint_joint) if joint >= 0]
        found = detected(model, zero, pose)
        for name, point in zip(found.names, found.points):
            assert np.abs(point - places[name]).max() < (1e-9 if name in joints else 0.02)


@pytest.mark.parametrize("few", [0, 3])
def test_offsets_are_learnt_and_shrunk_by_how_few_frames_show_them(model, offsets, few):
    poses = list(poses_of(model, 9))
    learnt = learnt_offsets(model, model.J, poses, [detected(model, offsets, pose) for pose in poses], few)
    joints = [name for name, joint in zip(model.keypoint_names, model.keypoint_joint) if joint >= 0]
    rows = [model.keypoint_names.index(name) for name in NAMES if name in joints]
    assert np.abs(learnt[rows] - offsets[rows] * 9 / (9 + few)).max() < 1e-9
    unseen = [i for i, name in enumerate(model.keypoint_names) if name not in NAMES]
    assert (learnt[unseen] == 0).all()


def test_one_wild_detection_of_nine_changes_little(model, offsets):
    poses = list(poses_of(model, 9))
    found = [detected(model, offsets, pose) for pose in poses]
    found[3].points[:] += 5.0
    rows = [model.keypoint_names.index(name) for name in NAMES[:12]]
    assert np.abs(learnt_offsets(model, model.J, poses, found, 0)[rows] - offsets[rows]).max() < 1e-9


def test_a_pose_from_such_keypoints_is_right_where_the_offsets_are_known(model, offsets):
    """The pose that made the keypoints is found again; without the offsets the same points pull the joints away."""
    pose = next(poses_of(model, 1))
    start = (0.8 * pose[0], pose[1], np.zeros(0))
    off = {}
    for name, used in {"known": offsets, "ignored": 0 * offsets}.items():
        solver = kernels.SkeletonSolver(with_offsets(model, used), solve_shape=False)
        fit = solver.solve(keypoints=detected(model, offsets, pose), start=start)
        away = model.joint_transforms(model.J, fit.rotations, fit.translation)[1]
        true = model.joint_transforms(model.J, *pose[:2])[1]
        off[name] = np.linalg.norm(away - true, axis=1)[
            [model.joint("lowerarm01.L"), model.joint("lowerleg01.R")]
        ].max()
    assert off["known"] < 0.6 * off["ignored"]


def test_a_rig_that_names_no_keypoint_stays_as_it_is(model):
    bare = replace(model, keypoint_names=(), keypoint_joint=np.zeros(0, int), keypoint_vertices=())
    assert with_offsets(bare, np.zeros((0, 3))) is bare


@pytest.mark.parametrize("confidence, noise", [(OBSERVED, 0.003), (INTERPOLATED, 0.012), (HIDDEN, np.inf)])
def test_facial_keypoints_are_weighed_with_the_surface_and_what_lies_off_the_face_is_none(
    model, offsets, confidence, noise
):
    settings = TrackSettings(face_sigma=0.003, pose_unseen_factor=4.0, face_reach=0.04)
    pose = next(poses_of(model, 1))
    transforms = model.joint_transforms(model.J, *pose[:2])
    exact = detected(model, offsets, pose)  # of sigma 10 mm
    names = [name for name in NAMES if name.startswith("face.")]
    rows = [model.face_names.index(name) for name in names]
    there = exact.points[[NAMES.index(name) for name in names]]
    certain = np.full(len(model.v_template), confidence)
    given = lambda move: replace(exact, points=exact.points + move)
    places = lambda points: facial_places(model, points, pose[2], transforms, offsets, certain, settings)
    moves = [0.02, 0, 0], [0.2, 0, 0], [np.nan, 0, 0]
    (near, far, unseen), left_out = zip(*(places(given(move)) for move in moves))
    assert left_out == (0, len(rows), 0)
    assert np.isnan(np.delete(near, rows, 0)).all()  # no keypoint of the capture's
    assert np.allclose(near[rows] - there, [0.02 / (1 + (0.01 / noise) ** 2), 0, 0], atol=1e-9)
    expected = np.full_like(there, np.nan) if confidence == HIDDEN else there
    assert np.allclose(far[rows], expected, atol=1e-9, equal_nan=True)
    assert np.allclose(unseen[rows], expected, atol=1e-9, equal_nan=True)
