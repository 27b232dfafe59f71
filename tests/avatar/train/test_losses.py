"""Each loss against its equation, and on what is empty or extreme."""

import math

import numpy as np
import pytest
import torch

from toile import kernels
from toile.avatar.model.operators import Facing, joint_centroids, uniform_laplacian
from toile.avatar.train import losses

NOTHING = torch.zeros(2, 5)


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def octahedron():
    """6 vertices of 4 neighbours each, 8 faces, and a seventh vertex that no face uses."""
    v = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [5, 5, 5]], dtype=float)
    f = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    return v, f


def test_geometry_counts_square_centimetres():
    v = torch.randn(2, 5, 3)
    assert losses.geometry(v + torch.tensor([0.0, 0.03, 0.04]), v).item() == pytest.approx(25, rel=1e-4)


def test_geometry_is_a_mean_over_weighted_vertices_only():
    v, weight = torch.zeros(1, 3, 3), torch.tensor([[1.0, 3.0, 0.0]])
    p = torch.tensor([[[0.01, 0, 0], [0, 0.02, 0], [math.nan, math.inf, 0]]], requires_grad=True)
    loss = losses.geometry(p, v, weight)
    assert loss.item() == pytest.approx((1 * 1 + 3 * 4) / 4, rel=1e-5)
    loss.backward()
    assert not p.grad[0, 2].any()


@pytest.mark.parametrize("shape", [(2, 3, 4, 5), (2, 1, 4, 5), (1, 1, 1, 1)])
def test_a_weighted_mean_square_and_its_slope_are_autograd_s(shape):
    error, weight = torch.randn(2, 3, 4, 5, requires_grad=True), torch.rand(shape)
    weight[..., 1:] *= torch.rand(shape)[..., 1:] > 0.5
    plain = (weight * error.square()).sum() / weight.expand_as(error).sum()
    (expected,) = torch.autograd.grad(1.7 * plain, error)
    found = losses.MeanSquare.apply(error, weight)
    (slope,) = torch.autograd.grad(1.7 * found, error)
    torch.testing.assert_close(found, plain)
    torch.testing.assert_close(slope, expected)


def test_a_mean_square_of_nothing_is_zero_and_pulls_nowhere():
    error = torch.full((1, 3, 2, 2), math.nan, requires_grad=True)
    found = losses.MeanSquare.apply(error, torch.zeros(1, 1, 2, 2))
    found.backward()
    assert found == 0 and not error.grad.any()


def test_laplacian_is_zero_for_translations_and_for_unused_vertices():
    v, f = octahedron()
    operator = uniform_laplacian(f, len(v))
    x = torch.as_tensor(v).float()[None]
    moved = x + torch.tensor([0.3, -0.2, 0.1])
    assert losses.laplacian(operator, moved, x).item() == pytest.approx(0, abs=1e-7)
    assert not operator(x)[0, 6].any()


def test_laplacian_is_the_vertex_less_the_mean_of_its_neighbours():
    v, f = octahedron()
    x = torch.randn(3, len(v), 3)
    got = uniform_laplacian(f, len(v))(x)
    assert torch.allclose(got[:, 0], x[:, 0] - x[:, 2:6].mean(1), atol=1e-6)
    assert torch.allclose(got[:, 4], x[:, 4] - x[:, :4].mean(1), atol=1e-6)


def test_laplacian_s_gradient_is_its_transpose():
    v, f = octahedron()
    operator, y = uniform_laplacian(f, len(v)), torch.randn(2, len(v), 3)
    x = torch.randn(2, len(v), 3, requires_grad=True)
    (operator(x) * y).sum().backward()
    dense = operator.sparse("matrix", operator.shape).to_dense()
    assert torch.allclose(x.grad, torch.einsum("ij,bic->bjc", dense, y), atol=1e-6)


def test_laplacian_of_one_moved_vertex():
    v, f = octahedron()
    x = torch.as_tensor(v).float()[None]
    p = x.clone()
    p[0, 0, 0] += 0.01  # itself 1 cm, each of its 4 neighbours a quarter, over 7 vertices
    operator = uniform_laplacian(f, len(v))
    assert losses.laplacian(operator, p, x).item() == pytest.approx((1 + 4 / 16) / 7, rel=1e-4)


def test_view_code_is_the_cosine_between_normal_and_view():
    v, f = octahedron()
    x = torch.as_tensor(v).float().expand(2, -1, -1) * torch.tensor([1.0, 3.0])[:, None, None]  # any size
    cosine = Facing(f)(x, torch.tensor([[10.0, 0, 0], [3.0, 3.0, 0]]))
    assert cosine[0, :2, 0].tolist() == pytest.approx([1, -1], abs=1e-6)  # the normal of (1,0,0) is itself
    assert cosine[0, 2].item() == pytest.approx(-1 / math.sqrt(101), abs=1e-6)
    assert cosine[1, 0].item() == pytest.approx(0, abs=1e-6)
    assert cosine[0, 6] == 0  # no face, no normal


