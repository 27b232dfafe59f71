"""Light is found from how texels change as their normals turn, and falls on every pose from where it did."""

import shutil

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from tests.support.small_avatar import BODY, SHIRT, SURFACE, avatar, awake, batch
from toile.avatar.model.checkpoint import load_avatar
from toile.avatar.model.light import DARKEST, TERMS, explained, fit_light, irradiance, irradiance_basis

LIGHT = np.array([[0.05, -0.1, 0.4, -0.04, -0.1, -0.03, 0.05, -0.08]] * 3).T * [1, 0.9, 1.1]


def directions(count, seed=0):
    n = np.random.default_rng(seed).normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def turned(normals, frames, spread=0.6, seed=1):
    """(F,P,3): the normals under random turns."""
    turns = Rotation.from_rotvec(np.random.default_rng(seed).normal(0, spread, (frames, 3)))
    return np.stack([turn.apply(normals) for turn in turns])


def observed(light, frames=12, count=300, spread=0.6, seed=2):
    """Colours (F,P,3) of random albedos, all seen, and Y."""
    albedo = np.random.default_rng(seed).uniform(0.2, 0.6, (count, 3))
    basis = irradiance_basis(turned(directions(count, seed), frames, spread))
    return albedo * irradiance(basis, light), np.ones((frames, count), bool), basis


def test_light_without_noise_is_found_exactly():
    for light in (LIGHT, np.zeros((TERMS, 3))):
        np.testing.assert_allclose(fit_light([observed(light), observed(light, seed=3)]), light, atol=2e-3)


def test_prints_that_slip_and_noise_hardly_change_it():
    colours, seen, basis = observed(LIGHT, count=2000)
    rng = np.random.default_rng(4)
    slipped = rng.random(seen.shape) < 0.1
    colours = np.where(slipped[..., None], rng.uniform(0, 1, colours.shape), colours)
    colours += rng.normal(0, 0.02, colours.shape)
    np.testing.assert_allclose(fit_light([(colours, seen, basis)]), LIGHT, atol=0.03)


def test_what_was_not_seen_is_not_read():
    colours, seen, basis = observed(LIGHT)
    seen[np.random.default_rng(5).random(seen.shape) < 0.3] = False
    seen[:, 7] = False
    np.testing.assert_allclose(fit_light([(np.where(seen[..., None], colours, 9), seen, basis)]), LIGHT, atol=2e-3)


def test_what_never_turned_tells_of_no_light():
    assert not fit_light([observed(LIGHT, frames=1)]).any()
    still = observed(LIGHT, spread=0.0)
    noise = np.random.default_rng(6).normal(0, 0.02, still[0].shape)
    assert np.abs(fit_light([(still[0] + noise, *still[1:])])).max() < 1e-3
    assert not fit_light([(np.zeros((4, 0, 3)), np.zeros((4, 0), bool), np.zeros((4, 0, TERMS)))]).any()


def test_lamps_on_a_matt_surface_are_a_polynomial_to_some_percent():
    lamps = directions(3, seed=8)
    n = turned(directions(400), 20, spread=1.5)
    shown = 0.4 + 0.5 * np.maximum(n @ lamps.T, 0).sum(-1, keepdims=True) * np.ones(3)
    basis = irradiance_basis(n)
    light = fit_light([(shown, np.ones(shown.shape[:2], bool), basis)])
    said = irradiance(basis, light)
    albedo = (shown.mean(0) / said.mean(0)).mean()
    assert np.abs(albedo * said / shown - 1).mean() < 0.04


def test_terms_have_no_mean_and_no_light_is_darker_than_the_least():
    basis = irradiance_basis(directions(200_000))
    assert np.abs(basis.mean(0)).max() < 0.01
    assert irradiance(basis, 5 * LIGHT).min() == DARKEST
    assert not irradiance_basis(np.zeros((2, 3))).any()
    torch.testing.assert_close(irradiance_basis(torch.as_tensor(directions(9))), torch.as_tensor(basis[:9]))


