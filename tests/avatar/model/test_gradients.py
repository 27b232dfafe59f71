"""Losses of the whole avatar, on two tubes: finite at extremes, each reaches its networks and can be driven down."""

import copy
import math

import pytest
import torch

from tests.support.small_avatar import BODY, SHIRT, SIZE, SURFACE, avatar, awake, batch, decoded
from toile.avatar.train import losses

LAYERED, BASELINE = (BODY, SHIRT), (SURFACE,)


def all_losses(model, b, c=0.02):
    """Every loss of docs/method/avatars.md that applies to this avatar."""
    codes = model.encode(b)
    out = model.decode(b, model.sample(codes))
    terms = {name: [] for name in ("geometry", "laplacian", "texture", "kl", "image", "mask", "visibility", "impute")}
    imputed = model.decode(b, model.impute(codes), texture=False)
    for layer in model.layers:
        name, one, target = layer.name, out[layer.name], model.unposed(b, layer.name)
        terms["geometry"].append(losses.geometry(one.unposed, target, b[f"confidence.{name}"]))
        terms["laplacian"].append(losses.laplacian(model.laplacian[name], one.unposed, target))
        colours = model.colour(one.texture, b["camera"])
        terms["texture"].append(losses.texture(colours, b[f"texture.{name}"], b[f"texel_weight.{name}"]))
        if name in codes:
            terms["kl"].append(losses.kl(*codes[name]))
        if name in model.anchors:
            terms["impute"].append(losses.impute(model.anchors[name], imputed[name].unposed, target))
    open_sky = {name: torch.full(x.vertices.shape[:2], 0.8) for name, x in out.items()}
    pictures = model.compose(model.shade(out, open_sky), b, SIZE, layer_depth=True, shadow=False)
    images, masks = torch.stack([p.image for p in pictures]), torch.stack([p.mask for p in pictures])
    terms["image"].append(losses.image_l1(images, b["image"], b["mask"]))
    terms["mask"].append(losses.mask_l1(masks, b["mask"]))
    labels = [layer.label for layer in model.layers]
    for p, seen in zip(pictures, b["labels"], strict=True):
        terms["visibility"].append(losses.soft_visibility(p.depth, seen, labels, c))
    return {name: torch.stack(values).mean() for name, values in terms.items() if values}


ONES = {name: 1.0 for name in ("geometry", "laplacian", "texture", "kl", "image", "mask", "visibility", "impute")}


def extremes():
    def without(*keys):
        return lambda b: {k: torch.zeros_like(v) if k.startswith(keys) else v for k, v in b.items()}

    def pictures(value):
        keys = ("image", "texture", "mean_texture")
        return lambda b: {k: torch.full_like(v, value) if k.startswith(keys) else v for k, v in b.items()}

    def away(b):
        view = b["T_camera_world"].clone()
        view[:, 0, 3] += 50
        return b | {"T_camera_world": view}

    def one(b):
        return {k: v[:1] for k, v in b.items()}

    return {
        "as it is": lambda b: b,
        "black": pictures(0.0),
        "white": pictures(1.0),
        "saturated": pictures(100.0),
        "nothing seen": without("texel_weight", "mean_weight", "confidence", "mask", "labels"),
        "empty views": away,
        "one frame": one,
        "face unseen": without("face_seen"),
        "rest pose": without("rotations", "translation"),
    }


@pytest.mark.parametrize("autocast", [False, True], ids=["f32", "bf16"])
@pytest.mark.parametrize("layers", [LAYERED, BASELINE], ids=["layered", "baseline"])
@pytest.mark.parametrize("name", extremes())
def test_losses_and_gradients_are_finite(name, layers, autocast):
    model = awake(avatar(layers))
    b = extremes()[name](batch(model))
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=autocast):
        values = all_losses(model, b)
    losses.total(values, ONES).backward()
    assert all(math.isfinite(v.item()) and v.dtype == torch.float32 for v in values.values())
    for key, p in model.named_parameters():
        assert p.grad is None or torch.isfinite(p.grad).all(), key


@pytest.mark.parametrize("bias", [-1e4, 1e4])
def test_sigma_at_its_bounds_stays_finite(bias):
    model = awake(avatar())
    with torch.no_grad():
        model.model("shirt").networks.encoder.logvar.bias.fill_(bias)
    values = all_losses(model, batch(model))
    losses.total(values, ONES).backward()
    assert all(math.isfinite(v.item()) for v in values.values())
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)