def test_normals_in_torch_are_the_core_s():
    v, f = octahedron()
    x = torch.as_tensor(v).float()[None] + 0.1 * torch.randn(2, len(v), 3)  # the last vertex has no face
    flat = torch.zeros(2, len(v), 3)
    for vertices, faces in ((x, f), (x, np.concatenate([f, f[:, ::-1]])), (flat, f), (1e-3 * x, f)):
        core = [torch.from_numpy(kernels.vertex_normals(one.double().numpy(), faces)) for one in vertices]
        torch.testing.assert_close(Facing(faces).in_torch(vertices), torch.stack(core).float(), atol=1e-5, rtol=0)


def test_texture_is_a_mean_over_seen_texels_and_channels():
    target, weight = torch.rand(1, 3, 2, 2), torch.tensor([[[[1.0, 0.5], [0.0, 0.0]]]])
    predicted = target.clone()
    predicted[0, 0, 0, 0] += 0.3
    predicted[0, :, 1] = math.nan
    assert losses.texture(predicted, target, weight).item() == pytest.approx(0.09 / (3 * 1.5), rel=1e-4)


def test_kl_of_a_gaussian_equals_the_integral():
    mean, sigma = 0.7, 0.4
    x = np.linspace(-12, 12, 400_001)
    p = np.exp(-0.5 * ((x - mean) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    log_ratio = -0.5 * ((x - mean) / sigma) ** 2 - np.log(sigma) + 0.5 * x**2
    expected = np.trapezoid(p * log_ratio, x)
    got = losses.kl(torch.full((2, 3), mean), torch.full((2, 3), 2 * math.log(sigma)))
    assert got.item() == pytest.approx(3 * expected, rel=1e-5)  # summed over the code, mean over the batch
    assert losses.kl(torch.zeros(2, 3), torch.zeros(2, 3)).item() == 0


def test_kl_agrees_with_torch():
    from torch.distributions import Normal, kl_divergence

    mean, logvar = torch.randn(4, 6), torch.randn(4, 6)
    expected = kl_divergence(Normal(mean, (0.5 * logvar).exp()), Normal(0.0, 1.0)).sum(-1).mean()
    assert torch.allclose(losses.kl(mean, logvar), expected, rtol=1e-5)


@pytest.mark.parametrize("logvar", [-10.0, 10.0])
def test_kl_is_finite_at_the_bounds_of_logvar(logvar):
    x = torch.full((1, 128), logvar, requires_grad=True)
    losses.kl(torch.zeros(1, 128), x).backward()
    assert torch.isfinite(x.grad).all() and x.grad[0, 0] * logvar > 0  # leads back to 0


def test_image_is_compared_on_the_captured_foreground():
    captured, mask = torch.rand(1, 3, 2, 2), torch.tensor([[[1.0, 1.0], [0.0, 0.0]]])
    rendered = captured + torch.tensor([0.2, -0.1]).reshape(1, 1, 1, 2)
    rendered[..., 1, :] = 77
    assert losses.image_l1(rendered, captured, mask).item() == pytest.approx(0.15, rel=1e-4)


def test_mask_is_compared_everywhere():
    captured = torch.tensor([[[1.0, 1.0], [0.0, 0.0]]])
    assert losses.mask_l1(torch.tensor([[[1.0, 0.0], [1.0, 0.0]]]), captured).item() == pytest.approx(0.5)


def depths(cloth, body):
    return torch.tensor([[[body]], [[cloth]]], requires_grad=True)


CLOTH = torch.tensor([[3]])


def test_soft_visibility_is_s_squared_where_the_body_is_in_front():
    s = 1 / (1 + math.exp(-2))  # the cloth 1 cm behind, c = 5 mm
    assert losses.soft_visibility(depths(2.01, 2.0), CLOTH, [-1, 3], 0.005).item() == pytest.approx(s * s, rel=1e-3)


@pytest.mark.parametrize(
    "cloth, body, label",
    [(1.99, 2.0, 3), (2.01, 2.0, 1), (2.01, math.inf, 3), (math.inf, 2.0, 3), (math.inf, math.inf, 3)],
)
def test_soft_visibility_is_0_where_order_label_or_cover_ask_for_nothing(cloth, body, label):
    depth = depths(cloth, body)
    loss = losses.soft_visibility(depth, torch.tensor([[label]]), [-1, 3], 0.005)
    loss.backward()
    assert loss.item() == 0 and torch.equal(depth.grad, torch.zeros_like(depth))


def test_soft_visibility_pulls_cloth_forward_and_body_back():
    depth = depths(2.004, 2.0)
    losses.soft_visibility(depth, CLOTH, [-1, 3], 0.005).backward()
    assert depth.grad[1] > 0 > depth.grad[0]


def test_soft_visibility_compares_a_garment_with_the_nearest_other_layer():
    depth = torch.tensor([2.0, 2.1, 1.9]).reshape(3, 1, 1)  # body, shirt, jacket
    s = 1 / (1 + math.exp(-0.2 / 0.1))  # the shirt is seen here: the jacket is 20 cm before it
    assert losses.soft_visibility(depth, CLOTH, [-1, 3, 4], 0.1).item() == pytest.approx(s * s, rel=1e-4)
    assert losses.soft_visibility(depth, torch.tensor([[4]]), [-1, 3, 4], 0.1).item() == 0


def test_soft_visibility_without_a_garment_or_without_another_layer_is_0():
    assert losses.soft_visibility(torch.ones(1, 2, 2), torch.full((2, 2), 3), [-1], 0.01).item() == 0
    assert losses.soft_visibility(torch.ones(1, 2, 2), torch.full((2, 2), 3), [3], 0.01).item() == 0


def test_imputation_sees_joints_and_not_wrinkles():
    idx = np.repeat(np.arange(2), 4).reshape(8, 1)
    anchors = joint_centroids(idx, np.ones((8, 1)), 3)
    v = torch.randn(1, 8, 3)
    wrinkled = v.clone()
    wrinkled[0, 0, 1] += 0.02
    wrinkled[0, 1, 1] -= 0.02
    moved = v.clone()
    moved[0, :4, 1] += 0.03
    assert losses.impute(anchors, wrinkled, v).item() == pytest.approx(0, abs=1e-6)
    assert losses.impute(anchors, moved, v).item() == pytest.approx(9 / 3, rel=1e-4)  # one of three joints moved


def empty_losses():
    x = torch.rand(2, 3, 4, 4, requires_grad=True)
    v = torch.rand(2, 5, 3, requires_grad=True)
    none = torch.zeros(2, 1, 4, 4)
    operator = uniform_laplacian(np.zeros((0, 3), int), 5)
    return {
        "geometry": lambda: (losses.geometry(v, torch.zeros(2, 5, 3), NOTHING), v),
        "laplacian": lambda: (losses.laplacian(operator, v, torch.zeros(2, 5, 3), NOTHING), v),
        "texture": lambda: (losses.texture(x, torch.full((2, 3, 4, 4), math.nan), none), x),
        "image": lambda: (losses.image_l1(x, torch.full((2, 3, 4, 4), math.nan), none[:, 0]), x),
        "mask": lambda: (losses.mask_l1(x[:, 0] * 0, none[:, 0]), x),
    }


@pytest.mark.parametrize("name", empty_losses())
def test_a_loss_over_nothing_is_0_with_zero_gradient(name):
    loss, x = empty_losses()[name]()
    loss.backward()
    assert loss.item() == 0 and torch.equal(x.grad, torch.zeros_like(x.grad))


@pytest.mark.parametrize("value", [0.0, 1.0, 1e4])
def test_black_white_and_saturated_pictures_give_finite_losses(value):
    x = torch.full((1, 3, 4, 4), 0.5, requires_grad=True)
    seen = torch.full((1, 3, 4, 4), value)
    loss = losses.image_l1(x, seen, torch.ones(1, 4, 4)) + losses.texture(x, seen, torch.ones(1, 1, 4, 4))
    loss.backward()
    assert math.isfinite(loss.item()) and torch.isfinite(x.grad).all()


def test_losses_are_float32_from_bf16():
    x = torch.rand(1, 3, 4, 4, dtype=torch.bfloat16)
    assert losses.texture(x, x + 1, torch.ones(1, 1, 4, 4)).dtype == torch.float32
    assert losses.kl(x[:, 0, 0], x[:, 0, 0]).dtype == torch.float32


def test_total_is_the_weighted_sum_and_knows_its_names():
    weights = {"geometry": 2.0, "kl": 0.5, "image": 1.0}
    given = {"geometry": torch.tensor(3.0), "kl": torch.tensor(4.0)}
    assert losses.total(given, weights).item() == 8
    with pytest.raises(KeyError, match="wrinkle"):
        losses.total({"wrinkle": torch.tensor(1.0)}, weights)
    with pytest.raises(ValueError, match="no loss"):
        losses.total({}, weights)


def test_total_takes_the_weights_of_the_settings():
    from toile.avatar.settings import LossWeights

    weights = LossWeights(geometry=3.0)
    assert losses.total({"geometry": torch.tensor(2.0)}, weights).item() == 6
    names = set(LossWeights.model_fields)
    assert losses.total({name: torch.tensor(1.0) for name in names}, weights).item() == pytest.approx(
        sum(getattr(weights, name) for name in names)
    )
