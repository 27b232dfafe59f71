"""The avatar as a whole, on two tubes: what depends on what, what exists, what is drawn."""

import copy
import math

import numpy as np
import pytest
import torch

from tests.support.small_avatar import BODY, JACKET, SHIRT, SIZE, SURFACE, avatar, awake, batch, decoded, settings
from toile.avatar.model.avatar import pose_features, up_vector
from toile.avatar.model.sizes import PARITY, layer_parameters, matched_settings

LAYERED, BASELINE = (BODY, SHIRT), (SURFACE,)


def parts(model, name):
    return {part for part, net in model.model(name).networks.named_children() if net is not None}


# --- what it starts from --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layers", [LAYERED, BASELINE])
def test_untrained_avatar_is_the_mean_shape_posed_and_the_mean_texture(layers):
    model = avatar(layers)
    b = batch(model)
    for name, one in decoded(model, b).items():
        layer = model.model(name)
        assert torch.equal(one.unposed, layer.rest.expand_as(one.unposed))
        assert torch.equal(one.texture, layer.mean_texture.expand_as(one.texture))
        posed = layer.skin.pose(one.unposed, *model.skeleton(b["rotations"], b["translation"]))
        assert torch.equal(one.vertices, posed)


def test_unposed_takes_back_the_pose():
    model = avatar()
    b = batch(model)
    target = model.unposed(b, "shirt")
    assert (target - model.model("shirt").rest).abs().max() < 0.06  # the noise of 1 cm alone
    transforms = model.skeleton(b["rotations"], b["translation"])
    assert torch.allclose(model.model("shirt").skin.pose(target, *transforms), b["vertices.shirt"], atol=1e-5)


# --- what depends on what -------------------------------------------------------------------------------------------


def test_garment_never_sees_pose_or_face_and_the_body_does():
    model = awake(avatar())
    b = batch(model)
    z = model.means(model.encode(b))
    before = model.decode(b, z)
    posed = model.decode(b | {"rotations": b["rotations"] + 0.3}, z)
    smiling = model.decode(b | {"face": b["face"] + 0.02}, z)
    for after in (posed, smiling):
        assert torch.equal(before["shirt"].unposed, after["shirt"].unposed)
        assert torch.equal(before["shirt"].mean_texture, after["shirt"].mean_texture)
        assert not torch.equal(before["body"].unposed, after["body"].unposed)
        assert not torch.equal(before["body"].mean_texture, after["body"].mean_texture)
    assert not torch.equal(before["shirt"].vertices, posed["shirt"].vertices)  # skinning poses it


def test_garment_follows_its_code_and_the_body_has_none():
    model = awake(avatar())
    b = batch(model)
    codes = model.encode(b)
    assert set(codes) == {"shirt"}
    z = model.means(codes)
    before, after = model.decode(b, z), model.decode(b, {"shirt": z["shirt"] + 1})
    assert not torch.equal(before["shirt"].unposed, after["shirt"].unposed)
    assert not torch.equal(before["shirt"].mean_texture, after["shirt"].mean_texture)
    assert torch.equal(before["body"].unposed, after["body"].unposed)


def test_the_baseline_follows_pose_face_and_code():
    model = awake(avatar(BASELINE))
    b = batch(model)
    z = model.means(model.encode(b))
    before = model.decode(b, z)["surface"].unposed
    other = {"surface": z["surface"] + 1}
    for change, code in (({"rotations": b["rotations"] + 0.3}, z), ({"face": b["face"] + 0.02}, z), ({}, other)):
        assert not torch.equal(before, model.decode(b | change, code)["surface"].unposed)


def test_unseen_facial_keypoints_change_nothing():
    model = awake(avatar())
    b = batch(model)
    hidden = b | {"face_seen": torch.zeros_like(b["face_seen"])}
    one, other = decoded(model, hidden), decoded(model, hidden, face=b["face"] + 1)
    assert torch.equal(one["body"].unposed, other["body"].unposed)


