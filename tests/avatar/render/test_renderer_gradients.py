"""Gradients of the differentiable renderer are those of a supersampled image, at silhouettes and inside."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from tests.support import surfaces as shapes  # noqa: E402
from tests.support.surfaces import IDENTITY, body_and_cloth, f32, of_vertices, pictures, scene, spheres  # noqa: E402
from toile import kernels  # noqa: E402
from toile.avatar.render import renderer  # noqa: E402
from toile.avatar.render.renderer import Surface, render  # noqa: E402

SUPERSAMPLING = 8


def moved(surfaces, directions, step):
    return [Surface(s.vertices + step * d, s.faces, s.uv, s.face_uv, s.texture) for s, d in zip(surfaces, directions)]


def random_directions(surfaces, count, wavelength=1.5):
    """Per direction, a smooth displacement (n,3) of each surface, every surface its own."""
    return [
        [f32(shapes.smooth_field(100 * k + i, wavelength)(s.vertices.detach().numpy())) for i, s in enumerate(surfaces)]
        for k in range(count)
    ]


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
    along = lambda direction: sum(float((g.double() * d).sum()) for g, d in zip(gradients, direction))
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
    supersampled = lambda s: losses(render(s, fine, T, (size * SUPERSAMPLING,) * 2), *pair)
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
    mask = render(
        [Surface(vertices, faces, torch.rand(3, 2), faces, torch.rand(3, 4, 4))], K, IDENTITY, (256, 256)
    ).mask
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
    scene, (face, depth) = view.scene, (x.numpy() for x in (view.face, view.depth))
    contours = kernels.Contours(face, depth, scene.points, scene.faces, scene.neighbours, K.numpy())
    assert len(contours.a) > 60 and (mask[contours.a] != mask[contours.b]).all()


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
