"""Features of poses: where the skeleton alone carries a garment."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.support import small_avatar as small
from toile.avatar.model.carried import SPREAD, Carried, Projection, nearest_rotation
from toile.avatar.model.skinning import Skeleton
from toile.surface.sampling import spread_points

UP = torch.tensor([0.0, 0, 1])
FACE = torch.as_tensor(small.FACE, dtype=torch.float32)


@pytest.fixture(scope="module")
def carried():
    return Carried([small.SHIRT, small.JACKET], Skeleton(small.JOINTS, small.PARENTS), UP, FACE)


def poses(seed=0, count=5):
    return torch.as_tensor(np.random.default_rng(seed).normal(0, 0.3, (count, 3, 3)), dtype=torch.float32)


def test_the_rest_pose_is_zero(carried):
    assert carried(torch.zeros(1, 3, 3)).abs().max() < 1e-6
    assert carried(torch.zeros(2, 3, 3), FACE.expand(2, -1, -1)).shape == (2, carried.size)


def test_which_way_the_person_faces_changes_nothing(carried):
    before = poses()
    turned = before.clone()
    turn = Rotation.from_rotvec([0, 0, 1.3])
    turned[:, 0] = torch.as_tensor((turn * Rotation.from_rotvec(before[:, 0].numpy())).as_rotvec())
    assert torch.allclose(carried(before), carried(turned), atol=1e-5)


def test_a_tilt_shows_in_the_direction_of_up_alone(carried):
    tilted = torch.zeros(1, 3, 3)
    tilted[0, 0] = torch.tensor([0.4, 0, 0])
    found = carried(tilted)[0]
    garments = found[: -FACE.numel()].split(len(found[: -FACE.numel()]) // 2)
    for one, layer in zip(garments, (small.SHIRT, small.JACKET)):
        radius = np.linalg.norm(layer.rest - layer.rest.mean(0), axis=1)
        assert one[:-3].abs().max() < 1e-6
        assert one[-3:].norm().item() == pytest.approx(np.sqrt((radius**2).mean()) * 2 * np.sin(0.2), rel=0.02)


def test_squared_distances_are_means_over_the_cloth(carried):
    """Against numpy and scipy: skinned, aligned, compared."""
    pose = poses(count=1)
    found = carried(pose)[0]
    R, world = [], np.eye(3)
    for r in pose[0].double().numpy():
        world = world @ Rotation.from_rotvec(r).as_matrix()
        R.append(world)
    x = [np.zeros(3)]
    for k in (1, 2):
        x.append(x[-1] + R[k - 1] @ (small.JOINTS[k] - small.JOINTS[k - 1]))
    V = small.SHIRT.rest
    skinned = sum(small.SHIRT.skin_val[:, k, None] * ((V - small.JOINTS[k]) @ R[k].T + x[k]) for k in range(3))
    skinned, V = skinned - skinned.mean(0), V - V.mean(0)
    back = Rotation.align_vectors(V, skinned)[0]
    moved = back.apply(skinned) - V
    assert len(V) * 3 + 3 == (carried.size - FACE.numel()) / 2  # all of so few vertices are taken
    assert found[: 3 * len(V)].square().sum().item() == pytest.approx((moved**2).sum(1).mean(), rel=1e-4)


def test_a_joint_that_moves_no_cloth_changes_nothing():
    free = Carried([small.SHIRT], Skeleton(np.r_[small.JOINTS, [[0.3, 0, 0.4]]], np.r_[small.PARENTS, 2]), UP)
    still, moving = torch.zeros(1, 4, 3), torch.zeros(1, 4, 3)
    moving[0, 3] = 1.0
    assert torch.equal(free(still), free(moving))


def test_faces_unseen_are_as_the_mean(carried):
    face = FACE.expand(2, -1, -1).clone()
    face[0, 1] += 0.01
    face[1, 0] = torch.nan
    found = carried(poses(count=2) * 0, face)[:, -FACE.numel() :]
    assert found[0].square().sum().item() == pytest.approx(3 * 0.01**2 / 2, rel=1e-3) and found[1].abs().max() == 0


def test_the_nearest_rotation_is_scipys():
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 6, 20, 3))
    found = nearest_rotation(torch.as_tensor(x.transpose(0, 2, 1) @ y))
    for Q, a, b in zip(found.numpy(), x, y):
        assert np.allclose(Q.T, Rotation.align_vectors(b, a)[0].as_matrix(), atol=1e-6)


def test_points_lie_as_far_apart_as_they_can():
    V = np.random.default_rng(0).uniform(size=(400, 3))
    at = spread_points(V, 30)
    apart = np.linalg.norm(V[at][:, None] - V[at], axis=2) + 9 * np.eye(30)
    uncovered = np.linalg.norm(V[:, None] - V[at], axis=2).min(1).max()
    assert len(set(at)) == 30 and apart.min() >= uncovered  # the law of farthest points
    assert spread_points(V[:7], 30).tolist() == list(range(7))


def test_a_projection_keeps_distances_up_to_one_scale():
    torch.manual_seed(0)
    features = torch.randn(200, 3, dtype=torch.float64) @ torch.randn(3, 50, dtype=torch.float64)
    projection = Projection(50)
    projection.fit(features)
    x = features.float()
    seen = projection(x)
    assert seen.square().sum(1).mean().sqrt().item() == pytest.approx(SPREAD, rel=1e-4)
    ratio = torch.pdist(seen) / torch.pdist(x)
    assert torch.allclose(ratio, ratio[:1].expand_as(ratio), rtol=1e-3)
    assert (seen.square().mean(0)[:3].diff() < 0).all() and seen[:, 3:].abs().max() < 1e-2


def test_directions_that_training_never_took_are_not_read():
    torch.manual_seed(0)
    projection, line = Projection(20), torch.randn(20)
    projection.fit(torch.randn(9, 1) * line + 1.0)
    off = torch.randn(20)
    off -= line * (off @ line) / (line @ line)
    moved = projection(torch.stack([off, line])) - projection(torch.zeros(20))
    assert moved[0].abs().max() < 1e-3 and moved[1].abs().max() > 0.5
