"""Laws of the skeleton kernel on the packaged body: recovery, robustness, refusals, bits."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.smpl import JOINTS, smpl_fields
from toile.io.body import load_body_model
from toile.kernels import InputError, SkeletonSolver, SurfaceIndex, vertex_normals
from toile.kernels.skeleton import JOINT_LIMIT, JOINT_SIGMA, JOINT_TWIST, OTHER_LIMIT, OTHER_SIGMA, by_prefix

MOVING = {
    "spine": 0.08,
    "neck01": 0.2,
    "clavicle": 0.1,
    "upperarm01": 0.5,
    "upperleg01": 0.4,
    "lowerarm01": 0.5,
    "lowerleg01": 0.5,
    "finger": 0.2,
}


@pytest.fixture(scope="module")
def model():
    return load_body_model()


@pytest.fixture(scope="module")
def solver(model):
    return SkeletonSolver(model)


def test_spreads_and_limits_follow_what_joints_are_not_what_they_are_called(model, tmp_path):
    np.savez(tmp_path / "smpl.npz", **smpl_fields())
    other = load_body_model(tmp_path / "smpl.npz")
    for table, rest in ((JOINT_SIGMA, OTHER_SIGMA), (JOINT_LIMIT, OTHER_LIMIT), (JOINT_TWIST, np.inf)):
        ours = dict(zip(model.joint_names, by_prefix(model.joint_roles, table, rest)))
        theirs = dict(zip(other.joint_names, by_prefix(other.joint_roles, table, rest)))
        assert theirs == {name: ours[twin] for name, twin in JOINTS.items()}


@pytest.fixture(scope="module")
def truth(model):
    """A posed, shaped body, its joints and keypoints, and a scan of it with another connectivity."""
    rng = np.random.default_rng(5)
    rotations = np.zeros((104, 3))
    for k, name in enumerate(model.joint_names):
        rotations[k] = rng.uniform(-1, 1, 3) * next((s for p, s in MOVING.items() if name.startswith(p)), 0)
    rotations[0] = 0.3, -0.2, 1.5
    translation, shape = np.array([0.4, -0.3, 1.0]), rng.normal(0, 0.8, 16)
    rest, J = model.rest(shape)
    V = model.skin(rest, J, rotations, translation)
    joints = model.joint_transforms(J, rotations, translation)[1]
    a, b, c = model.f.T  # midpoints of edges: none of the scan's vertices is one of the model's
    scan = np.concatenate([V[a] + V[b], V[b] + V[c], V[c] + V[a]]) / 2
    m = len(model.f)
    faces = np.arange(3 * m).reshape(3, m).T
    return SimpleNamespace(
        rotations=rotations, translation=translation, shape=shape, V=V, joints=joints, scan=scan, faces=faces
    )


def keypoints(model, truth, noise=0.0, seed=0):
    points = model.keypoints(truth.V, truth.joints)
    points = points + np.random.default_rng(seed).normal(0, 1, points.shape) * noise
    return SimpleNamespace(names=model.keypoint_names, points=points, sigma=np.full(len(points), 0.005))


def joint_error(result, truth):
    return np.linalg.norm(result.joints - truth.joints, axis=1)


def test_exact_surface_and_keypoints_give_joints_to_a_millimetre_cold(model, solver, truth):
    result = solver.solve(truth.scan, truth.faces, keypoints(model, truth))
    assert result.stop == "converged" and result.matched > 5000
    assert joint_error(result, truth).mean() < 1.5e-3 and result.rms < 1e-3
    posed = model.skin(*model.rest(result.shape), result.rotations, result.translation)
    np.testing.assert_allclose(posed, result.V, atol=1e-12)


def test_matches_that_come_and_go_do_not_keep_a_solve_going(model, truth):
    few = dict(surface_samples=600, max_iterations=60)
    noisy = truth.scan + np.random.default_rng(2).normal(0, 0.006, truth.scan.shape)
    found = [
        SkeletonSolver(model, **few, **options).solve(noisy, truth.faces, keypoints(model, truth, 0.005))
        for options in ({}, {"relative_decrease": 0.0, "idle": 60})
    ]
    assert found[0].stop == "converged" and found[0].iterations <= 0.7 * found[1].iterations
    assert joint_error(found[0], truth).mean() < joint_error(found[1], truth).mean() + 5e-4


def test_noise_outliers_swaps_and_unseen_keypoints_leave_joints_under_a_centimetre(model, solver, truth):
    seen = keypoints(model, truth, 0.005)
    rng = np.random.default_rng(1)
    wrong = rng.choice(len(seen.points), 10, replace=False)
    seen.points[wrong] += rng.normal(0, 0.2, (10, 3))
    left, right = (model.keypoint_names.index(f"body.wrist.{s}") for s in "LR")
    seen.points[[left, right]] = seen.points[[right, left]]
    seen.points[rng.choice(len(seen.points), 12)] = np.nan
    result = solver.solve(truth.scan, truth.faces, seen)
    assert joint_error(result, truth).mean() < 6e-3


def test_cloth_off_the_torso_leaves_joints_under_a_centimetre_and_labels_help_the_shape(model, solver, truth):
    cloth = np.zeros(len(truth.V))
    cloth[model.segments["torso"]] = 1
    shirt = truth.V + 0.025 * cloth[:, None] * vertex_normals(truth.V, model.f)
    seen = keypoints(model, truth, 0.003)
    blind = solver.solve(shirt, model.f, seen)
    told = solver.solve(shirt, model.f, seen, clothed=cloth)
    assert joint_error(blind, truth).mean() < 1e-2 and joint_error(told, truth).mean() < 6e-3
    error = [np.linalg.norm(r.V - truth.V, axis=1)[cloth > 0].mean() for r in (blind, told)]
    assert error[1] < 0.8 * error[0]


def bone(model, name):
    k = model.joint_names.index(name)
    along = model.J[model.parents == k].mean(0) - model.J[k]
    return k, along / np.linalg.norm(along)


def turns(model, result):
    """Of the left thigh and shank about their own bones [rad]."""
    return [result.rotations[k] @ along for k, along in (bone(model, "upperleg01.L"), bone(model, "lowerleg01.L"))]


def test_a_foot_that_points_outwards_does_not_turn_the_knee(model):
    """A straight leg's keypoints show no more than the sum of its joints' turns."""
    rotations, still = np.zeros((104, 3)), np.zeros(3)
    k, along = bone(model, "upperleg01.L")
    rotations[k] = 0.4 * along
    joints = model.joint_transforms(model.J, rotations, still)[1]
    seen = keypoints(model, SimpleNamespace(V=model.skin(model.v_template, model.J, rotations, still), joints=joints))
    held, free = (
        SkeletonSolver(model, solve_shape=False, **options).solve(keypoints=seen)
        for options in ({}, {"joint_twist": {"": np.inf}})
    )
    assert abs(turns(model, held)[1]) < 0.03 < 0.1 < turns(model, free)[1]
    assert turns(model, held)[0] > 0.1 and held.keypoint_rms < 1e-4


def test_the_spread_of_turns_costs_a_bend_nothing(model):
    rotations, still = np.zeros((104, 3)), np.zeros(3)
    k, along = bone(model, "lowerleg01.L")
    rotations[k] = 1.2 * np.cross(along, np.cross((1, 0, 0), along))
    posed = model.skin(model.v_template, model.J, rotations, still)
    free = {"joint_sigma": {"": np.inf}, "solve_shape": False}
    result = SkeletonSolver(model, joint_twist={"lowerleg01": 1e-3}, **free).solve(
        posed, model.f, start=(rotations, still, np.zeros(0))
    )
    assert np.abs(result.V - posed).max() < 1e-4 and abs(turns(model, result)[1]) < 1e-4


def test_keypoints_alone_and_surface_alone_both_work(model, solver, truth):
    result = solver.solve(None, None, keypoints(model, truth))
    assert result.matched == 0 and joint_error(result, truth).mean() < 3e-3
    close = truth.rotations + np.random.default_rng(2).normal(0, 0.02, (104, 3)) * (truth.rotations != 0)
    result = solver.solve(truth.scan, truth.faces, start=(close, truth.translation + 0.01, truth.shape))
    assert joint_error(result, truth).mean() < 3e-3


def test_one_shape_for_three_frames_beats_each_frame_alone(model, truth):
    rng = np.random.default_rng(4)
    rest, J = model.rest(truth.shape)
    frames = []
    for _ in range(3):
        rotations = truth.rotations * rng.uniform(0.3, 1, (104, 1))
        V = model.skin(rest, J, rotations, truth.translation)
        x = model.joint_transforms(J, rotations, truth.translation)[1]
        points = model.keypoints(V, x) + rng.normal(0, 0.005, (len(model.keypoint_names), 3))
        cut = model.f[(V[model.f].mean(1) @ rng.normal(0, 1, 3)) > 0.2]  # a scan of about half the body
        frames.append(
            dict(scan_V=V, scan_F=cut, keypoints=SimpleNamespace(names=model.keypoint_names, points=points, sigma=None))
        )
    solver = SkeletonSolver(model)
    alone = [solver.solve(**f).shape for f in frames]
    shared = solver.solve_shared(frames)
    assert all(np.array_equal(shared[0].shape, r.shape) for r in shared)

    def error(shape):
        return np.linalg.norm(model.rest(shape)[0] - rest, axis=1).mean()

    assert error(shared[0].shape) < np.mean([error(s) for s in alone])


def test_earlier_frames_hold_what_nothing_else_sees(model, solver, truth):
    seen = keypoints(model, truth)
    arm = [
        i
        for i, n in enumerate(model.keypoint_names)
        if n.startswith("hand_left") or n in ("body.wrist.L", "body.lowerarm01.L")
    ]
    seen.points[arm] = np.nan
    before = (truth.rotations, truth.translation, truth.shape)
    held = solver.solve(None, None, seen, previous=[before, before])
    free = solver.solve(None, None, seen)
    wrist = model.joint("wrist.L")
    assert joint_error(held, truth)[wrist] < 0.02 < joint_error(free, truth)[wrist]


def test_bits_do_not_depend_on_threads(model, solver, truth, threads):
    results = []
    for n in (1, 2, 3, 8):
        threads(n)
        results.append(solver.solve(truth.scan, truth.faces, keypoints(model, truth, 0.005)))
    for r in results[1:]:
        assert np.array_equal(r.V, results[0].V) and r.energy == results[0].energy


def test_a_scans_own_index_changes_nothing(model, solver, truth):
    seen, twice = keypoints(model, truth, 0.005), np.concatenate([truth.faces, truth.faces])
    plain = solver.solve(truth.scan, truth.faces, seen)
    index, doubled = SurfaceIndex(truth.scan, truth.faces), SurfaceIndex(truth.scan, twice)
    elsewhere = SurfaceIndex(truth.scan + 1, truth.faces)
    for faces, given in ((truth.faces, index), (twice, doubled), (truth.faces, elsewhere)):
        found = solver.solve(truth.scan, faces, seen, scan_index=given)
        assert np.array_equal(found.V, plain.V) and found.energy == plain.energy


def test_bad_input_is_refused_by_name(model, solver, truth):
    seen = keypoints(model, truth)
    bad = truth.scan.copy()
    bad[7, 2] = np.inf
    with pytest.raises(InputError, match=r"skeleton: scan_V\[7\]"):
        solver.solve(bad, truth.faces, seen)
    with pytest.raises(InputError, match="neither scan_F nor keypoints"):
        solver.solve()
    with pytest.raises(InputError, match="knows none of keypoints.names"):
        solver.solve(keypoints=SimpleNamespace(names=("a",), points=np.zeros((1, 3)), sigma=None))
    with pytest.raises(InputError, match=r"keypoints.sigma\[1\]"):
        seen.sigma[1] = 0
        solver.solve(keypoints=seen)
    with pytest.raises(InputError, match="start.rotations has 3 rows"):
        solver.solve(truth.scan, truth.faces, start=(np.zeros((3, 3)), np.zeros(3), np.zeros(16)))
    with pytest.raises(TypeError, match="no option named 'reech'"):
        SkeletonSolver(model, reech=1)
    with pytest.raises(InputError, match=r"joint_twist\[3\] must be positive"):
        SkeletonSolver(model, joint_twist=np.where(np.arange(len(model.J)) == 3, 0.0, 1.0))
    with pytest.raises(InputError, match="joint_twist"):
        SkeletonSolver(model, joint_twist=np.ones(3))


def test_a_model_without_shapes_or_keypoints_is_posed_from_scans_alone(model):
    """What remains of a user's own model: vertices, weights, joints."""
    from dataclasses import replace

    bare = replace(
        model, shapedirs=np.zeros((len(model.v_template), 3, 0)), J_shapedirs=np.zeros((104, 3, 0)),
        keypoint_names=(), keypoint_joint=np.zeros(0, np.int64), keypoint_vertices=(),
    )  # fmt: skip
    rotations = np.zeros((104, 3))
    rotations[model.joint_names.index("upperarm01.L")] = 0, 0.15, 0
    V = model.skin(model.v_template, model.J, rotations, np.array([0.02, 0.01, 0.0]))
    results = SkeletonSolver(bare).solve_shared([{"scan_V": V, "scan_F": model.f}] * 2)
    for result in results:
        assert result.shape.shape == (0,) and result.rms < 2e-3
        assert np.linalg.norm(result.V - V, axis=1).mean() < 5e-3


def test_a_model_whose_vertices_no_joint_moves_is_refused(model):
    from dataclasses import replace

    none = np.zeros((len(model.v_template), 0))
    with pytest.raises(InputError, match=r"weights_idx and weights_val must both be \(\d+, B\), B > 0"):
        SkeletonSolver(replace(model, weights_idx=none.astype(np.int32), weights_val=none))
