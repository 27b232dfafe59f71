"""Driving a trained avatar by poses alone: the temporal model's features, targets, training and files.

METHOD, Animation: E_TCN = |z - z_c|^2, z_c the mean code of the trained VAE.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from pydantic import ValidationError
from torch import nn
from torch.utils.data import default_collate

from ..io.camera import first_error
from ..scene import CaptureError
from .avatar import FACE_SCALE, pose_features
from .checkpoint import check_same, load_avatar, load_model, read_facts, read_tensors, topology, write_tensors
from .data import AvatarData
from .layers import open_body
from .settings import TemporalSettings
from .temporal import DampedModel, TemporalModel, windows

FILE = "temporal.safetensors"
PREFIX = "model."


@dataclass(frozen=True)
class Track:
    """The poses of a motion in order. `first` (T,): where the row of neighbouring frames that each belongs to begins; the
    poses of a window lie `step` rows apart."""

    frames: np.ndarray  # (T,)
    features: torch.Tensor  # (T,P)
    first: torch.Tensor  # (T,) int64
    step: int = 1

    def rows(self, frames):
        """Rows of these frames, of those that the track has."""
        return [i for i, n in enumerate(self.frames.tolist()) if n in frames]


def make_track(avatar, frames, rotations, translation, face, stride):
    """Features of poses (T,K,3) and faces (T,q,3) or None, as `avatar` reads them. `stride`: frame numbers between the
    poses of a window; the motion's own step must divide it. Frames farther apart than that step are no neighbours."""
    features = pose_features(torch.as_tensor(rotations, dtype=torch.float32), avatar.up.cpu()).flatten(1)
    if hasattr(avatar, "face_mean"):
        points = avatar.face_mean.cpu()
        offset = torch.zeros(len(frames), *points.shape)
        if face is not None:
            offset = torch.nan_to_num(torch.as_tensor(face, dtype=torch.float32) - points) / FACE_SCALE
        features = torch.cat([features, offset.flatten(1)], 1)
    frames = np.asarray(frames)
    own = stride_of(frames) or stride
    if stride % own:
        raise CaptureError(f"motion: its frames are {own} apart, the temporal model was trained on poses {stride} apart")
    return Track(frames, features, row_starts(np.diff(frames) != own), stride // own)


def row_starts(breaks):
    """(T,) where each row of neighbours begins, from whether frame i + 1 is no neighbour of frame i (T-1,)."""
    begins = np.r_[True, breaks]
    return torch.as_tensor(np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0)))


def stride_of(frames):
    """The commonest step from one frame to the next; 0 for a single frame."""
    steps, counts = np.unique(np.diff(frames), return_counts=True)
    return int(steps[counts.argmax()]) if len(steps) else 0


class Driver(nn.Module):
    """Poses to the codes of every garment: a temporal model over standardised features and codes."""

    def __init__(self, settings, features, sizes):
        """`features`: P of a pose; `sizes` {garment: Z}."""
        super().__init__()
        self.settings, self.sizes = settings, dict(sizes)
        total = sum(self.sizes.values())
        if settings.model == "window":
            self.model = TemporalModel(features, total, settings.window, settings.channels)
        else:
            self.model = DampedModel(features, total, settings.channels)
        for name, size in (("feature", features), ("code", total)):
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_spread", torch.ones(size))
        self.register_buffer("code_range", torch.tensor([[-1.0], [1.0]]).repeat(1, total))  # of training, standardised

    def standardise(self, features, codes):
        """Sets means and spreads from training features (T,P) and codes (F,Z)."""
        self.feature_mean.copy_(features.mean(0))
        self.feature_spread.copy_(features.std(0, correction=0).clamp(min=self.settings.pose_floor))
        self.code_mean.copy_(codes.mean(0))
        self.code_spread.copy_(codes.std(0, correction=0).clamp(min=1e-3))
        known = (codes - self.code_mean) / self.code_spread
        self.code_range.copy_(torch.stack([known.amin(0), known.amax(0)]))

    def latents(self, track):
        """{garment: (T,Z)} for every frame of a Track, kept within the range of the training's codes: beyond it the decoder
        was never taught, and a pose far from the training's must not tear the cloth."""
        codes = self._codes(track, (track.features - self.feature_mean) / self.feature_spread)
        return dict(zip(self.sizes, codes.split(list(self.sizes.values()), dim=1)))

    def _codes(self, track, features):
        if self.settings.model == "window":
            read = self.model(windows(features, self.settings.window, track.first, track.step))
        else:
            rows = torch.unique(track.first).tolist() + [len(features)]
            read = features.new_zeros(len(features), len(self.code_mean))
            for a, b in zip(rows, rows[1:]):
                for row in range(a, min(a + track.step, b)):
                    read[row : b : track.step] = self.model(features[None, row : b : track.step])[0]
        return self.code_mean + self.code_spread * read.clamp(*self.code_range)

    def loss(self, features, first, rows, targets, generator):
        """Mean squared error of standardised codes over a batch drawn from the pictured frames `rows` with codes `targets`."""
        pick = torch.randint(len(rows), (self.settings.batch,), generator=generator)
        wanted = (targets[pick] - self.code_mean) / self.code_spread
        length = self.settings.window if self.settings.model == "window" else self.settings.stretch
        index = (rows[pick][:, None] + torch.arange(1 - length, 1)).maximum(first[rows[pick]][:, None])
        read = self.model(features[index])
        return (read if read.dim() == 2 else read[:, -1]).sub(wanted).square().mean()


