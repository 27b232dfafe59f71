"""The pixels that show a face, and what decoded facial keypoints err by."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.avatar.measure.face import Facial
from toile.io.body import load_body_model

K = np.array([[600.0, 0, 100], [0, 600, 100], [0, 0, 1]])
FRONT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from -y, where the person looks; y down
NOSE = "face.nose_tip"


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def true(model):
    return dict(zip(model.keypoint_names, model.keypoints(model.v_template, model.J)))


def seen(model, turn):
    """The person a metre before the camera, its nose in the middle, turned about the vertical by degrees."""
    V = model.v_template - model.keypoints(model.v_template, model.J)[model.keypoint_names.index(NOSE)]
    V = V @ Rotation.from_euler("z", turn, degrees=True).as_matrix().T @ FRONT.T + [0, 0, 1]
    return Facial(model).pixels(V, K, (200, 200))


def test_the_face_is_seen_from_before_and_not_from_behind(model):
    front = seen(model, 0)
    assert front[100, 100] and 5000 < front.sum() < 20000
    assert seen(model, 180).sum() < 0.1 * front.sum()  # ears


def test_the_face_is_no_more_than_its_reach(model):
    rows, columns = np.nonzero(seen(model, 0))
    assert np.ptp(rows) < 600 * 0.25 and np.ptp(columns) < 600 * 0.22


def test_a_body_without_facial_keypoints_has_no_face(model):
    bare = replace(model, keypoint_names=(), keypoint_joint=np.zeros(0, np.int64), keypoint_vertices=())
    assert not Facial(bare).pixels(model.v_template + [0, 0, 3], K, (50, 50)).any()
    assert Facial(bare).errors(model.v_template, {}) == {"face_mm": None, "expression_mm": None}


def test_a_moved_head_is_an_error_of_the_face_and_none_of_its_expression(model, true):
    R = Rotation.from_rotvec([0, 0, 0.1]).as_matrix()
    found = Facial(model).errors(model.v_template @ R.T + [0.01, 0, 0], true)
    assert found["face_mm"] > 5 and found["expression_mm"] < 1e-9


def test_an_open_mouth_is_an_error_of_the_expression(model, true):
    V, lip = model.v_template.copy(), model.keypoint_names.index("face.lip_lower")
    V[model.keypoint_vertices[lip], 2] -= 0.02
    found, count = Facial(model).errors(V, true), len(model.face_names)
    assert found["face_mm"] == pytest.approx(20 / count)
    assert 0.7 * found["face_mm"] < found["expression_mm"] < 2.5 * found["face_mm"]