@pytest.mark.parametrize("layers", [LAYERED, BASELINE])
def test_a_pose_beyond_the_training_s_is_read_as_the_farthest_that_was_taught_and_still_posed(layers):
    bent = np.zeros((5, 3, 3))
    bent[:, 1, 0] = np.linspace(-0.2, 0.2, 5)
    taught, free = awake(avatar(layers, poses={"rotations": bent})), awake(avatar(layers))
    b, of = batch(taught), layers[0].name
    z = taught.means(taught.encode(b))

    def bending(model, angle):
        rotations = torch.zeros_like(b["rotations"])
        rotations[:, 1, 0] = angle
        return model.decode(b | {"rotations": rotations}, z)[of]

    far, last, near = (bending(taught, angle) for angle in (1.0, 0.2, 0.1))
    assert torch.allclose(far.unposed, last.unposed, atol=1e-7) and torch.allclose(far.mean_texture, last.mean_texture)
    assert not torch.allclose(far.vertices, last.vertices, atol=1e-3) and not torch.allclose(near.unposed, last.unposed)
    assert torch.equal(near.unposed, bending(free, 0.1).unposed)
    assert not torch.allclose(bending(free, 1.0).unposed, far.unposed)


def test_where_the_person_stands_and_faces_changes_no_unposed_geometry():
    rotations, up = 0.3 * torch.randn(2, 3, 3), up_vector("z")
    turned = rotations.clone()
    turned[:, 0] = torch.tensor([0.0, 0.0, 2.5])
    upright = rotations.clone()
    upright[:, 0] = 0
    assert torch.allclose(pose_features(turned, up), pose_features(upright, up), atol=1e-6)
    assert not torch.allclose(pose_features(rotations, up), pose_features(upright, up), atol=1e-3)


def test_pose_features_are_continuous_through_half_a_turn():
    up = up_vector("z")
    angle = torch.tensor([math.pi - 1e-4, -math.pi + 1e-4])
    rotations = torch.zeros(2, 2, 3)
    rotations[:, 1, 0] = angle
    one, other = pose_features(rotations, up)
    assert torch.allclose(one, other, atol=1e-3)


@pytest.mark.parametrize("up, vector", [("z", [0, 0, 1]), ("y", [0, 1, 0]), ("-y", [0, -1, 0])])
def test_up_axis_of_the_scene(up, vector):
    assert up_vector(up).tolist() == vector


def test_view_moves_the_texture_alone_and_only_its_own_camera():
    model = awake(avatar())
    b = batch(model)
    other = b | {"T_camera_world": b["T_camera_world"].flip(0)}
    one, moved = decoded(model, b), decoded(model, other)
    for name in model.names:
        assert torch.equal(one[name].vertices, moved[name].vertices)
        assert torch.equal(one[name].mean_texture, moved[name].mean_texture)
        assert not torch.equal(one[name].texture, moved[name].texture)


def test_samples_of_a_batch_do_not_mix():
    model = awake(avatar())
    b = batch(model, 3)
    alone = {key: value[1:2] for key, value in b.items()}
    for name, one in decoded(model, alone).items():
        together = decoded(model, b)[name]
        assert torch.allclose(one.vertices, together.vertices[1:2], atol=1e-5)
        assert torch.allclose(one.texture, together.texture[1:2], atol=1e-4)


def test_only_the_named_layers_are_decoded_and_textures_only_when_asked():
    model = avatar()
    b = batch(model)
    assert set(model.decode(b, {}, ["body"])) == {"body"}
    geometry = model.decode(b, model.means(model.encode(b)), texture=False)["shirt"]
    assert geometry.texture is None and geometry.vertices is not None
    assert not model.encode(b, ["body"])


# --- what exists ----------------------------------------------------------------------------------------------------


def test_one_camera_has_no_view_branch_and_no_colours():
    model = avatar(views=1)
    assert "view" not in parts(model, "body") | parts(model, "shirt")
    assert "view" in parts(avatar(views=2), "body")
    assert model.colour_gain.numel() == 0
    one = decoded(model, batch(model))["body"]
    assert one.texture is one.mean_texture


def test_a_scene_that_is_not_view_dependent_has_no_view_branch():
    assert "view" not in parts(avatar(view_dependent=False), "body")


def test_no_face_no_face_branch():
    model = avatar(face=False)
    assert "face" not in parts(model, "body") and "face" in parts(avatar(), "body")
    b = batch(model)
    assert torch.equal(decoded(model, b)["body"].unposed, decoded(model, b, face=b["face"] * math.nan)["body"].unposed)


def test_no_garment_no_garment_network():
    model = awake(avatar((BODY,)))
    b = batch(model)
    assert model.names == ["body"] and not model.encode(b)
    assert not any("networks.encoder" in key or "networks.code" in key for key in model.state_dict())
    assert len(model.compose(decoded(model, b), b, SIZE, shadow=False)) == 2


