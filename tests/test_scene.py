"""The types that flow through the pipeline."""

import numpy as np
import pytest

from tests.fuzz.bodies import sound_body
from toile.kernels import InputError

MODEL = sound_body()
REST, J = MODEL.v_template, MODEL.J
TURNS, MOVE = np.linspace(0, 0.3, J.size).reshape(J.shape), np.array([0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "given", [np.ndarray.tolist, np.asfortranarray, lambda a: a.astype(">f8"), lambda a: a[::-1][::-1]]
)
def test_a_body_is_posed_alike_by_whatever_holds_its_numbers(given):
    rest, joints = MODEL.rest(given(np.zeros(1)))
    assert np.array_equal(rest, REST) and np.array_equal(joints, J)
    posed = MODEL.skin(REST, J, TURNS, MOVE)
    assert np.array_equal(MODEL.skin(given(REST), given(J), given(TURNS), given(MOVE)), posed)
    assert np.abs(np.asarray(MODEL.unskin(given(posed), given(J), given(TURNS), given(MOVE))) - REST).max() < 1e-12
    for found, want in zip(
        MODEL.joint_transforms(given(J), given(TURNS), given(MOVE)), MODEL.joint_transforms(J, TURNS, MOVE)
    ):
        assert np.array_equal(found, want)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: MODEL.rest(np.zeros(99)), "rest: shape has 99 coefficients, the model has"),
        (lambda: MODEL.rest(0.5), r"rest: shape has shape \(\)"),
        (lambda: MODEL.skin(REST[:-1], J, TURNS, MOVE), "skin: rest has shape"),
        (lambda: MODEL.unskin(REST[:-1], J, TURNS, MOVE), "unskin: posed has shape"),
        (lambda: MODEL.joint_transforms(J[:-1], TURNS, MOVE), "joint_transforms: J has shape"),
        (lambda: MODEL.joint_transforms(J, TURNS[:-1], MOVE), "joint_transforms: rotations has shape"),
        (lambda: MODEL.joint_transforms(J, TURNS, 0.1), "joint_transforms: translation has shape"),
    ],
)
def test_a_body_refuses_by_name_what_does_not_fit_it(call, said):
    with pytest.raises(InputError, match=said):
        call()
