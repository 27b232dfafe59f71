"""Laws of the differentiable renderer: its gradients are those of a supersampled image, everywhere finite."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import surfaces as shapes  # noqa: E402
from toile.avatar.rasterise import rasterise, rasterise_by_scatter  # noqa: E402
from toile.avatar.renderer import Surface, render  # noqa: E402

SUPERSAMPLING = 8
SCENES = {
    "spheres": lambda: [shapes.sphere(bumps=0.2), shapes.sphere(0.2, (0.2, 0.1, -0.4), bumps=0.2, seed=1)],
    "body": lambda: [shapes.body()],
    "body and cloth": lambda: [shapes.body(), shapes.sheet()],
    "body, cloth and wall": lambda: [shapes.body(), shapes.sheet(), shapes.wall()],
}


def scene(name):
    return [shapes.surface(V, F, seed) for seed, (V, F) in enumerate(SCENES[name]())]


def pictures(seed, size):
    """Two smooth random pictures (3,size,size) between 0 and 1: weights and target of a loss."""
    i, j = np.mgrid[:size, :size] / size
    fields = (shapes.smooth_field(s, 0.3)(np.stack([j, i, 0 * i], -1)) for s in (seed, seed + 1))
    return [torch.tensor(0.5 + 0.4 * f, dtype=torch.float32).permute(2, 0, 1) for f in fields]


def losses(rendered, weight, target):
    """Of the picture averaged down to the target's size: colour and mask squared, depth as it is (where finite)."""
    size = target.shape[-1]
    pool = lambda x: torch.nn.functional.adaptive_avg_pool2d(x[None], size)[0]  # noqa: E731
    loss = {
        "image": (weight * (pool(rendered.image) - target).square()).mean(),
        "mask": (weight * (pool(rendered.mask[None]) - target).square()).mean(),
    }
    if rendered.depth.isfinite().all():
        loss["depth"] = (weight * pool(rendered.depth)).mean()
    return loss


def moved(surfaces, directions, step):
    return [Surface(s.vertices + step * d, s.faces, s.uv, s.face_uv, s.texture) for s, d in zip(surfaces, directions)]


def slopes(surfaces, size, directions, pixels=0.5):
    """Per loss: directional derivatives by the renderer's gradients and by central differences of +- `pixels`."""
    K, T = shapes.camera(size)
    fine = torch.diag(torch.tensor([SUPERSAMPLING, SUPERSAMPLING, 1.0])) @ K
    step, pair = pixels * 1.9 / size, pictures(7, size)
    for s in surfaces:
        s.vertices.requires_grad_()
    vertices = [s.vertices for s in surfaces]
    ours = {
        name: torch.autograd.grad(loss, vertices, retain_graph=True)
        for name, loss in losses(render(surfaces, K, T, (size, size)), *pair).items()
    }
    result = {name: [] for name in ours}
    for direction in directions:
        with torch.no_grad():
            up, down = (
                losses(render(moved(surfaces, direction, t), fine, T, (size * SUPERSAMPLING,) * 2), *pair)
                for t in (step, -step)
            )
        for name, gradient in ours.items():
            slope = sum(float((g.double() * d).sum()) for g, d in zip(gradient, direction))
            result[name].append((slope, float(up[name].double() - down[name].double()) / (2 * step)))
    return {name: np.array(pairs).T for name, pairs in result.items()}


def random_directions(surfaces, count, wavelength=1.5):
    fields = lambda k: [shapes.smooth_field(100 * k + i, wavelength) for i in range(len(surfaces))]  # noqa: E731
    points = [s.vertices.detach().numpy() for s in surfaces]
    return [[torch.tensor(f(p), dtype=torch.float32) for f, p in zip(fields(k), points)] for k in range(count)]


@pytest.mark.parametrize("name", ["spheres", "body", "body and cloth"])
def test_renderer_gradients_are_those_of_a_supersampled_image(name):
    surfaces = scene(name)
    for loss, (ours, true) in slopes(surfaces, 256, random_directions(surfaces, 8)).items():
        norms = np.linalg.norm(ours), np.linalg.norm(true)
        assert ours @ true > 0.95 * norms[0] * norms[1], loss
        assert 0.9 < norms[0] / norms[1] < 1.1, loss


def test_scatter_rasteriser_sees_the_same_faces_as_the_core():
    K, T = shapes.camera(256)
    V, F = shapes.body()
    body = torch.tensor(V + [0, 0, 3], dtype=torch.float32), torch.tensor(F).long()
    generator = torch.Generator().manual_seed(0)
    soup = torch.randn(200, 3, generator=generator) * 0.5 + torch.tensor([0, 0, 0.5])
    for vertices, faces in (body, (soup, torch.randint(0, 200, (300, 3), generator=generator))):
        face, depth = rasterise(vertices, faces, K, (200, 256))
        other_face, other_depth = rasterise_by_scatter(vertices, faces, K, (200, 256))
        same = face == other_face
        assert (face >= 0).sum() > 5000 and (~same).float().mean() < 1e-4
        torch.testing.assert_close(depth[same], other_depth[same], rtol=1e-6, atol=0)