def test_what_a_light_explains_is_told_by_frames_that_did_not_find_it():
    assert explained([observed(LIGHT)]) > 0.99
    colours, seen, basis = observed(0 * LIGHT)
    flickering = colours * np.random.default_rng(9).uniform(0.7, 1.3, (len(colours), 1, 1))  # an exposure that drifts
    assert explained([(flickering, seen, basis)]) < 0.1
    assert explained([observed(LIGHT, frames=1)]) == 0


# --- an avatar ------------------------------------------------------------------------------------------------------


def lit_avatar(layers=(BODY, SHIRT), **options):
    rng = np.random.default_rng(7)
    mean = {layer.name: rng.uniform(0.8, 1.2, (3, 16, 16)) for layer in layers}
    return awake(avatar(layers, light=LIGHT, mean_light=mean, **options))


@pytest.mark.parametrize("layers", [(BODY, SHIRT), (SURFACE,)])
def test_a_person_who_turns_round_is_lit_from_where_the_light_is(layers):
    model, dark = lit_avatar(layers, views=1), awake(avatar(layers, views=1))
    b = batch(model)
    away = b["rotations"].clone()
    away[:, 0] = torch.tensor([0.0, 0.0, np.pi])
    upright = b["rotations"].clone()
    upright[:, 0] = 0.0
    with torch.no_grad():
        z = model.means(model.encode(b))
        for name in model.names:
            one, other = (model.decode(b | {"rotations": r}, z)[name] for r in (upright, away))
            plain = dark.decode(b | {"rotations": away}, z)[name]
            torch.testing.assert_close(one.mean_texture, other.mean_texture, atol=1e-5, rtol=0)
            torch.testing.assert_close(plain.texture, plain.mean_texture)
            normals = model.model(name).facing.normals(other.vertices)
            E = irradiance(irradiance_basis(normals), model.light)
            expected = model.model(name).light_texels(E) / model.model(name).mean_light
            known = model.model(name).light_texels(torch.ones_like(E)) > 0
            got = torch.nn.functional.avg_pool2d(
                other.texture / other.mean_texture, 2
            )  # texels of light are twice as large
            inside = torch.nn.functional.avg_pool2d(known.float(), 3, 1, 1) == 1
            assert ((got - expected).abs()[inside] < 0.15).float().mean() > 0.9
            assert (one.texture - other.texture).abs().max() > 0.05


def test_a_code_says_nothing_of_the_light():
    model = lit_avatar()
    b = batch(model)
    lit = model._registered_lit(b, model.model("shirt"))
    brighter = torch.nn.functional.interpolate(lit, size=32, mode="bilinear", align_corners=False)
    key = "mean_texture.shirt"
    dark = awake(avatar())
    found = model.encode(b | {key: b[key] * brighter})["shirt"][0]
    torch.testing.assert_close(found, dark.encode(b)["shirt"][0], atol=1e-3, rtol=1e-3)


def test_light_comes_back_with_an_avatar_and_one_of_before_has_none(sample_avatar, tmp_path):
    folder = shutil.copytree(sample_avatar, tmp_path / "avatar", ignore=shutil.ignore_patterns("cache"))
    maps = folder / "assets" / "maps.npz"
    with np.load(maps) as fields:
        np.savez(maps, **dict(fields) | {"light": LIGHT.astype(np.float32)})
    found = load_avatar(folder)
    assert found.light.abs().max() > 0
    with np.load(maps) as fields:
        kept = {name: value for name, value in fields.items() if not name.startswith(("light", "mean_light"))}
        assert np.array_equal(fields["light"], found.light.numpy())
        assert np.array_equal(fields["mean_light.tshirt"], found.model("tshirt").mean_light.numpy())
    np.savez(maps, **kept)
    before = load_avatar(folder)
    assert before.light is None and all(model.mean_light is None for model in before.models)


def test_light_moves_no_geometry():
    model = lit_avatar()
    b = batch(model)
    b["rotations"].requires_grad_()
    decoded = model.decode(b, model.means(model.encode(b)))
    lit = decoded["shirt"].texture.sum() - decoded["shirt"].mean_texture.sum()
    (moved,) = torch.autograd.grad(lit, model.model("shirt").networks.geometry.head.gain, allow_unused=True)
    assert moved is None or not moved.any()
