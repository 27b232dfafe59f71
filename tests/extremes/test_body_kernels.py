"""The skeleton and inner kernels where data are extreme: solved, or said to be unsolved, never silently wrong."""

from types import SimpleNamespace

import numpy as np
import pytest

from toile.io.body import load_body_model
from toile.kernels import InnerSolver, SkeletonSolver


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
