"""Laws of the differentiable renderer: its gradients are those of a supersampled image, everywhere finite."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import surfaces as shapes  # noqa: E402

from toile import kernels  # noqa: E402
from toile.avatar.render import renderer  # noqa: E402
from toile.avatar.losses import soft_visibility  # noqa: E402
from toile.avatar.render.rasterise import NEAR, rasterise, rasterise_by_scatter  # noqa: E402
from toile.avatar.render.renderer import Surface, render  # noqa: E402

SUPERSAMPLING = 8
IDENTITY = torch.eye(4)


def f32(values):
    if torch.is_tensor(values):
        return values.float()
    return torch.tensor(np.asarray(values), dtype=torch.float32)


def scene(*meshes):
    return [shapes.surface(V, F, seed) for seed, (V, F) in enumerate(meshes)]


def spheres():
    return scene(shapes.sphere(bumps=0.2), shapes.sphere(0.2, (0.2, 0.1, -0.4), bumps=0.2, seed=1))


def body_and_cloth():
    return scene(shapes.body(), shapes.sheet(turn=0.3))


def of_vertices(surfaces):
    return [s.vertices.requires_grad_() for s in surfaces]


def moved(surfaces, directions, step):
    return [Surface(s.vertices + step * d, s.faces, s.uv, s.face_uv, s.texture) for s, d in zip(surfaces, directions)]


def random_directions(surfaces, count, wavelength=1.5):
    """Per direction, a smooth displacement (n,3) of each surface, every surface its own."""
    return [
        [f32(shapes.smooth_field(100 * k + i, wavelength)(s.vertices.detach().numpy())) for i, s in enumerate(surfaces)]
        for k in range(count)
    ]


def pictures(seed, size):
    """Two smooth random pictures (3,size,size) between 0 and 1: weights and target of a loss."""
    i, j = np.mgrid[:size, :size] / size
    fields = (shapes.smooth_field(s, 0.3)(np.stack([j, i, 0 * i], -1)) for s in (seed, seed + 1))
    return [f32(0.5 + 0.4 * f).permute(2, 0, 1) for f in fields]


def averaged(picture, size):
    return torch.nn.functional.adaptive_avg_pool2d(picture[None], size)[0]


def losses(rendered, weight, target):
    """Colour and mask, of the picture averaged down to the target's size."""
    size = target.shape[-1]
    return {
        "image": (weight * (averaged(rendered.image, size) - target).square()).mean(),
        "mask": (weight * (averaged(rendered.mask[None], size) - target).square()).mean(),
    }


def camera_and_finer(size):
    K, T = shapes.camera(size)
    return K, torch.diag(torch.tensor([SUPERSAMPLING, SUPERSAMPLING, 1.0])) @ K, T


def central_differences(function, surfaces, directions, step):
    """function(surfaces) -> {name: value}; -> {name: (D,)} slopes, half a step to either side."""
    with torch.no_grad():
        pairs = [[function(moved(surfaces, d, t)) for t in (step, -step)] for d in directions]
    return {name: np.array([float(up[name] - down[name]) / (2 * step) for up, down in pairs]) for name in pairs[0][0]}


def slopes(loss, surfaces, directions):
    """(D,) directional derivatives by the renderer's gradient."""
    gradients = torch.autograd.grad(loss, of_vertices(surfaces), retain_graph=True)
    along = lambda direction: sum(float((g.double() * d).sum()) for g, d in zip(gradients, direction))  # noqa: E731
    return np.array([along(direction) for direction in directions])


def assert_same_gradient(ours, true, name, cosine=0.99, ratio=(0.9, 1.1)):
    norms = np.linalg.norm(ours), np.linalg.norm(true)
    assert ours @ true > cosine * norms[0] * norms[1], name
    assert ratio[0] < norms[0] / norms[1] < ratio[1], name


