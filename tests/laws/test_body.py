"""Laws of skeleton and inner on a tube of four joints: they move with their input, and no order counts."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation

from tests.fuzz.bodies import sound_body
from toile.kernels import InnerSolver, SkeletonSolver

from .motions import examples, rigid, seeds, shuffled

MODEL = sound_body()
SOUND = {"joint_sigma": [np.inf, 0.5, 0.5, 0.5], "joint_limit": [np.inf, 2, 2, 2]}


def posed(seed):
    """Surface (n,3) and joints (4,3) of a random pose near rest."""
    rng = np.random.default_rng(seed)
    rotations, translation = rng.normal(0, 0.1, (4, 3)), rng.normal(0, 0.005, 3)
    joints = MODEL.joint_transforms(MODEL.J, rotations, translation)[1]
    return MODEL.skin(MODEL.v_template, MODEL.J, rotations, translation), joints


def seen(V, joints):
    points = np.array([joints[0], joints[2], V[[5, 6]].mean(0), V[100]])
    return SimpleNamespace(names=MODEL.keypoint_names, points=points, sigma=np.full(4, 0.002))


def start(motion=None):
    """At rest, or at rest and then moved: the root alone takes up a rigid motion."""
    if motion is None:
        return np.zeros((4, 3)), np.zeros(3), np.zeros(3)
    root = Rotation.from_matrix(motion.R).as_rotvec()
    return np.r_[[root], np.zeros((3, 3))], motion(MODEL.J[:1])[0] - MODEL.J[0], np.zeros(3)


@examples(8)
@given(seeds, rigid)
def test_skeleton_moves_with_scan_and_keypoints(seed, motion):
    scan, joints = posed(seed)
    solver = SkeletonSolver(MODEL, **SOUND)
    here = solver.solve(scan, MODEL.f, seen(scan, joints), start())
    there = solver.solve(motion(scan), MODEL.f, seen(motion(scan), motion(joints)), start(motion))
    assert np.abs(there.V - motion(here.V)).max() < 1e-3
    assert np.abs(there.shape - here.shape).max() < 0.1


@examples(8)
@given(seeds, seeds)
def test_skeleton_knows_no_order_of_the_scan(seed, other):
    scan, joints = posed(seed)
    W, G, _ = shuffled(scan, MODEL.f, other)
    solver = SkeletonSolver(MODEL, **SOUND)
    here, there = (solver.solve(*mesh, seen(scan, joints), start()) for mesh in ((scan, MODEL.f), (W, G)))
    assert np.abs(here.V - there.V).max() < 1e-3


def frame(seed, motion=None):
    """A posed body, its upper half under a tube of cloth."""
    rotations, translation = np.random.default_rng(seed).normal(0, 0.1, (4, 3)), np.zeros(3)
    tracked = MODEL.skin(MODEL.v_template, MODEL.J, rotations, translation)
    hidden = MODEL.v_template[:, 2] > 0.35
    cloth = MODEL.skin(MODEL.v_template * [1.08, 1.08, 1], MODEL.J, rotations, translation)
    tracked = np.where(hidden[:, None], cloth, tracked)
    faces = MODEL.f[hidden[MODEL.f].all(1)]
    if motion is not None:
        rotations[0] = Rotation.from_matrix(motion.R @ Rotation.from_rotvec(rotations[0]).as_matrix()).as_rotvec()
        translation = motion(MODEL.J[:1])[0] - MODEL.J[0]
        tracked, cloth = motion(tracked), motion(cloth)
    return rotations, translation, tracked, 1.0 - hidden, [(cloth, faces)]


@examples(8)
@given(seeds, rigid)
def test_inner_moves_with_its_frames(seed, motion):
    solver = InnerSolver(MODEL, np.zeros(3))
    here, there = solver.fuse([frame(seed)]), solver.fuse([frame(seed, motion)])
    assert np.abs(here.rest - there.rest).max() < 1e-6
    body, moved = solver.solve(here.rest, *frame(seed)), solver.solve(here.rest, *frame(seed, motion))
    assert np.abs(moved.V - motion(body.V)).max() < 1e-6


@examples(8)
@given(seeds, seeds)
def test_inner_knows_no_order_of_cloth_and_frames(seed, other):
    frames = [frame(seed), frame(other)]
    mixed = [(*f[:4], [shuffled(*f[4][0], other)[:2]]) for f in reversed(frames)]
    solver = InnerSolver(MODEL, np.zeros(3))
    assert np.abs(solver.fuse(frames).rest - solver.fuse(mixed).rest).max() < 1e-6