REACHED = {  # a parameter that each term has to reach, in the layered avatar (impute: in the baseline)
    "geometry": ("shirt", "geometry"),
    "laplacian": ("body", "geometry"),
    "texture": ("shirt", "view"),
    "kl": ("shirt", "encoder"),
    "image": ("body", "shadow"),
    "mask": ("shirt", "geometry"),
    "visibility": ("shirt", "geometry"),
    "impute": ("surface", "pose"),
}


@pytest.mark.parametrize("term", REACHED)
def test_each_term_reaches_its_networks_and_a_step_down_its_gradient_lowers_it(term):
    name, part = REACHED[term]
    model = awake(avatar(BASELINE if term == "impute" else LAYERED))
    b = batch(model)
    if term == "visibility":  # the body before the cloth, on purpose
        with torch.no_grad():
            model.model("shirt").rest *= torch.tensor([0.7, 0.7, 1.0])

    def value():
        torch.manual_seed(0)
        return all_losses(model, b)[term]

    before, parameters = value(), list(getattr(model.model(name).networks, part).parameters())
    gradients = torch.autograd.grad(before, parameters, allow_unused=True)
    squared = sum(float(g.square().sum()) for g in gradients if g is not None)
    assert before.item() > 1e-4 and squared > 0
    wanted = 0.005 * before.item()
    with torch.no_grad():
        for p, g in zip(parameters, gradients):
            if g is not None:
                p -= wanted / squared * g
    lowered = (before - value()).item() / wanted
    # silhouettes of 24 pixels jump from one to the next; the other terms are smooth
    assert lowered > 0.25 if term in ("mask", "visibility") else 0.5 < lowered < 1.5, lowered


@pytest.mark.parametrize("term", REACHED)
def test_overfitting_one_sample_drives_each_loss_down(term):
    model = avatar(BASELINE if term == "impute" else LAYERED)
    b = batch(model, 1)
    if term in ("kl", "visibility"):
        awake(model)
    if term == "visibility":
        with torch.no_grad():
            model.model("shirt").rest *= torch.tensor([0.8, 0.8, 1.0])
        b["labels"].fill_(3)
    if term == "mask":  # a person 1.5 cm wider
        with torch.no_grad():
            widened = copy.deepcopy(model)
            for one in widened.models:
                one.rest *= torch.tensor([1.15, 1.15, 1.0])
            b["mask"] = torch.stack([p.mask for p in widened.compose(decoded(widened, b), b, SIZE, shadow=False)])
    rate = {"mask": 2e-3, "visibility": 2e-3, "image": 4e-3}.get(term, 1e-2)  # what moves silhouettes, gently
    optimiser = torch.optim.AdamW(model.parameters(), lr=rate)
    history = []
    for _ in range(60):
        torch.manual_seed(0)
        loss = all_losses(model, b)[term]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        history.append(loss.item())
    assert min(history[-5:]) < 0.7 * history[0], history[::10]


def test_soft_visibility_brings_the_garment_before_the_body():
    model = avatar()
    with torch.no_grad():  # the shirt 2.4 cm within the body
        model.model("shirt").rest *= torch.tensor([0.63, 0.63, 1.0])
    b = batch(model, 1)
    b["labels"].fill_(3)
    optimiser = torch.optim.AdamW(model.parameters(), lr=1e-3)
    labels = [layer.label for layer in model.layers]

    def in_front():
        out = decoded(model, b)
        p = model.compose(out, b, SIZE, layer_depth=True, shadow=False)[0]
        both = torch.isfinite(p.depth).all(0)
        return out, p, (p.layer[both] == 1).float().mean().item()

    hard = torch.autograd.grad(in_front()[1].image.sum(), list(model.model("shirt").parameters()), allow_unused=True)
    assert in_front()[2] < 0.05 and not any(g is not None and g.any() for g in hard)  # a z-buffer sees no shirt to move
    for _ in range(150):
        out, p, _ = in_front()
        smooth = losses.laplacian(model.laplacian["shirt"], out["shirt"].unposed, model.model("shirt").rest[None])
        loss = losses.soft_visibility(p.depth, b["labels"][0], labels, 0.02) + smooth
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert in_front()[2] > 0.95