@pytest.mark.parametrize("size", [256, pytest.param(512, marks=pytest.mark.slow)])
@pytest.mark.parametrize("make", [spheres, body_and_cloth])
def test_colour_and_mask_gradients_are_those_of_a_supersampled_image(make, size):
    surfaces = make()
    (K, fine, T), pair, step = camera_and_finer(size), pictures(7, size), 0.5 * shapes.FIELD / size
    of_vertices(surfaces)
    ours = losses(render(surfaces, K, T, (size, size)), *pair)
    directions = random_directions(surfaces, 6)
    supersampled = lambda s: losses(render(s, fine, T, (size * SUPERSAMPLING,) * 2), *pair)  # noqa: E731
    true = central_differences(supersampled, surfaces, directions, step)
    for name, loss in ours.items():
        assert_same_gradient(slopes(loss, surfaces, directions), true[name], name)


@pytest.mark.parametrize("size", [256, pytest.param(512, marks=pytest.mark.slow)])
def test_depth_gradients_are_those_of_a_supersampled_depth_buffer(size):
    surfaces = scene(shapes.body(), shapes.sheet(turn=0.3), shapes.wall())  # the wall: no pixel is empty
    (K, fine, T), (weight, _), step = camera_and_finer(size), pictures(7, size), 0.5 * shapes.FIELD / size
    of_vertices(surfaces)
    depth = render(surfaces, K, T, (size, size)).depth
    directions = random_directions(surfaces, 8)

    def supersampled(surfaces):
        """By the core's raster alone."""
        starts = np.cumsum([0] + [len(s.vertices) for s in surfaces])
        V = np.concatenate([s.vertices.numpy() for s in surfaces]).astype(float) + T[:3, 3].numpy()
        F = np.concatenate([s.faces.numpy() + n for s, n in zip(surfaces, starts)])
        z = kernels.raster(V, F, fine.double().numpy(), (size * SUPERSAMPLING,) * 2).depth
        return {"depth": np.sum(weight[0].numpy() * z.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING).mean((1, 3)))}

    true = central_differences(supersampled, surfaces, directions, step)["depth"]
    assert_same_gradient(slopes((weight[0] * depth[0]).sum(), surfaces, directions), true, "depth", 0.999, (0.98, 1.02))


def test_occlusion_edges_between_layers_carry_most_of_the_gradient():
    """A plain sheet before a plain sheet of another colour: only the edge between them moves the picture."""
    back, front = scene(shapes.wall(0.3), shapes.sheet(centre=(0.01, 0.02, -0.2)))
    back.texture, front.texture = torch.zeros(3, 4, 4), torch.ones(3, 4, 4)
    K, T = shapes.camera(128)
    (vertices,) = of_vertices([front])
    image = render([back, front], K, T, (128, 128)).image
    (gradient,) = torch.autograd.grad(image[0, :, :64].sum(), vertices)  # what the sheet covers left of the middle
    edge = gradient[:, 0].sum()  # moved by 1 m to the right, its left edge uncovers this many pixels
    rows, depth = 0.6 * K[1, 1] / 2.8, 2.8
    assert float(edge) == pytest.approx(-float(rows * K[0, 0] / depth), rel=0.03)
    inside = (vertices[:, 0] > -0.2) & (vertices[:, 1].abs() < 0.2)
    assert (gradient[inside] == 0).all()


def test_the_silhouette_of_one_large_face_moves_with_each_corner_as_its_area_does():
    corners = f32([[-0.31, -0.22, 1.0], [0.9, -0.1, 3.0], [0.15, 0.52, 1.8]])
    K = torch.tensor([[300.0, 0, 130], [0, 280, 120], [0, 0, 1]])
    vertices, faces = corners.clone().requires_grad_(), torch.tensor([[0, 1, 2]])
    mask = render([Surface(vertices, faces, torch.rand(3, 2), faces, torch.rand(3, 4, 4))], K, IDENTITY, (256, 256)).mask
    (ours,) = torch.autograd.grad(mask.sum(), vertices)
    screen = (vertices @ K.T)[:, :2] / vertices[:, 2:]
    ab, ac = screen[1] - screen[0], screen[2] - screen[0]
    area = (ab[0] * ac[1] - ab[1] * ac[0]).abs() / 2
    (true,) = torch.autograd.grad(area, vertices)
    assert float(mask.detach().sum()) == pytest.approx(float(area.detach()), rel=0.01)
    torch.testing.assert_close(ours, true, rtol=0, atol=0.02 * float(true.abs().max()))


