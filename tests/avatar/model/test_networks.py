"""The networks of one layer."""

import copy

import pytest
import torch

from toile.avatar.model.gradients import Normed
from toile.avatar.model.networks import (
    LOGVAR,
    Conv,
    Decoder,
    FaceMap,
    LayerNetworks,
    PoseMap,
    Shadow,
    Sizes,
    UNet,
    bounded,
    channels_last,
    count,
    reparameterised,
    resize,
)

SIZES = dict(geometry=16, texture=32, latent=4, width=16, least_width=4, shadow_width=2, occlusion=16)


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


@pytest.mark.parametrize("mode, size, out", [("same", 8, 8), ("point", 8, 8), ("down", 8, 4), ("up", 8, 16)])
def test_bias_is_untied_each_pixel_has_its_own(mode, size, out):
    conv = Conv(3, 5, out, mode)
    x = torch.randn(1, 3, size, size)
    before = conv(x)
    with torch.no_grad():
        conv.bias[1, 2, 4] += 7
    change = (conv(x) - before).detach()
    assert float(change[0, 4, 1, 2]) == pytest.approx(7, abs=1e-5)
    change[0, 4, 1, 2] = 0
    assert not change.any()


@pytest.mark.parametrize("change", ["step", "load", "copy"])
def test_without_gradients_a_convolution_keeps_its_weight_until_it_is_another(change):
    conv, x = Conv(3, 5, 8), torch.randn(1, 3, 8, 8)
    with torch.no_grad():
        conv(x)
        assert conv.weight() is conv.weight()
    if change == "step":
        conv(x).square().sum().backward()
        torch.optim.AdamW(conv.parameters(), lr=0.1, fused=True).step()
    elif change == "load":
        conv.load_state_dict(Conv(3, 5, 8).state_dict())
    else:
        conv = copy.deepcopy(conv)
        conv.direction.data = conv.direction.data.roll(1, 0)
    with torch.no_grad():
        assert torch.equal(conv.weight(), conv._normed())
    assert conv.weight().requires_grad


@pytest.mark.parametrize("mode", ["same", "point", "down", "up"])
def test_weight_norm_length_of_a_kernel_is_its_gain_whatever_the_direction_s_length(mode):
    conv = Conv(3, 5, 8, mode)
    dims = (0, 2, 3) if mode == "up" else (1, 2, 3)
    before = conv.weight().detach()
    assert torch.allclose(torch.linalg.vector_norm(before, dim=dims), conv.gain)
    with torch.no_grad():
        conv.direction *= 9
    assert torch.allclose(conv.weight(), before, rtol=1e-5)
    with torch.no_grad():
        conv.direction.zero_()
    assert not conv.weight().any()  # and not NaN


@pytest.mark.parametrize("mode, size, out", [("same", 32, 32), ("point", 32, 32), ("down", 64, 32), ("up", 32, 64)])
def test_a_convolution_keeps_the_variance_through_its_leaky_relu(mode, size, out):
    conv = Conv(64, 64, out, mode)
    y = torch.nn.functional.leaky_relu(conv(torch.randn(2, 64, size, size)), 0.2)
    assert y[..., 2:-2, 2:-2].square().mean().item() == pytest.approx(1, rel=0.1)


def test_untrained_decoder_unet_and_shadow_change_nothing():
    assert not Decoder(6, 4, 16, 8, 2)(torch.randn(2, 6, 4, 4)).any()
    assert not UNet(4, 3, 32, 4, 16)(torch.randn(2, 4, 32, 32)).any()
    assert torch.equal(Shadow(16, 2)(torch.randn(2, 1, 16, 16)), torch.ones(2, 1, 16, 16))


def test_quasi_shadow_stays_between_0_and_its_bound():
    shadow = Shadow(16, 2)
    with torch.no_grad():
        shadow.unet.head.bias[:8], shadow.unet.head.bias[8:] = -1e4, 1e4
    dark, bright = shadow(torch.zeros(1, 1, 16, 16)).split(8, dim=2)
    assert not dark.any() and torch.allclose(bright, torch.tensor(1.135335))


def test_pose_map_equals_tiling_masking_and_a_1x1_convolution():
    mask = torch.rand(5, 4, 4)
    net, f = PoseMap(mask, 9), torch.randn(2, 5, 9)
    tiled = f[..., None, None] * mask[:, None]  # (B,K,C,s,s)
    weight = net.weight.reshape(len(net.weight), -1)[..., None, None]
    plain = torch.nn.functional.conv2d(tiled.flatten(1, 2), weight)
    assert torch.allclose(net(f), plain, atol=1e-5)


def test_a_joint_acts_only_where_its_mask_lets_it():
    mask = torch.ones(2, 4, 4)
    mask[1, :, :2] = 0
    net, f = PoseMap(mask, 9), torch.randn(1, 2, 9)
    g = f.clone()
    g[:, 1] += 1
    change = net(g) - net(f)
    assert not change[..., :2].any() and change[..., 2:].abs().min() > 0


def test_face_acts_only_on_the_head():
    head = torch.zeros(4, 4)
    head[:2] = 1
    net = FaceMap(3, head)
    change = net(torch.randn(1, 3, 3)) - net(torch.zeros(1, 3, 3))
    assert change[..., :2, :].abs().min() > 0 and not change[..., 2:, :].any()


def test_logvar_is_bounded_and_its_gradient_leads_back():
    raw = torch.tensor([-1e6, -20.0, 0.0, 20.0, 1e6], requires_grad=True)
    logvar = bounded(raw)
    assert logvar.abs().max() <= LOGVAR and logvar[2] == 0
    logvar.sum().backward()
    assert (raw.grad[1:4] > 0).all() and torch.isfinite(raw.grad).all()


