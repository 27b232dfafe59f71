"""The skeleton and inner kernels where data are extreme. Each row is marked beforehand by its name: solved (the clean answer),
said ("unmatched"), or refused with the argument and index."""

from types import SimpleNamespace

import numpy as np
import pytest

from toile.io.body import load_body_model
from toile.kernels import InnerSolver, InputError, SkeletonSolver

from .test_nricp import put
from .ugly import HOLES, UGLY, isolated


@pytest.fixture(scope="module")
def body():
    model = load_body_model()
    points = model.keypoints(model.v_template, model.J)
    return SimpleNamespace(model=model, V=model.v_template, points=points, solver=SkeletonSolver(model))


def seen(body, offset=0.0):
    return SimpleNamespace(names=body.model.keypoint_names, points=body.points + offset, sigma=None)


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e6])
def test_skeleton_far_from_the_origin(body, offset):
    result = body.solver.solve(body.V + offset, body.model.f, seen(body, offset))
    assert result.stop == "converged" and np.abs(result.V - body.V - offset).max() < 1e-8


def test_skeleton_on_duplicate_and_zero_area_faces_and_isolated_vertices(body):
    f = body.model.f
    faces = np.concatenate([f, f[:100], f[:50][:, [0, 0, 1]]])
    result = body.solver.solve(np.concatenate([body.V, [[9.0, 9, 9]]]), faces, seen(body))
    assert np.abs(result.V - body.V).max() < 1e-6


def test_skeleton_on_a_scan_out_of_reach_says_so(body):
    for keypoints in (seen(body), None):
        start = (np.zeros((104, 3)), np.zeros(3), np.zeros(16))
        result = body.solver.solve(body.V + 50, body.model.f, keypoints, start=start)
        assert result.stop == "unmatched" and result.matched == 0
        assert np.abs(result.V - body.V).max() < 1e-6


def test_skeleton_on_a_scan_full_of_holes(body):
    faces = body.model.f[np.random.default_rng(0).random(len(body.model.f)) < 0.2]
    result = body.solver.solve(body.V, faces, seen(body))
    error = np.linalg.norm(result.V - body.V, axis=1)
    assert error.mean() < 1e-4 and error.max() < 3e-3


def test_inner_that_sees_nothing_is_the_model_and_that_sees_all_is_the_skin(body):
    solver = InnerSolver(body.model)
    n = len(body.V)
    blind = (np.zeros((104, 3)), np.zeros(3), body.V + 0.01, np.zeros(n), [])
    fused = solver.fuse([blind])
    assert np.abs(fused.rest - body.V).max() < 1e-9 and fused.observed == fused.bounded == 0
    assert np.abs(solver.solve(body.V, *blind).V - body.V).max() < 1e-9
    far = np.full(3, 1e6)
    assert np.abs(solver.fuse([(np.zeros((104, 3)), far, body.V + far, np.ones(n), [])]).rest - body.V).max() < 1e-6


# --- skeleton: a posed, shaped body -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def posed(body):
    rng = np.random.default_rng(5)
    rotations = np.zeros((104, 3))
    for k, name in enumerate(body.model.joint_names):
        bend = {"spine": 0.08, "upperarm01": 0.4, "upperleg01": 0.3, "lowerarm01": 0.4}
        rotations[k] = rng.uniform(-1, 1, 3) * next((s for p, s in bend.items() if name.startswith(p)), 0)
    rest, J = body.model.rest(rng.normal(0, 0.6, 16))
    translation = np.array([0.4, -0.3, 1.0])
    V = body.model.skin(rest, J, rotations, translation)
    joints = body.model.joint_transforms(J, rotations, translation)[1]
    return SimpleNamespace(V=V, joints=joints, points=body.model.keypoints(V, joints))


def keypoints(body, posed, sigma=None, scale=1.0):
    n = len(posed.points)
    sigma = None if sigma is None else np.full(n, sigma)
    return SimpleNamespace(names=body.model.keypoint_names, points=scale * posed.points, sigma=sigma)


@pytest.mark.parametrize("spoil", UGLY + HOLES)
def test_skeleton_solved_on_an_ugly_scan(spoil, body, posed):
    result = body.solver.solve(*spoil(posed.V, body.model.f), keypoints(body, posed))
    assert result.stop == "converged"
    assert np.linalg.norm(result.joints - posed.joints, axis=1).mean() < 3e-4  # clean: 0.26 mm
    assert np.linalg.norm(result.V - posed.V, axis=1).mean() < 5.5e-4  # clean: 0.46 mm


