"""What a phase minimises: each term alone, through the whole objective, is driven down; phases ask for their own terms."""

import pytest
import torch

from tests.support.small_avatar import BODY, SHIRT, SURFACE, avatar, awake, batch, settings, tube
from toile.avatar.settings import AvatarSettings, LossWeights, Phase
from toile.avatar.train.losses import total
from toile.avatar.train.objective import Objective

SIDE = (32, 24)
INNER_SHIRT = tube("shirt", "garment", 0.09, 0.1, 0.5)  # inside the body


def objective(layers, **weights):
    model = avatar(layers)
    chosen = settings().model_copy(update={"weights": LossWeights(**weights)})
    return Objective(model, chosen)


def seen_sample(model, layers):
    """A batch whose pictures and masks are those of another avatar of the same layers."""
    made = batch(model)
    other = awake(avatar(layers), 0.5)
    with torch.no_grad():
        views = other.compose(other.decode(made, other.means(other.encode(made))), made, SIDE)
    made["image"] = torch.stack([view.image for view in views])
    made["mask"] = torch.stack([view.mask for view in views])
    made["labels"] = torch.full((2, *SIDE), 3)
    return made


def phase(layers, terms):
    return Phase(name="test", kinds=tuple({layer.kind for layer in layers}), terms=terms, steps=1, batch=2, lr=1e-2)


@pytest.mark.parametrize(
    "term, layers, share",
    [
        ("geometry", (BODY, SHIRT), 0.7),
        ("laplacian", (BODY, SHIRT), 0.8),
        ("texture", (BODY, SHIRT), 0.8),
        ("kl", (BODY, SHIRT), 0.5),
        ("image", (BODY, SHIRT), 0.7),
        ("mask", (BODY, SHIRT), 0.8),
        ("visibility", (BODY, INNER_SHIRT), 0.5),
        ("impute", (SURFACE,), 0.5),
    ],
)
def test_each_term_alone_is_driven_down(term, layers, share):
    """By gradient descent on the weighted total with every other weight 0: a term that is left out, or has the wrong sign,
    stays or grows."""
    weights = {name: 0.0 for name in LossWeights.model_fields} | {term: 1.0}
    job = objective(layers, **weights)
    together = term in ("image", "mask", "visibility")
    asked = phase(layers, ("image", "mask", "visibility") if together else (term,))
    sample = seen_sample(job.avatar, layers)
    optimiser, values = torch.optim.AdamW(job.parameters(), lr=1e-2, weight_decay=0.0), []
    for step in range(60):
        torch.manual_seed(step)
        terms = job(sample, asked, 1.0)
        values.append(float(terms[term].detach()))
        optimiser.zero_grad()
        total(terms, job.settings.weights).backward()
        optimiser.step()
    assert values[0] > 0
    assert sum(values[-5:]) / 5 < share * sum(values[:5]) / 5


def asked_terms(layered):
    return {p.name: set(p.terms) for p in AvatarSettings().phases(layered)}


def test_phases_ask_for_the_terms_of_the_method():
    assert asked_terms(True) == {
        "body": {"geometry", "laplacian", "texture"},
        "garment": {"geometry", "laplacian", "texture", "kl"},
        "joint": {"image", "mask", "visibility", "geometry", "laplacian", "kl"},
    }
    assert asked_terms(False)["surface"] == {"geometry", "laplacian", "texture", "kl", "impute"}
    assert all(weight > 0 for weight in LossWeights().model_dump().values())


@pytest.mark.parametrize("name", ["body", "garment", "joint"])
def test_objective_gives_every_term_that_a_phase_asks_for(name):
    job = objective((BODY, SHIRT))
    chosen = next(p for p in AvatarSettings().phases() if p.name == name)
    assert set(job(batch(job.avatar), chosen, 0.0)) == set(chosen.terms)


