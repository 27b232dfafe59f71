"""Laws of the differentiable renderer: what it draws, everywhere finite, the same for any number of threads."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.support import surfaces as shapes  # noqa: E402
from tests.support.surfaces import IDENTITY, body_and_cloth, f32, of_vertices, pictures, scene, spheres  # noqa: E402
from toile import kernels  # noqa: E402
from toile.avatar.render import renderer  # noqa: E402
from toile.avatar.render.rasterise import (  # noqa: E402
    NEAR,
    rasterise,
    rasterise_apart_by_scatter,
    rasterise_by_scatter,
)
from toile.avatar.render.renderer import Surface, render  # noqa: E402
from toile.avatar.train.losses import soft_visibility  # noqa: E402


def quad(corners, uv=((0, 0), (1, 0), (1, 1), (0, 1)), texture=None):
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    return Surface(f32(corners), faces, f32(uv), faces, torch.rand(3, 8, 8) if texture is None else texture)


def test_texel_centres_lie_at_one_half_with_v_up():
    size = 16
    centre = (torch.arange(size) + 0.5) / size
    texture = torch.stack([centre.expand(size, size), (1 - centre)[:, None].expand(size, size), torch.ones(size, size)])
    surface = quad([[-1, 1, 2], [1, 1, 2], [1, -1, 2], [-1, -1, 2]], texture=texture)  # y points down, v up
    K = torch.tensor([[64.0, 0, 32], [0, 64, 32], [0, 0, 1]])
    image = render([surface], K, IDENTITY, (64, 64)).image
    at = (torch.arange(64) + 0.5) / 64
    u, v = at.expand(64, 64), (1 - at)[:, None].expand(64, 64)
    inside = slice(2, 62)  # beyond the outermost texel centres the texture is constant
    torch.testing.assert_close(image[0, :, inside], u[:, inside], atol=1e-5, rtol=0)
    torch.testing.assert_close(image[1, inside], v[inside], atol=1e-5, rtol=0)
    assert torch.isfinite(image).all() and image[0].max() <= centre[-1] + 1e-6


def test_depth_and_colour_are_perspective_correct():
    surface = quad([[-1, 1, 1], [3, 1, 3], [3, -1, 3], [-1, -1, 1]])
    centre = (torch.arange(256) + 0.5) / 256
    surface.texture = centre.expand(1, 256, 256)
    K = torch.tensor([[50.0, 0, 50], [0, 50, 20], [0, 0, 1]])
    seen = render([surface], K, IDENTITY, (40, 100))
    x = (torch.arange(100) + 0.5 - 50) / 50
    z = 3 / (2 - x)  # where the ray (x, y, 1) z meets the plane X = 2 z - 3
    covered = seen.mask[20] > 0
    assert covered.sum() > 90
    torch.testing.assert_close(seen.depth[0, 20][covered], z[covered], rtol=1e-5, atol=0)
    torch.testing.assert_close(seen.image[0, 20][covered], ((z - 1) / 2)[covered], atol=1 / 256, rtol=0)


def test_faces_that_cross_the_camera_plane_have_the_gradients_of_their_visible_part():
    """A floor from behind the camera to the horizon; its height and tilt change what is seen of it."""
    rng = np.random.default_rng(0)
    texture = f32(rng.uniform(0, 1, (3, 4, 4)))
    corners = f32([[-40, 0.5, -30], [40, 0.6, -30], [40, 0.5, 60], [-40, 0.55, 60]])
    uv = ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9))
    K = torch.tensor([[60.0, 0, 48], [0, 60, 24], [0, 0, 1]])
    vertices = corners.clone().requires_grad_()
    near = slice(40, 64)  # rows that see it at less than 2 m
    weight = f32(rng.uniform(0, 1, (3, 1, 96)))
    seen = render([quad(vertices, uv, texture)], K, IDENTITY, (64, 96))
    assert seen.mask[near].all() and seen.depth.min() > NEAR
    loss = lambda r: (weight * r.image[:, near]).sum() + r.depth[:, near].sum()
    (gradient,) = torch.autograd.grad(loss(seen), vertices)
    for k in range(4):
        step = torch.zeros_like(corners)
        step[k, 1] = 1e-3
        floors = (quad(corners + t * step, uv, texture) for t in (1, -1))
        up, down = (float(loss(render([floor], K, IDENTITY, (64, 96)))) for floor in floors)
        bound = 0.02 * float(gradient[:, 1].abs().max())
        assert float(gradient[k, 1]) == pytest.approx((up - down) / 2e-3, rel=0.02, abs=bound)


@pytest.mark.parametrize(
    "corners",
    [
        [[-1, 0, -3], [1, 0, -3], [1, 1, -3], [-1, 1, -3]],  # behind the camera
        [[50, 0, 3], [51, 0, 3], [51, 1, 3], [50, 1, 3]],  # beside the picture
        [[0, -1, 1], [0, -1, 5], [0, 1, 5], [0, 1, 1]],  # edge-on
        [[1e-7, -1, 1], [-1e-7, -1, 5], [-1e-7, 1, 5], [1e-7, 1, 1]],  # nearly so, across the centres of a column
        [[-1, -1, 2], [-1, -1, 2], [1, 1, 2], [1, 1, 2]],  # no area
        [[0, 0, 2]] * 4,
        [[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 1]],  # a corner in the camera itself
        [[-1, -1, NEAR], [1, -1, NEAR], [1, 1, NEAR], [-1, 1, NEAR]],  # on the near plane
        [[-1e4, -1e4, -1e4], [1e4, -1e4, 1e4], [1e4, 1e4, 1e4], [-1e4, 1e4, -1e4]],  # through the camera, huge
        [[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]],  # UVs at 0 and 1
    ],
)
@pytest.mark.parametrize("layer_depth", [False, True])
def test_gradients_are_finite_for_empty_edge_on_and_degenerate_views(corners, layer_depth):
    surface, behind = quad(corners), quad([[-2, -2, 6], [2, -2, 6], [2, 2, 6], [-2, 2, 6]])
    leaves = [surface.vertices.requires_grad_(), surface.texture.requires_grad_(), behind.vertices.requires_grad_()]
    K = torch.tensor([[30.0, 0, 16.5], [0, 30, 16.5], [0, 0, 1]])
    for surfaces in ([surface], [surface, behind]):
        seen = render(surfaces, K, IDENTITY, (33, 33), layer_depth=layer_depth)
        depth = torch.where(seen.depth.isfinite(), seen.depth, 0.0)
        loss = seen.image.square().sum() + (seen.mask - 0.5).square().sum() + depth.square().sum()
        gradients = torch.autograd.grad(loss, leaves[: 1 + len(surfaces)])
        assert torch.isfinite(loss) and all(torch.isfinite(g).all() for g in gradients)
        assert not seen.image.isnan().any() and not seen.depth.isnan().any()


def test_an_empty_view_shows_the_background_and_its_gradient():
    surface = quad([[-1, 0, -3], [1, 0, -3], [1, 1, -3], [-1, 1, -3]])
    K = torch.tensor([[30.0, 0, 16], [0, 30, 16], [0, 0, 1]])
    background = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    seen = render([surface], K, IDENTITY, (8, 9), background)
    assert seen.image.shape == (3, 8, 9) and seen.mask.shape == seen.face.shape == seen.layer.shape == (8, 9)
    torch.testing.assert_close(seen.image, background[:, None, None].expand(3, 8, 9))
    assert (seen.face == -1).all() and (seen.layer == -1).all() and seen.depth.isinf().all() and (seen.mask == 0).all()
    seen.image.sum().backward()
    torch.testing.assert_close(background.grad, torch.full((3,), 72.0))


def test_layer_depth_is_that_of_each_layer_alone_and_changes_nothing_else():
    K, T = shapes.camera(128)
    surfaces = body_and_cloth()
    vertices = of_vertices(surfaces)
    both, plain = render(surfaces, K, T, (128, 128), layer_depth=True), render(surfaces, K, T, (128, 128))
    for name in ("image", "mask", "face", "layer"):
        assert torch.equal(getattr(both, name), getattr(plain, name))
    torch.testing.assert_close(both.depth.amin(0), plain.depth[0], rtol=1e-5, atol=0)
    for k, surface in enumerate(surfaces):
        assert torch.equal(both.depth[k], render([surface], K, T, (128, 128)).depth[0])
    gradients = [torch.autograd.grad(r.image.square().sum(), vertices, retain_graph=True) for r in (both, plain)]
    for one, other in zip(*gradients):
        torch.testing.assert_close(one, other)
    assert set(both.layer.unique().tolist()) == {-1, 0, 1}
    assert ((both.face >= len(surfaces[0].faces)) == (both.layer == 1)).all()


def test_gradients_turn_with_the_world():
    surfaces = spheres()
    K, T = shapes.camera(96)
    angle = torch.tensor(0.7)
    R = torch.tensor([[angle.cos(), -angle.sin(), 0], [angle.sin(), angle.cos(), 0], [0, 0, 1]])
    turned = torch.eye(4)
    turned[:3, :3] = R
    weight = pictures(5, 96)[0]

    def gradients(surfaces, T):
        vertices = of_vertices(surfaces)
        return torch.autograd.grad((weight * render(surfaces, K, T, (96, 96)).image).sum(), vertices)

    other = [Surface((s.vertices @ R.T).detach(), s.faces, s.uv, s.face_uv, s.texture) for s in surfaces]
    for one, two in zip(gradients(surfaces, T), gradients(other, T @ turned.T)):
        cosine = torch.nn.functional.cosine_similarity((one @ R.T).flatten(), two.flatten(), dim=0)
        assert cosine > 0.999  # corners are snapped to 1/4096 px: some pixels change sides


def test_renderer_gives_the_same_bits_for_any_number_of_threads():
    K, T = shapes.camera(192)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 3, 8):
            torch.set_num_threads(threads)
            surfaces = body_and_cloth()
            leaves = of_vertices(surfaces) + [s.texture.requires_grad_() for s in surfaces]
            seen = render(surfaces, K, T, (192, 192), layer_depth=True)
            depth = torch.where(seen.depth.isfinite(), seen.depth, 0.0)
            gradients = torch.autograd.grad((seen.image.square() + seen.mask + depth.sum(0)).sum(), leaves)
            results.append([tensor.detach().numpy().tobytes() for tensor in (seen.image, seen.depth, *gradients)])
    finally:
        torch.set_num_threads(before)
    assert all(result == results[0] for result in results)


@pytest.mark.parametrize(
    "background", [0.0, 0.7, torch.tensor([0.1, 0.2, 0.3]), torch.linspace(0, 1, 3 * 192 * 192).view(3, 192, 192)]
)
def test_the_picture_without_gradients_is_the_one_with_them(background, threads):
    K, T = shapes.camera(192)
    surfaces = body_and_cloth()
    with_gradients = render(surfaces, K, T, (192, 192), background)
    for count in (1, 4):
        threads(count)
        with torch.no_grad():
            without = render(surfaces, K, T, (192, 192), background)
        same = without.face == with_gradients.face
        assert (~same).sum() <= 2  # depths that agree to rounding
        for part, bound in (("image", 1e-4), ("depth", 3e-3)):  # the depth of steep faces, in float32 with gradients
            one, other = getattr(without, part)[:, same], getattr(with_gradients, part)[:, same]
            torch.testing.assert_close(one, other, atol=bound, rtol=0)
        assert torch.equal(without.mask, with_gradients.mask)
        assert torch.equal(without.layer[same], with_gradients.layer[same])


def test_renderer_computes_in_float32_under_autocast():
    surfaces = spheres()
    K, T = shapes.camera(64)
    vertices = of_vertices(surfaces)
    plain = render(surfaces, K, T, (64, 64), layer_depth=True)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = render(surfaces, K, T, (64, 64), layer_depth=True)
        gradients = torch.autograd.grad(mixed.image.square().sum(), vertices)  # the way back too
    assert mixed.image.dtype == mixed.depth.dtype == torch.float32
    assert torch.equal(mixed.image, plain.image) and torch.equal(mixed.depth, plain.depth)
    for one, other in zip(gradients, torch.autograd.grad(plain.image.square().sum(), vertices)):
        assert torch.equal(one, other)
    half = [Surface(s.vertices, s.faces, s.uv, s.face_uv, s.texture.bfloat16()) for s in surfaces]
    assert render(half, K, T, (64, 64)).image.dtype == torch.float32


def test_scatter_rasteriser_sees_the_same_faces_as_the_core():
    K, T = shapes.camera(256)
    V, F = shapes.body()
    generator = torch.Generator().manual_seed(0)
    soup = torch.randn(200, 3, generator=generator) * 0.5 + torch.tensor([0, 0, 0.5])  # much of it behind the camera
    cases = [
        (f32(V + [0, 0, 3]), torch.tensor(F).long()),
        (soup, torch.randint(0, 200, (60, 3), generator=generator)),
        (soup - torch.tensor([0, 0, 9.0]), torch.tensor([[0, 1, 2]])),  # nothing to be seen
    ]
    for vertices, faces in cases:
        face, depth = rasterise(vertices, faces, K, (200, 256))
        other_face, other_depth = rasterise_by_scatter(vertices, faces, K, (200, 256))
        same = face == other_face
        assert (~same).float().mean() < 1e-4
        torch.testing.assert_close(depth[same], other_depth[same], rtol=1e-6, atol=0)


@pytest.mark.parametrize("layer_depth", [True, False])
def test_renderer_draws_the_same_with_the_scatter_rasteriser(monkeypatch, layer_depth):
    surfaces = spheres()
    K, T = shapes.camera(64)
    of_vertices(surfaces)
    expected = render(surfaces, K, T, (64, 64), layer_depth=layer_depth)
    monkeypatch.setattr(renderer, "rasterise", rasterise_by_scatter)
    monkeypatch.setattr(renderer, "rasterise_apart", rasterise_apart_by_scatter)
    seen = render(surfaces, K, T, (64, 64), layer_depth=layer_depth)
    assert torch.equal(seen.depth.isfinite(), expected.depth.isfinite())
    assert (seen.face == expected.face).float().mean() > 0.999
    torch.testing.assert_close(seen.image, expected.image, atol=1e-4, rtol=0)


def test_renderer_refuses_what_it_cannot_draw():
    K, T = shapes.camera(16)
    with pytest.raises(kernels.InputError, match="surfaces"):
        render([], K, T, (16, 16))
    for r in (rasterise, rasterise_by_scatter):
        with pytest.raises(kernels.InputError, match="finite"):
            r(torch.tensor([[0, 0, 1], [torch.nan, 0, 1], [0, 1, 1]]), torch.tensor([[0, 1, 2]]), K, (16, 16))


def test_soft_visibility_brings_the_order_back_where_a_hard_z_buffer_has_no_gradient():
    """Cloth labelled in the picture, but the body drawn 1 cm in front of it."""
    body, cloth = scene(shapes.sphere(0.3), shapes.sheet(30, (0, 0, 0), (0.2, 0.2)))
    radius = cloth.vertices[:, :2].norm(dim=1)
    start = torch.cat([cloth.vertices[:, :2], -(0.29**2 - radius.square()).sqrt()[:, None]], 1)
    K, T = shapes.camera(96, field=0.8)
    offset = torch.zeros(len(start), 1, requires_grad=True)  # towards the camera and away from it
    axis = torch.tensor([0.0, 0, 1])

    def seen():
        dressed = Surface(start + offset * axis, cloth.faces, cloth.uv, cloth.face_uv, cloth.texture)
        return render([body, dressed], K, T, (96, 96), layer_depth=True)

    first = seen()
    labels = first.depth[1].isfinite().long()  # where cloth is, whatever hides it
    assert labels.sum() > 300 and not (first.layer == 1).any()
    hard = (first.image - torch.rand(3, 96, 96)).square().sum() + (first.mask - 0.3).square().sum()
    assert (torch.autograd.grad(hard, offset, retain_graph=True)[0] == 0).all()
    optimiser = torch.optim.Adam([offset], lr=1e-3)
    for _ in range(40):
        optimiser.zero_grad()
        soft_visibility(seen().depth, labels, torch.tensor([-1, 1]), 0.02).backward()
        optimiser.step()
    last = seen()
    assert ((last.layer == 1) & (labels == 1)).sum() > 0.98 * labels.sum()
    assert float(soft_visibility(last.depth.detach(), labels, torch.tensor([-1, 1]), 0.02)) < 0.02