def test_two_garments_have_their_own_networks_and_codes():
    model = awake(avatar((BODY, SHIRT, JACKET)))
    b = batch(model)
    z = model.means(model.encode(b))
    assert set(z) == {"shirt", "jacket"}
    before, after = model.decode(b, z), model.decode(b, z | {"jacket": z["jacket"] + 1})
    assert torch.equal(before["shirt"].unposed, after["shirt"].unposed)
    assert not torch.equal(before["jacket"].unposed, after["jacket"].unposed)
    picture = model.compose(before, b, SIZE, layer_depth=True, shadow=False)[0]
    assert picture.depth.shape == (3, *SIZE)


def test_parts_of_a_layer_follow_its_kind():
    driven = {"pose", "face", "geometry", "texture", "view", "shadow"}
    assert parts(avatar(), "body") == driven
    assert parts(avatar(), "shirt") == {"encoder", "code", "geometry", "texture", "view", "shadow"}
    assert parts(avatar(BASELINE), "surface") == driven | {"encoder", "code"}


@pytest.mark.parametrize("layers", [LAYERED, (BODY,), (BODY, SHIRT, JACKET)])
@pytest.mark.parametrize("quality", ["draft", "standard", "fine"])
def test_baseline_has_as_many_parameters_as_the_layered_avatar(quality, layers):
    from toile.avatar.settings import preset

    model = avatar(views=2)
    options = preset(quality)
    found = matched_settings(options, options, layers, model.cameras, model.scene, 104, 29)
    counts = [layer_parameters([x.kind for x in xs], s, model.cameras, model.scene, 104, 29, m)
              for xs, s, m in ((layers, options, 0), (BASELINE, found, options.data.modes))]  # fmt: skip
    assert abs(counts[1] / counts[0] - 1) < PARITY
    assert found.data == options.data and found.network.latent == options.network.latent


def test_built_baseline_keeps_the_parity_that_was_planned():
    layered = avatar()
    plain = layered.settings.model_copy(update={"data": layered.settings.data.model_copy(update={"modes": 0})})
    found = matched_settings(layered.settings, plain, LAYERED, layered.cameras, layered.scene, 3, 2)
    baseline = avatar(BASELINE, options=found)
    assert abs(baseline.parameters_count() / layered.parameters_count() - 1) < PARITY


def test_untrained_avatar_gives_back_what_its_modes_span():
    from dataclasses import replace

    from toile.surface.layers import principal_modes

    shapes = np.random.default_rng(4).normal(0, 0.01, (5, *SHIRT.rest.shape))
    moded = replace(SHIRT, modes=principal_modes(shapes - shapes.mean(0), 8))
    assert len(moded.modes) == 4
    model = avatar((BODY, moded))
    data = batch(model, 2)
    tensors = torch.as_tensor(np.stack([moded.rest + shapes[i] - shapes.mean(0) for i in (1, 3)]), dtype=torch.float32)
    shirt = model.model("shirt")
    data["vertices.shirt"] = shirt.skin.pose(tensors, *model.skeleton(data["rotations"], data["translation"]))
    codes = model.means(model.encode(data))
    assert codes["shirt"].shape == (2, 4 + model.settings.network.latent)
    assert torch.allclose(model.decode(data, codes)["shirt"].unposed, tensors, atol=1e-5)


def test_coarser_networks_change_a_fine_mean_texture():
    options = settings(texture_step=2)
    model = avatar(options=options.model_copy(update={"data": options.data.model_copy(update={"texture_size": 64})}))
    data = batch(model, 1)
    decoded = model.decode(data, model.means(model.encode(data)))["shirt"]
    assert decoded.texture.shape == (1, 3, 64, 64)
    torch.testing.assert_close(decoded.texture[0], model.model("shirt").mean_texture)
    awake(model)
    residual = (
        model.decode(data, model.means(model.encode(data)))["shirt"].mean_texture - model.model("shirt").mean_texture
    )
    assert residual.abs().max() > 0
    assert model.model("shirt").networks.texture.head.bias.shape[:2] == (32, 32)


def test_drawing_with_more_samples_averages_them():
    model = avatar()
    data = batch(model, 1)
    decoded = model.decode(data, model.means(model.encode(data)))
    one, four = (model.compose(decoded, data, SIZE, shadow=False, samples=n)[0] for n in (1, 2))
    fine = data | {"K": data["K"] * torch.tensor([[2.0], [2.0], [1.0]])}
    large = model.compose(decoded, fine, (2 * SIZE[0], 2 * SIZE[1]), shadow=False)[0]
    assert torch.allclose(four.mask, large.mask.reshape(SIZE[0], 2, SIZE[1], 2).mean((1, 3)), atol=1e-6)
    assert four.image.shape == one.image.shape and ((four.mask > 0) & (four.mask < 1)).any()