@pytest.mark.parametrize("name", ["body", "garment", "joint"])
def test_networks_multiplied_in_bfloat16_give_nearly_the_same_terms_and_slopes(name):
    """Losses and slopes stay float32, and what a batch holds is not rounded: eight bits put a vertex millimetres off."""
    job, chosen, found = objective((BODY, SHIRT)), next(p for p in AvatarSettings().phases() if p.name == name), []
    awake(job.avatar, 0.1)
    for job.half in (False, True):
        job.zero_grad(set_to_none=True)
        torch.manual_seed(0)
        terms = job(batch(job.avatar), chosen, 0.0)
        loss = total(terms, job.settings.weights)
        loss.backward()
        assert loss.dtype == torch.float32
        found.append((terms, torch.cat([p.grad.flatten() for p in job.parameters() if p.grad is not None])))
    (terms, slopes), (halved, others) = found
    for term, value in terms.items():
        assert float(halved[term].detach()) == pytest.approx(float(value.detach()), rel=0.03, abs=1e-6)
    assert not torch.equal(slopes, others)  # it was multiplied so
    assert torch.linalg.vector_norm(slopes - others) < 0.05 * torch.linalg.vector_norm(slopes)


def test_baseline_has_every_term_but_visibility():
    job = objective((SURFACE,))
    for chosen in AvatarSettings().phases(layered=False):
        assert set(job(batch(job.avatar), chosen, 0.0)) == set(chosen.terms) - {"visibility"}


def test_body_phase_leaves_the_garment_alone_and_the_other_way_round():
    job = objective((BODY, SHIRT))
    body, garment, _ = AvatarSettings().phases()
    for chosen, index in ((body, 0), (garment, 1)):
        job.zero_grad(set_to_none=True)
        total(job(batch(job.avatar), chosen, 0.0), job.settings.weights).backward()
        for i, model in enumerate(job.avatar.models):
            assert any(p.grad is not None for p in model.parameters()) == (i == index)


def test_c_is_annealed_from_first_to_last(monkeypatch):
    seen = []
    monkeypatch.setattr(
        "toile.avatar.train.losses.soft_visibility", lambda d, l, k, c: seen.append(c) or torch.zeros(())
    )
    job = objective((BODY, SHIRT))
    joint = list(AvatarSettings().phases())[-1]
    for share in (0.0, 0.5, 1.0):
        job(batch(job.avatar, 1), joint, share)
    assert seen == pytest.approx([0.020, 0.0125, 0.005])


def test_picture_shows_captured_beside_rendered():
    job = objective((BODY, SHIRT))
    sample = batch(job.avatar, 1)
    picture = job.picture(sample)
    assert picture.shape == (3, SIDE[0], 2 * SIDE[1]) and torch.equal(picture[..., : SIDE[1]], sample["image"][0])
    assert 0 < picture[..., SIDE[1] :].max() <= 1


def test_mean_occlusion_is_that_of_the_registered_frames():
    job = objective((BODY, SHIRT))
    made = batch(job.avatar, 2)
    data = [{name: value[i] for name, value in made.items()} for i in range(2)]
    job.prepare(data, lambda sample: sample)
    means = [model.mean_ao for model in job.avatar.models]
    assert (
        all(0 < mean.mean() <= 1 for mean in means) and means[0].mean() < means[1].mean()
    )  # the shirt shades the body


def test_rays_are_cast_once_a_frame_amid_the_registered_layers(monkeypatch):
    """Whatever the networks decode meanwhile, and in whatever batch a frame comes."""
    job, asked = objective((BODY, SHIRT)), []
    rays = job.avatar.ambient_occlusion
    monkeypatch.setattr(job.avatar, "ambient_occlusion", lambda posed: asked.append(posed) or rays(posed))
    sample, joint = seen_sample(job.avatar, (BODY, SHIRT)), phase((BODY, SHIRT), ("image", "mask"))
    asked.clear()
    job(sample, joint, 0.0)
    awake(job.avatar, 0.5)
    job({name: values.flip(0) for name, values in sample.items()}, joint, 0.0)
    assert len(asked) == 2  # frames
    for b, posed in enumerate(asked):
        assert all(torch.equal(one.vertices[0], sample[f"vertices.{name}"][b]) for name, one in posed.items())
    again = job.occlusion(sample)
    assert torch.equal(again["shirt"][1], rays(asked[1])["shirt"][0]) and not torch.equal(*again["shirt"])
