"""On a GPU an avatar draws, learns and moves as on the CPU. Where torch finds none, these tests are skipped."""

import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")
if not torch.cuda.is_available():
    pytest.skip("torch finds no GPU", allow_module_level=True)

from tests.support import surfaces as shapes  # noqa: E402
from tests.support.surfaces import body_and_cloth, f32, of_vertices, pictures  # noqa: E402
from toile.avatar.drive.animate import DrivenAvatar  # noqa: E402
from toile.avatar.drive.teaching import train_temporal  # noqa: E402
from toile.avatar.measure.evaluation import evaluate_avatar  # noqa: E402
from toile.avatar.model.edits import Edit, apply_edits  # noqa: E402
from toile.avatar.model.recorded import Recorded, decoder  # noqa: E402
from toile.avatar.render.rasterise import rasterise  # noqa: E402
from toile.avatar.render.renderer import Surface, render  # noqa: E402
from toile.avatar.settings import TemporalSettings, preset  # noqa: E402
from toile.avatar.train.make import Request, make_avatar  # noqa: E402

SIZE = 256
DRAWN = 0.01  # brightness by which two devices' pictures may differ at all but the pixels of DIFFERENT
DIFFERENT = 1e-3  # share of pixels whose centres lie on an edge, to rounding


def on_gpu(surface):
    return Surface(*(getattr(surface, key).cuda() for key in ("vertices", "faces", "uv", "face_uv", "texture")))


def drawn(surfaces, device, layer_depth=False):
    """Rendered, and the slopes of a random loss by vertices and texture, on the CPU."""
    moved = [on_gpu(s) for s in surfaces] if device == "cuda" else surfaces
    vertices = of_vertices(moved)
    textures = [s.texture.requires_grad_() for s in moved]
    K, T = shapes.camera(SIZE)
    weight, target = (x.to(device) for x in pictures(3, SIZE))
    seen = render(moved, K.to(device), T.to(device), (SIZE, SIZE), layer_depth=layer_depth)
    loss = (weight * (seen.image - target).square()).mean() + (weight[0] * (seen.mask - target[0]).square()).mean()
    return seen, [g.cpu() for g in torch.autograd.grad(loss, vertices + textures)]


@pytest.mark.parametrize("layer_depth", [False, True])
def test_pictures_and_their_slopes_are_those_of_the_cpu(layer_depth):
    (one, slopes), (other, others) = (drawn(body_and_cloth(), d, layer_depth) for d in ("cpu", "cuda"))
    assert other.image.is_cuda and other.image.dtype == torch.float32
    same = one.face == other.face.cpu()
    assert (~same).float().mean() < DIFFERENT
    torch.testing.assert_close(one.image[:, same], other.image.cpu()[:, same], atol=1e-3, rtol=0)
    assert torch.equal(one.layer[same], other.layer.cpu()[same])
    for a, b in zip(slopes, others):
        assert torch.linalg.vector_norm(a - b) < 0.02 * torch.linalg.vector_norm(a)


def test_pictures_without_gradients_are_those_with():
    surfaces = [on_gpu(s) for s in body_and_cloth()]
    K, T = (x.cuda() for x in shapes.camera(SIZE))
    with torch.no_grad():
        plain = render(surfaces, K, T, (SIZE, SIZE))
    of_vertices(surfaces)
    taught = render(surfaces, K, T, (SIZE, SIZE))
    assert (plain.face == taught.face).float().mean() > 1 - DIFFERENT
    same = plain.face == taught.face
    torch.testing.assert_close(plain.image[:, same], taught.image[:, same].detach(), atol=1e-3, rtol=0)
    torch.testing.assert_close(plain.mask, taught.mask.detach())


def test_nothing_to_be_seen_is_drawn_as_nothing():
    V = f32([[0, 0, -1], [1, 0, -1], [0, 1, -1]]).cuda()
    face, depth = rasterise(V, torch.tensor([[0, 1, 2]]).cuda(), torch.eye(3).cuda(), (8, 8))
    assert (face == -1).all() and torch.isinf(depth).all()