def codes_of(avatar, data):
    """Mean codes (F,Z) of the frames of `data`, garments side by side, and {garment: Z}."""
    codes = []
    with torch.no_grad():
        for i in range(0, len(data), len(data.cameras)):  # a code sees all of a frame's views: one sample a frame
            found = avatar.encode(default_collate([data[i]]))
            codes.append(torch.cat([mean[0] for mean, _ in found.values()]))
    return torch.stack(codes), {name: mean.shape[1] for name, (mean, _) in found.items()}


def run_track(avatar, body, stride=None):
    """The Track of all registered frames of a RunBody, with pictures or without; `stride`: their own step by default."""
    rows = body.rows()
    frames = body.store["frames"][:][rows]
    face = body.store["face"][:][rows] if "face" in body.store else None
    pose = body.store["pose/rotations"][:][rows], body.store["pose/translation"][:][rows]
    return make_track(avatar, frames, *pose, face, stride or stride_of(frames) or 1)


def train_temporal(folder, settings, progress=lambda done, total: None):
    """Adds a temporal model to a trained avatar: AVATAR/temporal.safetensors. Returns what it measured.

    Trained on the frames that the avatar was trained on; windows hold poses of no held-out frame. code_error, and
    held_out where frames were held out: mean squared error of the codes over their variance in training.
    CaptureError: the avatar has no garment, or its run is gone or another.
    """
    folder, facts = Path(folder), read_facts(folder)
    avatar = load_avatar(folder)
    if avatar.settings.data.window or not any(layer.kind == "garment" for layer in avatar.layers):
        raise CaptureError(f"{folder}: no garment with a code: there is no code that a motion could drive")
    whole = run_track(avatar, open_body(facts["run"]))
    track = without(whole, held_out_span(facts["holdout"]))
    data = _data(folder, facts, "cache", facts["frames"])
    targets, sizes = codes_of(avatar, data)
    rows = torch.tensor(track.rows(set(data.frames)))
    generator = torch.Generator().manual_seed(settings.seed)
    torch.manual_seed(settings.seed)
    driver = Driver(settings, track.features.shape[1], sizes)
    driver.standardise(track.features, targets)
    _fit(driver, track, rows, targets, generator, progress)
    measured = {"code_error": relative_error(driver, track, data.frames, targets)}
    if facts["holdout"]:
        held = _data(folder, facts, "evaluation", facts["holdout"])
        measured["held_out"] = relative_error(driver, whole, held.frames, codes_of(avatar, held)[0])
    write_tensors(
        folder / FILE,
        {PREFIX + name: value for name, value in driver.state_dict().items()},
        {"settings": settings.model_dump(mode="json"), "sizes": sizes, "features": track.features.shape[1],
         "stride": stride_of(whole.frames) or 1, "measured": measured},
    )  # fmt: skip
    return measured


def _data(folder, facts, cache, frames):
    data = AvatarData(facts["run"], facts["settings"].data, folder=folder / cache, frames=frames)
    check_same(folder / "avatar.json", facts["topology"], topology(data.layers, data.scene, data.cameras))
    return data


def _fit(driver, track, rows, targets, generator, progress):
    settings = driver.settings
    features = (track.features - driver.feature_mean) / driver.feature_spread
    optimiser = torch.optim.AdamW(driver.parameters(), settings.lr, weight_decay=settings.weight_decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps, eta_min=0.05 * settings.lr)
    driver.train()
    for step in range(settings.steps):
        noise = torch.randn(features.shape, generator=generator)
        loss = driver.loss(features + settings.pose_noise * noise, track.first, rows, targets, generator)
        if not torch.isfinite(loss):
            raise CaptureError(f"temporal model: step {step}: the loss is not finite")
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(driver.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        progress(step + 1, settings.steps)
    driver.eval()


@torch.no_grad()
def relative_error(driver, track, frames, targets):
    """Mean squared error of the codes of `frames`, whose own are `targets` (F,Z), over their variance in training."""
    read = torch.cat(list(driver.latents(track).values()), dim=1)[track.rows(set(frames))]
    return float(((read - targets) / driver.code_spread).square().mean())


def held_out_span(frames):
    """Of the held-out pictured frames, contiguous among the pictured ones, all numbers from the first to the last."""
    return range(min(frames), max(frames) + 1) if frames else ()


def without(track, frames):
    """The track less these frames; those on either side are no neighbours."""
    keep = ~np.isin(track.frames, list(frames))
    kept = np.flatnonzero(keep)
    breaks = (np.diff(kept) > 1) | (track.first.numpy()[kept[1:]] == kept[1:])
    return Track(track.frames[keep], track.features[torch.as_tensor(keep)], row_starts(breaks), track.step)


def load_driver(folder):
    """(Driver, stride of the poses it was trained on, what its training measured) of a trained avatar's folder."""
    path = Path(folder) / FILE
    if not path.exists():
        raise CaptureError(f"{path}: the file is missing: `toile train RUN {folder} --temporal` makes it")
    tensors, facts = read_tensors(path)
    try:
        driver = Driver(TemporalSettings(**facts["settings"]), facts["features"], facts["sizes"])
    except ValidationError as error:
        raise first_error(path, error) from None
    except (KeyError, TypeError) as error:
        raise CaptureError(f"{path}: not a temporal model's facts: {error}") from None
    load_model(driver, tensors, path)
    return driver.eval(), int(facts["stride"]), facts.get("measured", {})