def test_a_smooth_surface_has_no_contour_inside_however_small_its_faces():
    V, F = shapes.sphere(n=300)  # faces of a third of a pixel
    K, T = shapes.camera(64)
    surface = shapes.surface(V, F, 0)
    view = renderer._Scene([surface], K, T, (64, 64)).views()[0]
    mask = (view.face >= 0).view(-1)
    assert mask.sum() > 300
    for contour in view.contours:
        assert len(contour.a) > 30 and (mask[contour.a] != mask[contour.b]).all()


def test_shared_edges_neither_crack_nor_shine_through():
    surface = shapes.surface(*shapes.sphere(n=60), 0)
    surface.texture = torch.full((3, 8, 8), 0.75)
    K, T = shapes.camera(200)
    seen = render([surface], K, T, (200, 200))
    for line in (*seen.mask, *seen.mask.T):  # a ball has no hole: what it covers of a line is one piece
        assert line.diff().abs().sum() in (0, 2)
    torch.testing.assert_close(seen.image, 0.75 * seen.mask.expand(3, -1, -1))


def test_a_mask_fit_finds_shift_and_size_to_a_fraction_of_a_pixel():
    V, F = shapes.sphere()
    (K, fine, T), size = camera_and_finer(64), 64
    surface = shapes.surface(V, F, 0)
    true = torch.tensor([0.11, -0.07, 1.3])

    def at(p):
        vertices = p[2] * f32(V) + torch.cat([p[:2], torch.zeros(1)])
        return [Surface(vertices, surface.faces, surface.uv, surface.face_uv, surface.texture)]

    target = averaged(render(at(true), fine, T, (size * SUPERSAMPLING,) * 2).mask[None], size)[0]
    p = torch.tensor([0.0, 0.0, 1.0], requires_grad=True)
    optimiser = torch.optim.Adam([p], lr=0.02)
    for step in range(100):
        optimiser.param_groups[0]["lr"] = 0.02 * 0.96**step
        optimiser.zero_grad()
        (render(at(p), K, T, (size, size)).mask - target).square().mean().backward()
        optimiser.step()
    pixel = shapes.FIELD / size
    assert ((p.detach() - true).abs() < 0.1 * pixel * torch.tensor([1, 1, 1 / 0.3])).all()


def test_texture_gradients_are_the_adjoint_of_the_look_up():
    surfaces = spheres()
    K, T = shapes.camera(96)
    weight = pictures(3, 96)[0]
    textures = [s.texture.requires_grad_() for s in surfaces]
    loss = (weight * render(surfaces, K, T, (96, 96)).image).sum()
    gradients = torch.autograd.grad(loss, textures)
    generator = torch.Generator().manual_seed(0)
    changes = [torch.randn(t.shape, generator=generator) for t in textures]
    with torch.no_grad():
        for s, change in zip(surfaces, changes):
            s.texture = s.texture + change
        other = (weight * render(surfaces, K, T, (96, 96)).image).sum()
    expected = sum((g * c).sum() for g, c in zip(gradients, changes))  # the picture is linear in the texture
    assert float((other - loss).detach()) == pytest.approx(float(expected.detach()), rel=1e-3)


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
    loss = lambda r: (weight * r.image[:, near]).sum() + r.depth[:, near].sum()  # noqa: E731
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


def test_renderer_draws_the_same_with_the_scatter_rasteriser(monkeypatch):
    surfaces = spheres()
    K, T = shapes.camera(64)
    expected = render(surfaces, K, T, (64, 64), layer_depth=True)
    monkeypatch.setattr(renderer, "rasterise", rasterise_by_scatter)
    seen = render(surfaces, K, T, (64, 64), layer_depth=True)
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
