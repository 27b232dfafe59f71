"""Errors of labels and keypoints that last, and what scans have too much and too little."""

import numpy as np
import pytest

from toile.studio.keypoints import swap_pairs
from toile.studio.lasting import EPISODE, LastingKeypoints, LastingLabels
from toile.studio.pictures import OuterSurface, SyntheticView
from toile.studio.truths import PLAIN


@pytest.fixture(scope="module")
def ball():
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    return OuterSurface(np.asarray(ball.vertices), np.asarray(ball.faces), None, None)


class TwoHalves:
    """Label 3 above, 4 below."""

    def __init__(self, outer):
        self.neutral = outer.body
        self.arm = self.head = np.zeros(len(outer.body))

    def body_labels(self, neutral, arm, head):
        return np.where(neutral[:, 2] > 0, 3, 4)

    def cloth_labels(self, vertices):
        return np.zeros(len(vertices), int)


def view(points):
    """A picture, one pixel high, of points of the ball at rest."""
    true = np.where(points[:, 2] > 0, 3, 4).astype(np.uint8)
    mask = np.ones((1, len(points)), bool)
    return SyntheticView(np.zeros((1, len(points), 3), np.uint8), mask, true[None], mask * 1.0, points + 7.0, points)


def test_a_wrong_patch_is_wrong_in_every_picture_of_it(ball):
    lasting = LastingLabels(ball, TwoHalves(ball), 0.1, 0.004, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    points = rng.standard_normal((40_000, 3))
    points *= 0.5 / np.linalg.norm(points, axis=1, keepdims=True)
    (first,), share = lasting.images([view(points)])
    assert 0.08 < share < 0.12
    order = rng.permutation(len(points))
    (again,), _ = lasting.images([view(points[order])])
    assert np.array_equal(again[0], first[0, order])
    wrong = first[0] != view(points).labels[0]
    border = np.abs(points[:, 2]) < 0.02
    assert wrong[border].mean() > 2 * wrong[~border].mean()  # the border is shifted
    assert wrong[~border].any()  # and there are patches


class Impatient(np.random.Generator):
    """Draws no more than 5000 labels."""

    left = 5000

    def choice(self, *arguments, **options):
        self.left -= 1
        assert self.left, "goes on for ever"
        return super().choice(*arguments, **options)


def test_a_share_of_wrong_labels_that_no_draws_reach_ends_with_as_many_as_they_do(ball):
    lasting = LastingLabels(ball, TwoHalves(ball), 0.9, 0.004, Impatient(np.random.PCG64(1)))
    assert 0.35 < (lasting.wrong > 0).mean() < 0.9


class Table:
    names = (
        "body.wrist.L",
        "body.wrist.R",
        *(f"hand_left.f{i}.L" for i in range(3)),
        *(f"hand_right.f{i}.R" for i in range(3)),
    )


def spoilt(amounts, frames, camera=0):
    points = np.c_[np.arange(8.0), np.arange(8.0), np.full(8, 0.9)]
    lasting = LastingKeypoints(Table, 2, PLAIN.model_copy(update=amounts), seed=5)
    return points, np.array([lasting.spoil(points, camera, k) for k in frames])


def test_a_joint_is_found_at_the_same_wrong_place_in_every_frame_of_a_view():
    points, seen = spoilt({"keypoint_bias": 3.0}, range(0, 40, 7))
    assert np.array_equal(seen, np.broadcast_to(seen[0], seen.shape))
    assert 1 < np.abs(seen[0, :, :2] - points[:, :2]).mean() < 4
    assert not np.array_equal(spoilt({"keypoint_bias": 3.0}, [0], camera=1)[1][0], seen[0])


def test_hands_are_lost_and_exchanged_whole_and_for_a_while():
    points, lost = spoilt({"hand_drops": 0.4}, range(400))
    gone = lost[:, :, 2] == 0
    assert not gone[:, :2].any()
    assert (gone[:, 2:5].all(1) == gone[:, 2:5].any(1)).all()
    assert 0.2 < gone[:, 2].mean() < 0.6
    episodes = gone[:, 2].reshape(-1, EPISODE)
    assert (episodes.all(1) == episodes.any(1)).all()
    points, seen = spoilt({"hand_swaps": 1.0}, [0])
    pairs = swap_pairs(Table.names)
    assert (0, 1) in pairs and np.array_equal(seen[0, :2], points[:2])
    assert np.array_equal(seen[0, 2:5], points[5:]) and np.array_equal(seen[0, 5:], points[2:5])


def grid(n):
    """A sheet of 2 (n-1)^2 triangles in the unit square of x and y, looking up."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    return np.stack([x, y, 0 * x], -1).reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def test_only_what_looks_up_near_a_shoulder_is_lost():
    from toile.studio.scan_faults import SHOULDER_RADIUS, without_shoulders

    V, F = grid(60)
    joint = np.array([0.5, 0.5, 0.0])
    kept = without_shoulders(V, F, [joint], [joint], np.random.default_rng(0))
    gone = np.setdiff1d(np.arange(len(F)), [np.flatnonzero((F == f).all(1))[0] for f in kept])
    far = np.linalg.norm(V[F[gone]].mean(1) - joint, axis=1)
    assert 0.5 * np.pi * SHOULDER_RADIUS**2 < len(gone) / len(F) < 2 * np.pi * SHOULDER_RADIUS**2
    assert far.max() < 2 * SHOULDER_RADIUS
    assert len(without_shoulders(V, F[:, ::-1], [joint], [joint], np.random.default_rng(0))) == len(F)


def test_a_web_closes_a_narrow_gap_and_leaves_a_wide_one():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("open3d")
    from toile.studio.scan_faults import web

    def arm_and_trunk(gap):
        arm = trimesh.creation.cylinder(radius=0.04, height=0.4, sections=48)
        trunk = trimesh.creation.cylinder(radius=0.12, height=0.6, sections=48)
        arm.apply_translation([0.16 + gap, 0, 0])
        both = trimesh.util.concatenate([arm, trunk])
        outer = OuterSurface(np.asarray(both.vertices), np.asarray(both.faces), None, None)
        shoulder, elbow = np.array([[0.16 + gap, 0, 0.18], [0.16 + gap, 0, -0.18]])
        return web(outer, shoulder, elbow, np.zeros(3))

    V, F = arm_and_trunk(0.03)
    assert len(F) > 60
    assert 0.118 < V[:, 0].min() < V[:, 0].max() < 0.152 and abs(np.ptp(V[:, 0]) - 0.03) < 0.002
    n = np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])
    assert (n[:, 1] * V[F].mean(1)[:, 1] > 0).all()  # it looks outwards on both sides
    assert len(arm_and_trunk(0.12)[0]) == 0


def test_the_floor_and_what_stays_beside_the_person_stay_where_they_are():
    pytest.importorskip("trimesh")
    from toile.studio.scan_faults import floor_piece, staying_piece

    (a, FA), (b, FB) = (floor_piece(0.1, np.random.default_rng(1), np.random.default_rng(k)) for k in (2, 3))
    assert np.array_equal(FA, FB) and np.array_equal(a[:, :2], b[:, :2]) and not np.array_equal(a, b)
    assert abs(a[:, 2].mean() - 0.1) < 1e-3 and len(FA) > 200
    assert np.array_equal(staying_piece(np.random.default_rng(1))[0], staying_piece(np.random.default_rng(1))[0])
