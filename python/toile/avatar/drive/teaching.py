"""Teaching the temporal model of a trained avatar: its targets, when to stop, what it measured.

docs/method/animation.md: E_TCN = |z - z_c|^2, z_c the mean code of the trained VAE.
"""

from __future__ import annotations

from copy import deepcopy
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.utils.data import default_collate

from ...errors import UserError
from ...frame_numbers import stride_of
from ...io.holdout import kept_apart
from ...io.run import open_run
from ..model.carried import COMPONENTS
from ..model.checkpoint import check_same, load_avatar, read_facts, topology, write_tensors
from ..model.kriging import KrigedModel
from ..train.data import AvatarData
from .driver import FILE, PREFIX, UNSEEN, Driver, one_thread, reader_of, run_track, untaught, without

SPAN = 0.5  # seconds of poses that the window model sees where nobody says how many
FOLDS = 4  # stretches of the training frames, each left out once to find when to stop
FEWEST = 40  # frames of which stretches can be left out; fewer are neighbours, and learnt by heart
CHECK = 20  # steps between looks at those left out
PATIENCE = 100  # steps
DECODED = 32  # codes decoded at a time


@one_thread()
def train_temporal(folder, settings, progress=lambda done, total: None):
    """Adds a temporal model to a trained avatar, of layers or AVATAR/baseline: temporal.safetensors in its folder. Returns what
    it measured. The baseline's reads the same features as the garments' of the avatar that it lies in.

    Trained on the frames that the avatar was trained on; windows hold poses of no held-out frame. A number of the code
    counts as far as it moves the cloth. FOLDS models are taught, each without one stretch of these frames, in as many `steps` as
    left the least error on these, and as many on all; they drive together (after Breiman, "Bagging Predictors", 1996). Of fewer
    than FEWEST frames one is taught. Else a kriged model has its share beside those of windows, where the settings ask for it.
    frames: how many taught it. kriged_share, where there is such a model: of what is said. Of several frames code_error, and held_out where frames were held out: squared error of the
    codes so weighted, over their variance in training.
    The same bits for any number of threads.
    UserError: the avatar has no garment, or its run is gone or another.
    """
    folder, facts = Path(folder), read_facts(folder)
    avatar = load_avatar(folder)
    if not any(model.networks.encoder is not None for model in avatar.models):
        raise UserError(f"{folder}: no garment with a code: there is no code that a motion could drive")
    run = open_run(facts["run"])
    whole = run_track(reader_of(folder, avatar), run)
    track = without(whole, kept_apart(run.holdout, facts["holdout"]))
    data = data_of(run, folder, facts, "cache", facts["frames"])
    targets, sizes = codes_of(avatar, data)
    rows = torch.tensor(track.rows(set(data.frames)))
    settings = settings.model_copy(update={"window": settings.window or max(round(SPAN * track.rate), 1)})
    torch.manual_seed(settings.seed)
    driver = Driver(settings, track.features.shape[1], sizes)
    driver.scale(track.features, targets, lambda mean, spread: code_reach(avatar, sizes, mean, spread))
    poses, scaled = driver.windows_of(track, rows), driver.scaled(targets)
    steps, copies = teach(driver, poses, scaled, progress)
    if settings.kriged and settings.model == "window":
        times = torch.tensor(data.frames, dtype=torch.float64) / run.scene.fps
        teach_kriged(driver, copies, poses, scaled, times, progress)
    unseen = codes_unseen(copies, track, rows)
    if unseen:
        driver.believe(torch.cat([unseen[name] for name in sizes], 1), targets)
        unseen = codes_unseen(copies, track, rows, driver.code_trust)
    measured = {"steps": steps, "frames": len(rows)} | (
        {"kriged_share": driver.kriged.share.item()} if driver.kriged else {}
    )
    several = len(rows) > 1  # the codes of a single frame have no variance
    if several:
        measured["code_error"] = relative_error(driver, track, data.frames, targets)
    if several and facts["holdout"]:
        new = data_of(run, folder, facts, "evaluation", facts["holdout"])
        measured["held_out"] = relative_error(driver, whole, new.frames, codes_of(avatar, new)[0])
    write_tensors(
        folder / FILE,
        {PREFIX + name: value for name, value in driver.state_dict().items()}
        | {UNSEEN + name: codes.contiguous() for name, codes in unseen.items()},
        {"unseen": track.frames[rows].tolist() if unseen else [], "models": len(driver.models),
         "kriged": len(rows) if driver.kriged else 0, "settings": settings.model_dump(mode="json"), "sizes": sizes, "features": track.features.shape[1],
         "stride": stride_of(whole.frames) or 1, "measured": measured},
    )  # fmt: skip
    return measured


