"""Maps over UVs: where texels lie, vertices to texels and back."""

import numpy as np
import pytest
import torch

from toile.avatar.model.uv import TexelValues, UvSampler
from toile.errors import UserError
from toile.io.run import open_run
from toile.surface.layers import Layer, read_layers, registered_surface, shapes
from toile.surface.uv import GUTTER, UvMap


def square(n=6, low=0.2, high=0.8):
    """A flat grid of n x n cells whose UVs are its x and y."""
    x = np.linspace(low, high, n + 1)
    V = np.stack(np.meshgrid(x, x, [0.0]), -1).reshape(-1, 3)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    F = np.r_[np.c_[i, i + 1, i + n + 2], np.c_[i, i + n + 2, i + n + 1]].astype(np.int32)
    one = np.zeros((len(V), 1))
    return Layer("square", "garment", V, F, V[:, :2].copy(), F, one.astype(np.int32), one + 1, 1)


def cut_square(n=6):
    """The square with every face in a chart of its own place: all inner vertices lie on seams."""
    whole = square(n)
    uv = whole.uv[whole.faces].reshape(-1, 2)
    uv = 0.5 * uv + np.where(np.arange(len(uv)) // 3 % 2, 0.5, 0.0)[:, None]
    return Layer(
        "cut",
        "garment",
        whole.rest,
        whole.faces,
        uv,
        np.arange(len(uv), dtype=np.int32).reshape(-1, 3),
        whole.skin_idx,
        whole.skin_val,
        1,
    )


def sampled(sampler, maps):
    return sampler(torch.as_tensor(maps, dtype=torch.float32)[None])[0].numpy()


@pytest.fixture(scope="module")
def registered(sample_run):
    """Layers, and each layer's unposed vertices of one frame."""
    run = open_run(sample_run)
    layers = read_layers(run)
    return layers, [
        shapes(run, registered_surface(run, layer), layer.skin_idx, layer.skin_val, [2], 0)[0] for layer in layers
    ]


def test_a_texel_lies_where_its_row_and_column_say():
    m = UvMap(square(), 40)
    uv = m.texels(m.layer.rest[:, :2])
    row, column = np.nonzero(m.inside)
    assert np.abs(uv[row, column, 0] - (column + 0.5) / 40).max() < 1e-9
    assert np.abs(uv[row, column, 1] - (1 - (row + 0.5) / 40)).max() < 1e-9
    assert m.inside.sum() == 24 * 24  # 0.6 of 40 texels a side


def test_the_gutter_is_what_lies_within_two_texels_and_continues_the_nearest():
    m = UvMap(square(), 40)
    assert m.valid[8 - GUTTER : 32 + GUTTER, 8:32].all() and not m.valid[: 8 - GUTTER].any()
    x = m.texels(m.layer.rest)[..., 0]
    assert np.allclose(x[8 - GUTTER, 8:32], x[8, 8:32])


@pytest.mark.parametrize("make", [square, cut_square])
def test_a_linear_map_is_read_exactly_at_the_vertices(make):
    layer, size = make(), 32
    u = (np.arange(size) + 0.5) / size
    maps = np.stack([np.broadcast_to(u, (size, size)), np.broadcast_to(1 - u[:, None], (size, size))])
    mean = np.zeros((len(layer.rest), 3))
    np.add.at(mean, layer.faces.ravel(), np.c_[layer.uv[layer.face_uv.ravel()], np.ones(layer.faces.size)])
    if make is square:
        assert np.allclose(sampled(UvSampler(layer, size), maps), layer.uv, atol=1e-6)
    else:  # every corner of a seam's vertex has a UV of its own: their plain mean
        assert np.allclose(sampled(UvSampler(layer, size), maps), mean[:, :2] / mean[:, 2:], atol=1e-6)


def test_sampling_and_its_gradient_are_adjoint():
    sampler, rng = UvSampler(cut_square(), 32), torch.Generator().manual_seed(0)
    maps = torch.randn(2, 3, 32, 32, generator=rng, requires_grad=True)
    weights = torch.randn(2, 49, 3, generator=rng)
    (sampler(maps) * weights).sum().backward()
    other = torch.randn(2, 3, 32, 32, generator=rng)
    assert torch.allclose((maps.grad * other).sum(), (sampler(other) * weights).sum(), rtol=1e-4, atol=1e-4)


def test_texel_values_in_torch_equal_numpys(registered):
    layers, unposed = registered
    for layer, V in zip(layers, unposed):
        m = UvMap(layer, 64)
        found = TexelValues(m, layer.faces)(torch.tensor(V, dtype=torch.float32)[None].repeat(2, 1, 1))
        assert np.abs(found[1].permute(1, 2, 0).numpy() - m.texels(V)).max() < 1e-6
        assert not found[0][:, torch.as_tensor(~m.valid)].any()


def test_layers_without_texels_or_uvs_are_refused():
    tiny = square(low=0.501, high=0.502)
    with pytest.raises(UserError, match="no texel"):
        UvMap(tiny, 8)
    layer = square()
    stray = Layer(
        "stray",
        "garment",
        np.r_[layer.rest, [[0, 0, 1]]],
        layer.faces,
        layer.uv,
        layer.face_uv,
        layer.skin_idx,
        layer.skin_val,
        1,
    )
    with pytest.raises(UserError, match="vertex 49"):
        UvSampler(stray, 32)
