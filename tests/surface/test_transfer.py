"""Skinning weights that a garment takes over from the body."""

from types import SimpleNamespace

import numpy as np

from tests.support.shapes import tube
from toile import kernels
from toile.surface.transfer import transfer_skin

LEG, APART, LOW, HIGH = 0.07, 0.10, 0.1, 0.8  # m: radius, half the way between the legs, heights


def legs():
    """A body of two upright tubes, each skinned to a joint of its own."""
    V, F = tube(60, 48, LEG, HIGH)
    V = np.concatenate([V + [-APART, 0, 0], V + [APART, 0, 0]])
    F = np.concatenate([F, F + len(V) // 2]).astype(np.int32)
    side = (V[:, 0] > 0).astype(np.int32)
    return SimpleNamespace(
        v_template=V, f=F, parents=(-1, 0), weights_idx=side[:, None], weights_val=np.ones((len(V), 1))
    )


def skirt():
    """A tube around both legs, 1 cm off them at their outer, front and back sides."""
    V, F = tube(60, 96, 1.0, HIGH - 2 * LOW)
    flat = np.clip(V[:, 0] * (APART + LEG + 0.01), -APART, APART)  # the straight panels between the legs' fronts
    angle = np.arctan2(V[:, 1], V[:, 0])
    radius = LEG + 0.01
    x = np.where(np.abs(np.cos(angle)) < 0.7, flat, np.sign(V[:, 0]) * APART + radius * np.cos(angle))
    y = np.where(np.abs(np.cos(angle)) < 0.7, np.sign(V[:, 1]) * radius, radius * np.sin(angle))
    return np.stack([x, y, V[:, 2] + LOW], 1), F.astype(np.int32)


def test_between_the_legs_of_a_skirt_weights_go_over_evenly():
    V, F = skirt()
    weights = transfer_skin(legs(), V, F, 0)
    i, j = kernels.unique_edges(F).T
    assert np.abs(weights[i] - weights[j]).max() < 0.25
    outer = np.abs(V[:, 0]) > APART + 0.03
    assert np.allclose(weights[outer, 1], V[outer, 0] > 0, atol=0.02)


def test_weights_are_shares_also_where_the_body_is_far():
    V, F = skirt()
    weights = transfer_skin(legs(), V * [3.0, 3.0, 1.0], F, 0)
    assert (weights >= 0).all() and np.allclose(weights.sum(1), 1)
    right = V[:, 0] > 0.05
    assert (weights[right, 1] > 0.5).all()


def test_cloth_that_lies_on_the_body_moves_as_the_body_there():
    body = legs()
    weights = transfer_skin(body, body.v_template, body.f, 0)
    assert np.allclose(weights[:, 1], body.v_template[:, 0] > 0, atol=1e-6)