def data_of(run, folder, facts, cache, frames):
    """AvatarData of frames of the Run that the avatar in `folder` was trained on; `facts`: its own."""
    data = AvatarData(run, facts["settings"].data, folder / cache, frames, facts["layered"], left_out=facts["holdout"])
    check_same(folder / "avatar.json", facts["topology"], topology(data.layers, data.scene, data.cameras))
    return data


def codes_of(avatar, data):
    """Mean codes (F,Z) of the frames of `data`, garments side by side, and {garment: Z}."""
    codes = []
    with torch.no_grad():
        for number in data.frames:  # a code sees all of a frame's views: one sample a frame
            by_garment = avatar.encode(default_collate([data[data.rows_of(number)[0]]]))
            codes.append(torch.cat([mean[0] for mean, _ in by_garment.values()]))
    return torch.stack(codes), {name: mean.shape[1] for name, (mean, _) in by_garment.items()}


@torch.no_grad()
def code_reach(avatar, sizes, mean, spread):
    """(Z,) root mean square motion of its layer's vertices when one number of the code leaves the mean by its spread [m]."""
    reach = []
    for name, z, one in zip(sizes, mean.split(list(sizes.values())), spread.split(list(sizes.values()))):
        codes = torch.cat([z[None], z + torch.diag(one)])
        shapes = torch.cat([avatar.unposed_by(name, part) for part in codes.split(DECODED)])
        reach.append((shapes[1:] - shapes[0]).square().sum(2).mean(1).sqrt())
    return torch.cat(reach)


def teach(driver, poses, targets, progress):
    """Teaches an untaught driver windows (F,L,COMPONENTS) in their order and scaled codes (F,Z): it becomes the mean of the copies of
    `stop_at` and of as many models taught on all frames, each by draws of its own; where no stretch was left out, one of these.
    Returns the number of steps and the copies."""
    steps, copies = stop_at(driver, poses, targets, progress)
    models, total = [copy.models[0] for _, copy in copies], targets.shape[1]
    for k in range(max(len(copies), 1)):
        if k:
            driver.models = nn.ModuleList([untaught(driver.settings, total)])
        list(fit(driver, poses, targets, steps, k))
        models.append(driver.models[0])
    driver.models = nn.ModuleList(models)
    return steps, copies


def teach_kriged(driver, copies, poses, targets, times, progress=lambda done, total: None):
    """Gives the driver a kriged model of windows (F,L,COMPONENTS), scaled codes (F,Z) and `times` (F,) [s], and each of the `copies` of
    `stop_at` one of the frames that it was taught. Their share of what is said is the one that leaves the least squared error on the
    stretches left out (after Breiman, "Stacked Regressions", 1996); where that is 0, or nothing was left out, there is none."""
    if not copies:
        return
    towards, missed = [], []
    for done, (left_out, copy) in enumerate(copies):
        progress(done, len(copies) + 1)
        kept = torch.ones(len(poses), dtype=torch.bool).index_fill(0, left_out, False)
        kriged = kriged_of(poses[kept], targets[kept], times[kept])
        with torch.no_grad():
            foretold = copy.told(poses[left_out])
            towards.append(kriged(poses[left_out]) - foretold)
        missed.append(targets[left_out] - foretold)
        copy.kriged = kriged
    towards, missed = torch.cat(towards), torch.cat(missed)
    share = ((towards * missed).sum() / towards.square().sum().clamp(min=1e-12)).clamp(0, 1)
    if not share:
        for _, copy in copies:
            copy.kriged = None
        return
    progress(len(copies), len(copies) + 1)
    driver.kriged = kriged_of(poses, targets, times)
    progress(len(copies) + 1, len(copies) + 1)
    for one in (driver, *(copy for _, copy in copies)):
        one.kriged.share.copy_(share)


