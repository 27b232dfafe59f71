"""The hard truth: what it does to the body and its motion, and that each part can be had alone."""

import igl
import numpy as np
import pytest

from toile.errors import UserError


def closest(points, V, F):
    square, face, at = igl.point_mesh_squared_distance(points, V, F.astype(np.int64))[:3]
    n = np.cross(V[F[face, 1]] - V[F[face, 0]], V[F[face, 2]] - V[F[face, 0]])
    return np.sqrt(square), at, n / np.linalg.norm(n, axis=1, keepdims=True)


def best_fit(model, body, counted, picks=500):
    """The model's surface (n,3) fitted to the truth's at rest: shape, every joint's rotation and translation, by scipy."""
    from scipy.optimize import least_squares

    from toile.kinematics import blend_skinning

    target, F = body.rest, body.skin_faces
    pick = np.flatnonzero(counted)[np.random.default_rng(0).permutation(counted.sum())[:picks]]
    turned = [k for k, n in enumerate(model.joint_names) if not n.startswith(("finger", "metacarpal", "toe", "eye"))]
    S = model.shapedirs.shape[2]

    def surface(p, rows):
        J = model.J + model.J_shapedirs @ p[:S]
        rest = model.v_template[rows] + model.shapedirs[rows] @ p[:S]
        rotations = np.zeros((len(J), 3))
        rotations[turned] = p[S + 3 :].reshape(-1, 3)
        R, x = model.joint_transforms(J, rotations, p[S : S + 3])
        return blend_skinning(rest, J, R, x, model.weights_idx[rows], model.weights_val[rows])

    p = np.zeros(S + 3 + 3 * len(turned))
    p = least_squares(lambda p: np.r_[(surface(p, pick) - target[pick]).ravel(), 1e-3 * p], p, max_nfev=4).x
    for _ in range(3):
        _, at, n = closest(surface(p, pick), target, F)
        p = least_squares(lambda p: np.r_[((surface(p, pick) - at) * n).sum(1), 1e-3 * p], p, max_nfev=2).x
    return surface(p, np.arange(len(target)))


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("subject, seed", [("fitted", 1), ("loose", 2)])
def test_the_best_shape_and_pose_of_the_model_stay_5_to_15_mm_off_on_average(subject, seed):
    pytest.importorskip("anny")
    from toile.io.body import load_body_model
    from toile.studio.body import make_body
    from toile.studio.deviation import trunk_and_limbs
    from toile.studio.truths import Hard

    model, body = load_body_model("anny"), make_body(subject, np.random.default_rng(seed), Hard())
    counted = trunk_and_limbs(model) > 0.5
    fitted = best_fit(model, body, counted)
    there = closest(body.rest[counted], fitted, body.skin_faces)[0].mean()
    back = closest(fitted[counted], body.rest, body.skin_faces)[0].mean()
    assert 0.005 < there < 0.015 and 0.005 < back < 0.015


@pytest.fixture(scope="module")
def hard_body():
    pytest.importorskip("anny")
    from toile.studio.body import make_body
    from toile.studio.truths import Hard

    return make_body("fitted", np.random.default_rng(1), Hard())


def test_no_face_is_turned_over_by_the_offsets(hard_body):
    F = hard_body.skin_faces
    normal = lambda V: np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
    before, after = normal(hard_body.rest - hard_body.offset), normal(hard_body.rest)
    assert (before * after).sum(1).min() > 0


def test_joints_lie_2_to_5_mm_elsewhere(body, hard_body):
    moved = np.linalg.norm(hard_body.J - body.J, axis=1)
    main = [i for i, n in enumerate(body.model.joint_names) if n.startswith(("upper", "lower", "spine", "wrist"))]
    assert (moved[main] >= 0.002).all() and (moved[main] <= 0.005).all()
    assert hard_body.phenotype == body.phenotype


@pytest.mark.parametrize("joint", ["lowerarm01.L", "lowerleg01.R", "upperarm01.L"])
def test_muscles_bulge_3_to_8_mm_where_a_joint_bends_and_not_at_rest(hard_body, joint):
    model = hard_body.model
    at_rest = np.zeros((len(hard_body.J), 3))
    bent = at_rest.copy()
    bent[model.joint(joint), 0] = -1.3
    off = lambda R: np.linalg.norm(
        hard_body.pose(R, np.zeros(3)) - model.skin(hard_body.rest, model.J, R, np.zeros(3)), axis=1
    )
    assert off(at_rest).max() == 0
    assert 0.003 < off(bent).max() < 0.0085


def test_the_chest_breathes_every_three_seconds(hard_body):
    from toile.studio.motion import FPS, RAMP
    from toile.studio.motions import BREATH, make_motion

    n = int(BREATH * FPS)
    m = make_motion("talk", hard_body, n + 1, np.random.default_rng(0))
    breath = m.expression[RAMP:, -1]
    assert abs(breath[0] - breath[n]) < 0.01 and np.ptp(breath) > 0.99
    depth = np.linalg.norm(hard_body.expressions[-1], axis=1)
    assert 0.004 < depth.max() <= 0.0051
    assert (
        hard_body.dense_weights[depth.argmax(), [n.startswith("spine") for n in hard_body.model.joint_names]].sum()
        > 0.5
    )


def test_each_part_of_the_truth_can_be_had_alone():
    from toile.studio.options import StudioOptions
    from toile.studio.truths import PARTS, PLAIN, Hard

    assert StudioOptions().amounts == Hard() and StudioOptions(truth="plain").amounts == PLAIN
    for part in PARTS:
        alone = StudioOptions(truth=part).amounts.model_dump()
        assert alone[part] == Hard().model_dump()[part]
        assert {p for p in PARTS if alone[p] != PLAIN.model_dump()[p]} == {part}
    both = StudioOptions(truth="floor+joints", hard=Hard(joints=0.002)).amounts
    assert both.floor and both.joints == 0.002 and not both.webs
    with pytest.raises(UserError, match="truth is 'soft'"):
        StudioOptions(truth="soft")
    with pytest.raises(UserError, match="template is 'mine'"):
        StudioOptions(template="mine")


@pytest.mark.parametrize("truth", ["plain", "surface+webs"])
def test_an_amount_of_a_part_that_is_left_out_is_refused(truth):
    from toile.studio.options import StudioOptions

    with pytest.raises(UserError, match="hard.floor is changed, but truth is '.*', which leaves that part out"):
        StudioOptions(truth=truth, hard={"floor": False})
    assert StudioOptions(truth="surface+webs", hard={"surface": 0.007}).amounts.surface == 0.007
    assert not StudioOptions(hard={"floor": False}).amounts.floor