def test_skeleton_without_keypoints_is_not_swayed_by_stray_vertices(body):
    V, F = isolated(body.V, body.model.f)
    result = body.solver.solve(V, F)
    assert result.stop == "converged" and np.abs(result.V - body.V).max() < 1e-6


@pytest.mark.parametrize("sigma", [1e-300, 1e-12, 1e-6, 1e-4, 1e-3, 1.0, 1e12, 1e300])
def test_skeleton_solved_with_keypoints_from_exact_to_void(sigma, body, posed):
    result = body.solver.solve(posed.V, body.model.f, keypoints(body, posed, sigma))
    assert np.linalg.norm(result.joints - posed.joints, axis=1).mean() < 1e-3


@pytest.mark.parametrize("weight", [1e-8, 1e-3, 1e3, 1e7, 1e12])
def test_skeleton_solved_with_any_weight_of_the_surface(weight, body, posed):
    result = SkeletonSolver(body.model, surface_weight=weight).solve(posed.V, body.model.f, keypoints(body, posed))
    assert result.stop == "converged" and np.linalg.norm(result.joints - posed.joints, axis=1).mean() < 1e-3


@pytest.mark.parametrize("scale", [1e3, 1e6])
def test_skeleton_says_that_a_scan_in_small_units_is_out_of_reach(scale, body, posed):
    for marks in (keypoints(body, posed), keypoints(body, posed, scale=scale)):
        assert body.solver.solve(scale * posed.V, body.model.f, marks).stop == "unmatched"


@pytest.mark.parametrize("change, message", [
    (dict(scan_V=lambda V, F: 1e-3 * V), "the faces of scan_V span less than a fiftieth"),
    (dict(scan_V=lambda V, F: 0 * V), "the faces of scan_V span less than a fiftieth"),
    (dict(scan_F=lambda V, F: np.repeat(F[:1, :1], 3, axis=1)), "the faces of scan_V span less than a fiftieth"),
    (dict(scan_V=lambda V, F: put(V, 3, 1, 1e20)), "the faces of scan_V reach beyond 1e9"),
    (dict(scan_V=lambda V, F: put(V, 3, 1, np.nan)), r"scan_V\[3\] is not finite"),
    (dict(scan_V=lambda V, F: put(V, 3, 1, -np.inf)), r"scan_V\[3\] is not finite"),
    (dict(scan_F=lambda V, F: put(F, 7, 1, len(V))), r"scan_F\[7\] holds vertex 13718"),
    (dict(scan_F=lambda V, F: put(F, 7, 1, -1)), r"scan_F\[7\] holds vertex -1"),
    (dict(scan_F=lambda V, F: F[:0]), "scan_F is empty, scan_V has 13718 rows"),
    (dict(scan_V=lambda V, F: V[:0]), "scan_V is empty"),
])  # fmt: skip
def test_skeleton_refuses_a_bad_scan_by_name_and_index(change, message, body, posed):
    given = dict(scan_V=posed.V, scan_F=body.model.f)
    for name, spoil in change.items():
        given[name] = spoil(posed.V, body.model.f)
    with pytest.raises(InputError, match="skeleton: " + message):
        body.solver.solve(**given, keypoints=keypoints(body, posed))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_skeleton_refuses_numbers_that_are_none_by_name_and_index(value, body, posed):
    marks, rest = keypoints(body, posed), np.zeros((104, 3))
    marks.points = put(marks.points, 3, 1, value)
    cases = {
        r"keypoints.points\[3\] is not finite": dict(keypoints=marks),
        r"keypoints.sigma\[0\] must be positive": dict(keypoints=keypoints(body, posed, value)),
        r"start.rotations\[2\] is not finite": dict(start=(put(rest, 2, 0, value), np.zeros(3), np.zeros(16))),
        r"start.translation\[0\] is not finite": dict(start=(rest, np.full(3, value), np.zeros(16))),
        r"previous\[?0?\]?.*not finite": dict(previous=[(rest, np.zeros(3), np.full(16, value))]),
        r"clothed\[0\] must lie": dict(clothed=np.full(len(posed.V), value)),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match="skeleton: " + message):
            body.solver.solve(posed.V, body.model.f, **case)
    for name in ("surface_weight", "surface_sigma", "shape_weight", "reach", "min_cosine", "tolerance"):
        with pytest.raises(InputError, match="skeleton: "):
            SkeletonSolver(body.model, **{name: value})