# --- drawing --------------------------------------------------------------------------------------------------------


def test_camera_0_and_new_cameras_keep_their_colours_and_the_others_gain_and_bias():
    model = avatar()
    with torch.no_grad():
        model.colour_gain[0], model.colour_bias[1] = 0.5, 0.1
    x = torch.full((4, 3, 2, 2), 0.4)
    got = model.colour(x, torch.tensor([0, 1, 2, -1]))
    assert got[:, 0, 0, 0].tolist() == pytest.approx([0.4, 0.6, 0.5, 0.4])


def test_composed_picture_shows_the_garment_before_the_body():
    model = avatar()
    b = batch(model)
    picture = model.compose(decoded(model, b), b, SIZE, layer_depth=True, shadow=False)[0]
    both = torch.isfinite(picture.depth).all(0)
    assert both.sum() > 20 and (picture.layer[both] == 1).float().mean() > 0.9
    assert picture.image.shape == (3, *SIZE) and (picture.image[:, picture.layer < 0] == 0).all()


def test_shadow_multiplies_the_texture_and_starts_at_one():
    model = avatar()
    b = batch(model)
    one = decoded(model, b)
    open_sky = {name: torch.rand(2, len(model.model(name).rest)) for name in one}
    assert torch.equal(model.shade(one, open_sky)["body"].shaded, one["body"].texture)
    awake(model)
    dark = model.shade(one, open_sky)["body"]
    assert torch.equal(dark.shaded, dark.texture * dark.shadow) and dark.shadow.std() > 0
    model.set_mean_ao({name: value[0] for name, value in open_sky.items()})
    flat, zero = (model.model("body").quasi_shadow(x) for x in (open_sky["body"], model.model("body").mean_ao[None]))
    assert torch.equal(flat[:1], zero)


def test_ambient_occlusion_sees_the_other_layers_and_is_not_differentiated():
    model = avatar()
    b = batch(model, 1)
    one = {name: copy.copy(x) for name, x in decoded(model, b).items()}
    together = model.ambient_occlusion(one)
    alone = model.ambient_occlusion({"body": one["body"]})
    assert together["body"].mean() < alone["body"].mean() - 0.05  # under the shirt
    assert all(((x >= 0) & (x <= 1)).all() and not x.requires_grad for x in together.values())


# --- state ----------------------------------------------------------------------------------------------------------


def test_state_is_parameters_and_mean_ao_and_restores_the_avatar():
    model = awake(avatar())
    model.set_mean_ao({"body": torch.rand(len(BODY.rest))})
    state = model.state_dict()
    assert {name for name, _ in model.named_parameters()} | {"models.0.mean_ao", "models.1.mean_ao"} <= set(state)
    assert all(value.layout == torch.strided and value.is_contiguous() for value in state.values())
    other = avatar(seed=9)
    other.load_state_dict(state)
    b = batch(model)
    for name, one in decoded(model, b).items():
        assert torch.equal(one.texture, decoded(other, b)[name].texture)
    assert torch.equal(other.model("body").mean_ao, model.model("body").mean_ao)


def test_the_same_seed_gives_the_same_avatar_and_draws():
    b = batch(avatar())
    draws = []
    for _ in range(2):
        model = awake(avatar(seed=3))
        torch.manual_seed(4)
        codes = model.encode(b)
        draws.append((model.sample(codes)["shirt"], model.impute(codes)["shirt"]))
    assert all(torch.equal(x, y) for x, y in zip(*draws, strict=True))
    assert not torch.equal(*draws[0])


def test_imputed_codes_carry_no_gradient_and_belong_to_no_sample_of_their_own():
    model = awake(avatar())
    codes = {"shirt": (torch.arange(6.0).reshape(6, 1) * 100, torch.full((6, 1), -10.0, requires_grad=True))}
    z = model.impute(codes)["shirt"]
    assert not z.requires_grad
    assert ((z - codes["shirt"][0]).abs() > 50)[1:].all()  # of sample 0 the prior is not to be told


def test_description_names_layers_parts_and_sizes():
    import json

    told = json.loads(json.dumps(avatar().describe()))
    assert [x["name"] for x in told["layers"]] == ["body", "shirt"]
    assert "encoder" in told["layers"][1]["parts"] and "encoder" not in told["layers"][0]["parts"]
    assert told["parameters"] == avatar().parameters_count()


def test_settings_sizes_scale_the_networks():
    small, wide = avatar(), avatar(options=settings(width=32))
    assert wide.parameters_count() > 1.2 * small.parameters_count()
