"""Openings of sleeves that run over the trunk are told, and are laid about the arm again; all others stay as they are."""

from dataclasses import replace

import numpy as np
import pytest

from toile.config import LoopSettings
from toile.io.body import load_body_model
from toile.surface.joined import Sleeves
from toile.surface.loops import LoopMatch

POINTS = 40
ANGLE = np.linspace(0, 2 * np.pi, POINTS, endpoint=False)


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny", up="z")


def sleeves(model):
    return Sleeves(model, model.v_template, model.J)


def axis(model, side="L"):
    way = model.J[model.joint(f"lowerarm01.{side}")] - model.J[model.joint(f"upperarm01.{side}")]
    return way / np.linalg.norm(way)


def cuff(model, side="L", radius=0.09, along=0.5):
    """A circle (k,3) about the upper arm."""
    shoulder, elbow = (model.J[model.joint(f"{role}.{side}")] for role in ("upperarm01", "lowerarm01"))
    a, b = np.linalg.svd(axis(model, side)[None])[2][1:]
    circle = np.cos(ANGLE)[:, None] * a + np.sin(ANGLE)[:, None] * b
    return shoulder + along * (elbow - shoulder) + radius * circle


def joined(model, name="sleeve_left"):
    """The same with a third of it laid on the skin of the flank, at the lowest rib."""
    loop = cuff(model, name[7].upper())
    flank = model.J[model.joint("spine04")] + np.array([0.14, 0, 0]) * np.sign(loop[:, 0].mean())
    loop[:14] = flank + 0.01 * np.stack([np.zeros(14), np.cos(ANGLE[:14]), np.sin(ANGLE[:14])], 1)
    return loop


@pytest.mark.parametrize("side, name", [("L", "sleeve_left"), ("R", "sleeve_right")])
@pytest.mark.parametrize("radius", [0.06, 0.12])
def test_an_opening_about_its_arm_lies_nowhere_at_the_trunk(model, side, name, radius):
    assert not sleeves(model).at_trunk(name, cuff(model, side, radius)).any()


@pytest.mark.parametrize("name", ["sleeve_left", "sleeve_right"])
def test_what_runs_over_the_flank_is_told_point_by_point(model, name):
    told = sleeves(model).at_trunk(name, joined(model, name))
    np.testing.assert_array_equal(np.flatnonzero(told), np.arange(14))


@pytest.mark.parametrize("name", ["hem", "neck", "armhole_left", "leg_left", "loop0"])
def test_of_other_openings_nothing_is_said(model, name):
    assert sleeves(model).at_trunk(name, joined(model)) is None


def test_of_a_model_that_names_no_arms_nothing_is_said(model):
    nameless = replace(model, joint_roles=tuple(f"joint{k}" for k in range(len(model.parents))))
    assert sleeves(nameless).at_trunk("sleeve_left", joined(model)) is None


def match_of(target, observed):
    return LoopMatch(target, observed, np.where(observed, 0.001, np.nan))


def test_a_match_about_its_arm_is_returned_as_it_is(model):
    match = match_of(cuff(model, along=0.45), np.ones(POINTS, bool))
    assert sleeves(model).parted("sleeve_left", cuff(model), match, LoopSettings()) is match
    hem = match_of(joined(model), np.ones(POINTS, bool))
    assert sleeves(model).parted("hem", cuff(model), hem, LoopSettings()) is hem


def test_what_lies_at_the_trunk_moves_along_the_arm_as_far_as_the_seen_part_does(model):
    at, target = cuff(model), joined(model)
    target[14:] += 0.03 * axis(model)  # the true end is 3 cm farther down
    made = sleeves(model).parted("sleeve_left", at, match_of(target, np.ones(POINTS, bool)), LoopSettings())
    assert not made.observed[:14].any() and made.observed[14:].all()
    assert np.isnan(made.distance[:14]).all()
    moved = made.target - at
    np.testing.assert_allclose(moved @ axis(model), 0.03, atol=0.003)
    assert np.linalg.norm(moved - (moved @ axis(model))[:, None] * axis(model), axis=1).max() < 0.01
    assert not sleeves(model).at_trunk("sleeve_left", made.target).any()


def test_an_opening_that_is_seen_at_the_trunk_alone_is_not_seen(model):
    at, target = cuff(model), joined(model)
    seen = np.arange(POINTS) < 14
    made = sleeves(model).parted("sleeve_left", at, match_of(target, seen), LoopSettings())
    assert not made.observed.any()
    np.testing.assert_allclose(made.target, at, atol=0.015)