# --- inner ------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def dressed(body):
    """A body at rest, its torso under a shirt 10 mm off the skin: model, tracked surface, visible, shirt."""
    from toile.kernels import vertex_normals

    V, F = body.V, body.model.f
    covered = np.zeros(len(V), bool)
    covered[body.model.segments["torso"]] = True
    shirt = V + 0.01 * vertex_normals(V, F)
    tracked = np.where(covered[:, None], shirt, V)
    solver = InnerSolver(body.model)
    frame = (np.zeros((104, 3)), np.zeros(3), tracked, (~covered).astype(float), [(shirt, F[covered[F].all(1)])])
    fused = solver.fuse([frame])
    return SimpleNamespace(solver=solver, frame=frame, rest=fused.rest, V=solver.solve(fused.rest, *frame).V)


@pytest.mark.parametrize("spoil", UGLY)
def test_inner_solved_under_an_ugly_garment(spoil, dressed):
    *rest, garments = dressed.frame
    garment_V, garment_F = spoil(*garments[0])
    used = np.unique(garments[0][1])
    assert np.linalg.norm(dressed.V - garments[0][0], axis=1)[used].max() < 0.02
    result = dressed.solver.solve(
        dressed.solver.fuse([(*rest, [(garment_V, garment_F)])]).rest, *rest, [(garment_V, garment_F)]
    )
    assert np.linalg.norm(result.V - dressed.V, axis=1).max() < 3e-3
    assert np.linalg.norm(result.V - dressed.V, axis=1).mean() < 3e-4


def test_inner_solved_with_garments_that_say_nothing(body, dressed):
    """Far away, or none: the model under what is hidden."""
    *rest, garments = dressed.frame
    bare = dressed.solver.solve(dressed.rest, *rest, []).V
    for offset in (1e3, 1e6, 1e20):
        far = dressed.solver.solve(dressed.rest, *rest, [(garments[0][0] + offset, garments[0][1])]).V
        np.testing.assert_allclose(far, bare, atol=1e-9)


@pytest.mark.parametrize("offset", [1e3, 1e6])
def test_inner_solved_far_from_the_origin(offset, dressed):
    rotations, translation, tracked, visible, garments = dressed.frame
    moved = (rotations, translation + offset, tracked + offset, visible, [(garments[0][0] + offset, garments[0][1])])
    np.testing.assert_allclose(dressed.solver.fuse([moved]).rest, dressed.rest, atol=1e-6)
    np.testing.assert_allclose(dressed.solver.solve(dressed.rest, *moved).V - offset, dressed.V, atol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_inner_refuses_what_is_not_finite(value, dressed):
    rotations, translation, tracked, visible, [(V, F)] = dressed.frame
    cases = {
        r"frame.rotations\[2\] is not finite": (put(rotations, 2, 0, value), translation, tracked, visible, [(V, F)]),
        r"frame.translation.* is not finite": (rotations, np.full(3, value), tracked, visible, [(V, F)]),
        r"frame.tracked\[5\] is not finite": (rotations, translation, put(tracked, 5, 1, value), visible, [(V, F)]),
        r"frame.visible\[7\]": (
            rotations,
            translation,
            tracked,
            np.where(np.arange(len(V)) == 7, value, visible),
            [(V, F)],
        ),
        r"frame.garments\[1\].V\[9\] is not finite": (
            rotations,
            translation,
            tracked,
            visible,
            [(V, F), (put(V, 9, 2, value), F)],
        ),
        r"frame.garments\[0\].F is empty": (rotations, translation, tracked, visible, [(V, F[:0])]),
        r"frame.garments\[0\].F\[3\] holds vertex -1": (
            rotations,
            translation,
            tracked,
            visible,
            [(V, put(F, 3, 0, -1))],
        ),
    }
    for message, case in cases.items():
        with pytest.raises(InputError, match="inner: " + message):
            dressed.solver.solve(dressed.rest, *case)
    for name in ("length", "skin", "out", "fit", "gap", "taper", "prior", "tightness", "inward"):
        with pytest.raises(InputError, match="inner: "):
            InnerSolver(dressed.solver.body_model, **{name: value})