@pytest.fixture(scope="module")
def trained(sample_run, tmp_path_factory):
    """Taught on the GPU for some steps."""
    settings = preset("draft")
    data = settings.data.model_copy(update={"texture_size": 128, "image": (128, 128), "pixel_scale": 3.0})
    steps = {"body_steps": 40, "garment_steps": 40, "joint_steps": 60, "baseline_lr": (1.0,)}
    folder = tmp_path_factory.mktemp("gpu") / "avatar"
    request = Request(sample_run, settings.model_copy(update=steps | {"data": data}), say=lambda _: None)
    make_avatar(request, folder, baseline=True)
    train_temporal(folder, TemporalSettings(window=2, channels=8, steps=20))
    return folder


def test_it_learns_in_bf16(trained):
    lines = [json.loads(line) for line in (trained / "losses.jsonl").read_text().splitlines()]
    for phase, least in (("body", 0.8), ("garment", 0.8), ("joint", 0.9)):
        losses = [line["loss"] for line in lines if line["phase"] == phase]
        assert np.isfinite(losses).all()
        assert np.mean(losses[-10:]) < least * np.mean(losses[:3])


def test_one_avatar_is_the_same_on_both(trained, sample_run):
    both = [DrivenAvatar(trained, sample_run, device=torch.device(d)) for d in ("cpu", "cuda")]
    for i in (0, 3):
        seen = []
        for driven in both:
            batch = driven.batch(i, driven.avatar.cameras[0], 0)
            decoded, before, left, _ = driven.decode(i, batch)
            seen.append((decoded, before, left, driven.picture(decoded, batch, (SIZE, SIZE)).astype(int)))
        for name in seen[0][0]:
            one, other = (s[0][name].vertices.cpu() for s in seen)
            assert float((one - other).norm(dim=-1).max()) < 1e-4
        assert seen[1][2] == 0
        assert np.array_equal(both[1].picture(seen[1][0], batch, (SIZE, SIZE)), seen[1][3])
        assert (np.abs(seen[0][3] - seen[1][3]).max(2) > 255 * DRAWN).mean() < DIFFERENT


@pytest.mark.parametrize("painted", [False, True])
def test_what_is_recorded_decodes_as_what_is_not(trained, sample_run, painted):
    driven = DrivenAvatar(trained, sample_run, device=torch.device("cuda"))
    avatar = driven.avatar
    if painted:
        name = avatar.layers[-1].name
        cover = np.full((64, 64), 200, np.uint8)
        colour = np.broadcast_to(np.array([200, 30, 60], np.uint8), (64, 64, 3))
        both = dict(cover=cover, colour=colour), dict(cover=cover, scale=np.array([1, 0.5, 0.5]))
        apply_edits(avatar, [Edit(name, name, "test", **one) for one in both])
        avatar.cuda()
    recorded = decoder(avatar)
    assert isinstance(recorded, Recorded)
    frames = [(driven.batch(i, avatar.cameras[k], k), driven._codes(i)) for i, k in ((0, 0), (1, 3), (3, 5))]
    found = [recorded(*frame) for frame in frames]
    assert len(recorded.graphs) == 1
    with torch.no_grad():
        for frame, one in zip(frames, found):
            for name, plain in avatar.decode(*frame).items():
                torch.testing.assert_close(one[name].vertices, plain.vertices, atol=1e-6, rtol=0)
                torch.testing.assert_close(one[name].texture, plain.texture, atol=1e-4, rtol=0)
                torch.testing.assert_close(one[name].mean_texture, plain.mean_texture, atol=1e-4, rtol=0)
    again = decoder(avatar)
    for frame, one in zip(frames, found):
        for repeat in (recorded(*frame), again(*frame)):
            assert all(torch.equal(repeat[n].vertices, one[n].vertices) for n in one)
            assert all(torch.equal(repeat[n].texture, one[n].texture) for n in one)
    shapes_alone = recorded(*frames[1], texture=False)
    assert all(one.texture is None for one in shapes_alone.values())


def test_its_errors_are_the_same_on_both(trained, tmp_path, monkeypatch):
    found = []
    for device in ("cuda", "cpu"):
        folder = shutil.copytree(trained, tmp_path / device)
        if device == "cpu":
            monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
        found.append(evaluate_avatar(folder)["all"])
    for kind in ("layered", "baseline"):
        for measure in ("mse", "ssim"):
            assert found[0][kind][measure] == pytest.approx(found[1][kind][measure], rel=5e-3)
