"""The single-layer baseline, trained with equal means: as many parameters, steps, numbers of its code and texels on the cloth as
the layered avatar, modes of its own registered surface, and a learning rate searched for it alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch.utils.data import default_collate

from ...errors import UserError
from ...frame_numbers import evenly
from ...surface.layers import surface_layer
from ...surface.uv import UvMap
from ..model.assets import read_assets
from ..model.checkpoint import load_avatar, read_facts
from ..model.sizes import matched_settings, modes_of
from . import losses
from .data import AvatarData

LEFT_OUT = 1 / 8  # of the training frames, the last ones: trials of learning rates are judged on them
SCORED = 24  # pictures of them, at most
WIDER = 3  # factors of two beyond an end of the search, at most
LABELLED = 8  # frames that say where the cloth is


def train_baseline(job, folder):
    """AVATAR/baseline of a trained AVATAR by a TrainingJob: its frames and steps, and the learning rate that is best for it."""
    layered, base = read_facts(folder), folder / "baseline"
    settings = equal_settings(job.run, folder, layered, job.request.say)
    scores = search(job, base, settings)
    best = min(scores, key=scores.get)
    job.request.say(f"baseline: learning rate {best:g} of {', '.join(f'{rate:g}' for rate in sorted(scores))}")
    searched = {f"{rate:g}": score for rate, score in scores.items()}
    job.train(base, settings.model_copy(update={"lr": best}), "baseline", False, searched=searched)


def equal_settings(run, folder, layered, say=lambda text: None):
    """The baseline's AvatarSettings, from the `layered` avatar's facts: as many texels on the cloth and as many parameters. Where garments
    cover one another both cannot be had, and its texture is the finest that as many parameters allow."""
    own, assets = layered["settings"], read_assets(folder, layered)
    garments = [layer for layer in assets["layers"] if layer.kind == "garment"]
    steps = {f"{name}_steps": layered["steps"].get(name, 0) for name in ("body", "garment", "joint")}
    network = own.network.model_copy(update={"latent": max(len(garments), 1) * own.network.latent})
    points = 0 if assets["face_mean"] is None else len(assets["face_mean"])
    scene = assets["layers"], assets["cameras"], assets["scene"], len(assets["J"]), points
    own_texels, wanted = own.data.texture_size, texel_factor(run, garments, layered["frames"], own.data.texture_size)
    for times in (wanted >> k for k in range(wanted.bit_length())):
        data = {"texture_size": times * own_texels, "modes": sum(map(modes_of, garments)), "window": 0}
        settings = own.model_copy(update=steps | {"data": own.data.model_copy(update=data), "network": network})
        found = matched_settings(own, settings, *scene)
        if found is not None:
            if times < wanted:
                say(
                    f"baseline: a texture of {times * own_texels} texels a side: {wanted * own_texels}, as many on the cloth as the "
                    "layers have, would need more parameters than theirs"
                )
            return found
    raise UserError(f"{folder}: no baseline has as many parameters as its layers: other sizes of networks are needed")


def texel_factor(run, garments, frames, size):
    """By how much finer the whole body's texture must be than one of `size` texels, a power of two, for the cloth to have as
    many texels on it as on the garments' own charts."""
    if not garments:
        return 1
    surface = surface_layer(run, frames[:1])
    labels = np.stack([run.labels.at(n) for n in evenly(frames, LABELLED)])
    cloth = np.isin(labels, [layer.label for layer in garments]).mean(0) > 0.5
    shown = UvMap(surface, size)
    there = cloth[surface.faces].all(1)[shown.face[shown.inside]].sum()
    wanted = sum(UvMap(layer, size).inside.sum() for layer in garments)
    return 2 ** max(math.ceil(math.log2(wanted / max(there, 1)) / 2), 0)


def search(job, base, settings):
    """{learning rate: error on training frames left out} of short trials without them: multiples `baseline_lr`, and beyond
    while an end of them is the best."""
    count = max(round(LEFT_OUT * len(job.frames)), 1)
    kept, unseen = job.frames[:-count] or job.frames, job.frames[-count:]
    trials = replace(job, frames=kept, held=unseen, known=job.frames)
    names = ("body_steps", "garment_steps", "joint_steps")
    short = {name: max(round(getattr(settings, name) * settings.baseline_search), 1) for name in names}
    scores, factors = {}, sorted(settings.baseline_lr)
    for _ in range(1 + WIDER):
        for factor in factors:
            rate, place = settings.lr * factor, base / "search" / f"{factor:g}"
            if rate not in scores:
                trial = settings.model_copy(update=short | {"lr": rate})
                trials.train(place, trial, f"trial {rate:g}", False, base / "cache")
                scores[rate] = unseen_error(job, place, trial, unseen, base / "cache")
        best = min(factors, key=lambda factor: scores[settings.lr * factor])
        beyond = [factors[0] / 2] * (best == factors[0]) + [2 * factors[-1]] * (best == factors[-1])
        if len(factors) == 1 or not beyond:
            break
        factors = sorted({*factors, *beyond})
    return scores


@torch.no_grad()
def unseen_error(job, folder, settings, frames, cache):
    """Mean absolute error of the foreground of pictures that a trained baseline encodes itself."""
    device = job.fabric.device
    avatar = load_avatar(folder).to(device)
    data = AvatarData(job.run, settings.data, cache, frames, layered=False, known=job.frames, left_out=job.held)
    found = []
    for row in evenly(range(len(data)), SCORED):
        batch = {name: value.to(device) for name, value in default_collate([data[row]]).items()}
        decoded = avatar.decode(batch, avatar.encoded(batch))
        image = avatar.compose(decoded, batch, batch["image"].shape[-2:])[0].image
        found.append(float(losses.image_l1(image[None].float(), batch["image"], batch["mask"])))
    return float(np.mean(found))