def kriged_of(poses, targets, times):
    """A KrigedModel taught by windows (F,L,COMPONENTS), scaled codes (F,Z) and `times` (F,) [s]."""
    model = KrigedModel(COMPONENTS, targets.shape[1], len(poses))
    model.teach(poses, targets, times)
    return model


def stop_at(driver, poses, targets, progress):
    """The number of steps that leaves the least error on frames not trained on, of windows (F,L,COMPONENTS) in their order and
    scaled codes (F,Z): copies of the untaught driver, each without a stretch of the frames, are trained side by side until
    twice the best number of steps and PATIENCE more have brought nothing. Then [(stretch, its copy after so many steps)]."""
    steps = driver.settings.steps
    if len(poses) < FEWEST:
        return steps, []
    folds = []
    for left_out in torch.arange(len(poses)).chunk(FOLDS):
        kept = torch.ones(len(poses), dtype=torch.bool)
        kept[left_out] = False
        model = deepcopy(driver)
        folds.append((model, left_out, fit(model, poses[kept], targets[kept], steps)))
    best, least, copies = steps, np.inf, []
    for done in range(CHECK, steps + 1, CHECK):
        error = 0.0
        for model, left_out, training in folds:
            for _ in islice(training, CHECK):
                pass
            with torch.no_grad():
                error += model.errors(poses[left_out], targets[left_out]).sum().item()
        if error < least:
            best, least, copies = done, error, [(left_out, deepcopy(model)) for model, left_out, _ in folds]
        progress(done, steps)
        if done > 2 * best + PATIENCE:
            break
    progress(steps, steps)
    return best, copies


@torch.no_grad()
def codes_unseen(copies, track, rows, trust=1.0):
    """{garment: (F,Z)} of the frames at these rows (F,) of a Track, each by the copy of `stop_at` that was not taught it, as far as
    they are believed; {} where there are none."""
    parts = []
    for left_out, copy in copies:
        copy.code_trust.copy_(torch.as_tensor(trust))
        parts.append({name: codes[rows[left_out]] for name, codes in copy.latents(track).items()})
    return {name: torch.cat([one[name] for one in parts]) for name in parts[0]} if parts else {}


def fit(driver, poses, targets, steps, draws=0):
    """Trains an untaught driver on windows (F,L,COMPONENTS) and scaled codes (F,Z), which are drawn otherwise for other `draws`; yields
    the number of steps done."""
    settings = driver.settings
    generator = torch.Generator().manual_seed(settings.seed + draws)
    optimiser = torch.optim.AdamW(driver.models.parameters(), settings.lr, weight_decay=settings.weight_decay)
    for step in range(steps):
        pick = torch.randint(len(poses), (settings.batch,), generator=generator)
        loss = driver.errors(poses[pick], targets[pick]).mean()
        if not torch.isfinite(loss):
            raise UserError(f"temporal model: step {step}: the loss is not finite")
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(driver.models.parameters(), 1.0)
        optimiser.step()
        yield step + 1


@torch.no_grad()
def relative_error(driver, track, frames, targets):
    """Mean squared error of the codes of `frames`, whose own are `targets` (F,Z), as they move the cloth, over their variance
    in training; before smoothing."""
    read = driver.read(track)[track.rows(set(frames))]
    return float((read - driver.scaled(targets)).square().sum(1).mean())