def test_sigma_is_exp_of_half_logvar():
    z = reparameterised(torch.full((200_000,), 3.0), torch.full((200_000,), 2.0).log() * 2)
    assert z.mean().item() == pytest.approx(3, abs=0.02) and z.std().item() == pytest.approx(2, rel=0.01)


@pytest.mark.parametrize(
    "asked, parts",
    [
        (dict(joints=3), {"pose", "geometry", "texture", "shadow"}),
        (dict(joints=3, face_points=2, view=True), {"pose", "face", "geometry", "texture", "view", "shadow"}),
        (dict(code=True), {"encoder", "code", "geometry", "texture", "shadow"}),
        (
            dict(joints=3, face_points=2, code=True, view=True),
            {"pose", "face", "encoder", "code", "geometry", "texture", "view", "shadow"},
        ),
    ],
)
def test_only_the_parts_that_are_asked_for_exist(asked, parts):
    networks = LayerNetworks(Sizes(**SIZES, **asked))
    assert {name for name, part in networks.named_children() if part is not None} == parts


@pytest.mark.parametrize("geometry, texture", [(16, 32), (32, 32), (32, 128), (64, 32)])
@pytest.mark.parametrize("width, least", [(8, 8), (24, 3), (16, 4)])
def test_maps_have_the_sizes_asked_for(geometry, texture, width, least):
    changed = dict(geometry=geometry, texture=texture, width=width, least_width=least, code=True, view=True)
    sizes = Sizes(**SIZES | changed)
    net = LayerNetworks(sizes)
    mean, logvar = net.encoder(torch.randn(2, 3, geometry, geometry), torch.randn(2, 3, texture, texture))
    assert mean.shape == logvar.shape == (2, sizes.latent)
    features = net.features(None, None, mean)
    assert net.geometry(features).shape == (2, 3, geometry, geometry)
    colours = net.texture(features)
    assert colours.shape == (2, 3, texture, texture)
    v = sizes.view_size
    assert net.view_residual(colours[..., :v, :v], torch.randn(2, 1, v, v)).shape == colours.shape


def test_parameters_are_counted_without_allocating_them():
    with torch.device("meta"):
        planned = count(LayerNetworks(Sizes(**SIZES, code=True)))
    assert planned == count(LayerNetworks(Sizes(**SIZES, code=True)))


@pytest.mark.parametrize("autocast", [False, True])
def test_every_parameter_has_a_finite_gradient_once_the_heads_have_moved(autocast):
    net = LayerNetworks(Sizes(**SIZES, joints=3, face_points=2, code=True, view=True,
                              mask=torch.ones(3, 8, 8), head=torch.ones(8, 8)))  # fmt: skip
    with torch.no_grad():
        for p in net.parameters():
            p += 0.1 * torch.randn_like(p)
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
        mean, logvar = net.encoder(torch.randn(2, 3, 16, 16), torch.randn(2, 3, 32, 32))
        features = net.features(torch.randn(2, 3, 9), torch.randn(2, 2, 3), reparameterised(mean, logvar))
        colours = net.texture(features)
        seen = net.view_residual(colours[..., ::2, ::2], torch.randn(2, 1, 16, 16))
        outputs = [net.geometry(features), colours, seen, net.shadow(torch.randn(2, 1, 16, 16))]
    assert all(x.dtype == torch.float32 for x in (*outputs, mean, logvar))
    sum(x.square().sum() for x in outputs).backward()
    for name, p in net.named_parameters():
        assert torch.isfinite(p.grad).all() and p.grad.any(), name


def test_a_decoder_learns_a_map_that_its_features_tell_apart():
    net = Decoder(4, 4, 16, 16, 8)
    features, wanted = torch.randn(2, 4, 4, 4), torch.randn(2, 3, 16, 16)
    optimiser = torch.optim.AdamW(net.parameters(), lr=1e-2)
    losses = []
    for _ in range(150):
        loss = (net(features) - wanted).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.05 * losses[0]


def test_maps_stay_in_channels_last_order():
    y = Decoder(8, 8, 32, 16, 8).body(channels_last(torch.randn(2, 8, 8, 8)))
    assert y.is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("size", [1, 8, 128])
@pytest.mark.parametrize("times", [2, 4])
def test_enlarged_maps_are_bilinear_in_any_autocast(size, times):
    maps = torch.randn(2, 3, size, size, generator=torch.Generator().manual_seed(size))
    expected = torch.nn.functional.interpolate(maps, scale_factor=times, mode="bilinear", align_corners=False)
    for enabled in (False, True):
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            torch.testing.assert_close(resize(maps, times * size), expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("times", [2, 4, 8])
def test_gradients_of_enlarged_maps_are_those_of_their_values(times):
    maps = torch.randn(2, 3, 4, 4, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: resize(x, 4 * times), maps)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_gradients_of_a_matrix_over_channels_are_those_of_its_values(layout):
    conv = Conv(5, 3, 4, "point").double()
    maps = torch.randn(2, 5, 4, 4, dtype=torch.double).contiguous(memory_format=layout).requires_grad_()
    assert torch.autograd.gradcheck(lambda x, *_: conv(x), (maps, *conv.parameters()))
    if layout == torch.channels_last:
        assert torch.autograd.grad(conv(maps).sum(), maps)[0].is_contiguous(memory_format=layout)


@pytest.mark.parametrize("mode", ["same", "up"])
def test_gradients_of_a_normalised_weight_are_those_of_its_values(mode):
    conv = Conv(3, 5, 8, mode).double()
    parts = [torch.randn_like(p).requires_grad_() for p in (conv.direction, conv.gain)]
    assert torch.autograd.gradcheck(lambda *p: Normed.apply(*p, 1 if mode == "up" else 0), parts)
