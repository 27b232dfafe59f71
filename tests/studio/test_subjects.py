"""Motions and subjects that are far from a slow walk of an average person."""

import numpy as np
import pytest


@pytest.mark.parametrize("seed", [1, 2])
def test_fast_hands_reach_three_metres_a_second_and_no_more(body, seed):
    from toile.studio.motion import FPS, RAMP
    from toile.studio.motions import make_motion
    from toile.studio.truth import ACCELERATION, STEP_MAX

    m = make_motion("fast", body, 40, np.random.default_rng(seed))
    wrists = [body.model.joint(f"wrist.{side}") for side in "LR"]
    path = np.array([body.joints(R, x)[wrists] for R, x in zip(m.rotations[RAMP:], m.root[RAMP:])])
    assert 2.2 < np.linalg.norm(np.diff(path, axis=0), axis=2).max() * FPS <= 3.0
    tips = np.array([body.pose(R, np.zeros(3)) for R in m.rotations[RAMP : RAMP + 12]])
    assert np.linalg.norm(np.diff(tips, axis=0), axis=2).max() < STEP_MAX
    assert np.linalg.norm(np.diff(tips, n=2, axis=0), axis=2).max() < ACCELERATION


def test_sitting_brings_the_knees_forward_and_up(body):
    from toile.studio.motion import RAMP
    from toile.studio.motions import make_motion

    m = make_motion("sit", body, 6, np.random.default_rng(1))
    at = body.joints(m.rotations[RAMP], np.zeros(3))
    hip, knee, foot = (at[body.model.joint(f"{j}.L")] for j in ("upperleg01", "lowerleg01", "foot"))
    thigh, shin = (knee - hip) / np.linalg.norm(knee - hip), (foot - knee) / np.linalg.norm(foot - knee)
    assert thigh @ [0, -1, 0] > 0.8 and shin @ [0, 0, -1] > 0.8  # forward, and down from there


@pytest.mark.parametrize("subject, low, high", [("child", 1.25, 1.5), ("tall", 1.98, 2.2), ("heavy", 1.6, 2.0)])
def test_subjects_have_their_size(body, subject, low, high):
    from toile.studio.body import make_body
    from toile.studio.garment import SIZES, size_of

    other = make_body(subject, np.random.default_rng(1))
    assert low < np.ptp(other.rest[:, 2]) < high
    girth = lambda b: np.ptp(b.rest[b.dense_weights[:, b.model.joint("spine04")] > 0.5], axis=0)[:2].sum()
    if subject == "heavy":
        assert girth(other) > 1.2 * girth(body)
    assert (size_of(subject, other) < SIZES[subject]) == (subject == "child")


def test_a_shirt_cut_for_a_child_with_thin_arms_touches_nothing():
    from toile.studio.body import make_body
    from toile.studio.cut import cut_garment
    from toile.studio.truth import pairs_between
    from toile.studio.truths import Hard

    body = make_body("child", np.random.default_rng([3, 0]), Hard())
    V, F = cut_garment("tshirt", body)
    sides = np.linalg.norm(V[F[:, [1, 2, 0]]] - V[F], axis=2)
    assert pairs_between(body.rest, body.skin_faces, V, F) == 0
    assert sides.max() < 0.025  # longer ones cut through an arm


ODD = [("child", "talk", "cut"), ("tall", "fast", "cut"), ("heavy", "talk", "cut"), ("fitted", "sit", "cut")]


@pytest.mark.slow(seconds=120)
@pytest.mark.parametrize("subject, motion, garment", ODD)
def test_odd_subjects_and_motions_are_accepted_within_two_seeds(tmp_path, subject, motion, garment):
    pytest.importorskip("newton")
    from toile.studio.make import accepted_sequence
    from toile.studio.options import StudioOptions

    options = StudioOptions(subject=subject, motion=motion, garment=garment, frames=6, seed=3)
    report, _ = accepted_sequence(tmp_path, options, lambda *_: None)
    assert len(report.rejected) < 2
