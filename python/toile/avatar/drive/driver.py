"""Poses to the codes of a trained avatar's garments: what a motion says, the model that reads it, and its file.

The equations: docs/method/animation.md.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from pydantic import ValidationError
from torch import nn

from ...errors import UserError, first_line
from ...frame_numbers import stride_of
from ...io.camera import first_error
from ..model.carried import COMPONENTS, Projection
from ..model.checkpoint import load_avatar, load_model, read_tensors
from ..model.kriging import KrigedModel
from ..model.temporal import DampedModel, TemporalModel, windows
from ..settings import TemporalSettings

FILE = "temporal.safetensors"
PREFIX = "model."
UNSEEN = "unseen."  # codes of a garment by models that were not taught the frame
SMOOTH = 0.05  # [s] standard deviation of the Gaussian that codes are smoothed by over time: noise of poses must not shake cloth
REACH = 3 * SMOOTH  # [s] that it sees before and after
FORETOLD = 0.5  # of the codes' variance: where more is left on held-out frames a driven garment is often no better than a blurred one
LEAST_WEIGHT = 0.02  # of a code number that hardly moves the cloth, where all of them together have 1


@contextmanager
def one_thread():
    """Sums of several threads depend on how many there are."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True)
class Track:
    """The poses of a motion in order. `first` (T,): where the row of neighbouring frames that each belongs to begins; the
    poses of a window lie `step` rows apart; `rate` neighbouring rows make a second."""

    frames: np.ndarray  # (T,)
    features: torch.Tensor  # (T,P) of Avatar.carried
    first: torch.Tensor  # (T,) int64
    step: int
    rate: float

    def rows(self, frames):
        """Rows of these frames, of those that the track has."""
        return [i for i, n in enumerate(self.frames.tolist()) if n in frames]


def make_track(avatar, frames, rotations, face, stride, fps):
    """Poses (T,K,3) and faces (T,q,3) or None, as `avatar` reads them. `stride`: frame numbers, `fps` a second, between the poses of
    a window; the motion's own step must divide it. Frames farther apart than that step are no neighbours."""
    like = dict(dtype=torch.float32, device=avatar.up.device)
    features = avatar.carried(
        torch.as_tensor(rotations, **like), None if face is None else torch.as_tensor(face, **like)
    )
    frames = np.asarray(frames)
    own = stride_of(frames) or stride
    if stride % own:
        words = f"motion: its frames are {own} apart, the temporal model was trained on poses {stride} apart"
        raise UserError(
            f"{words}: `toile export` writes a run as .bvh, between whose frames bodies are turned and moved"
        )
    return Track(frames, features.cpu(), row_starts(np.diff(frames) != own), stride // own, fps / own)


def reader_of(folder, avatar):
    """The avatar whose garments say what a pose is: `avatar` of a folder, or of a baseline the one that it lies in. UserError:
    there is none."""
    reader = avatar if avatar.carried is not None else load_avatar(Path(folder).parent)
    if reader.carried is None:
        raise UserError(f"{folder}: no garment says what a pose is")
    return reader


def run_track(avatar, run, stride=None):
    """The Track of all registered frames of a Run, with pictures or without; `stride`: their own step by default."""
    rows = run.rows()
    frames, face = run.frames[rows], None if run.face is None else run.face[rows]
    stride = stride or stride_of(frames) or 1
    return make_track(avatar, frames, run.pose.rotations[rows], face, stride, run.scene.fps)


def row_starts(breaks):
    """(T,) where each row of neighbours begins, from whether frame i + 1 is no neighbour of frame i (T-1,)."""
    begins = np.r_[True, breaks]
    return torch.as_tensor(np.maximum.accumulate(np.where(begins, np.arange(len(begins)), 0)))


def stride_at(fps, stride, taught):
    """Frames at `fps` a second that lie as far apart, as nearly as can be, as `stride` frames at `taught` a second."""
    return max(round(stride * fps / taught), 1)


def without(track, frames):
    """The track less these frames; those on either side are no neighbours."""
    keep = ~np.isin(track.frames, list(frames))
    kept = np.flatnonzero(keep)
    breaks = (np.diff(kept) > 1) | (track.first.numpy()[kept[1:]] == kept[1:])
    return Track(track.frames[keep], track.features[torch.as_tensor(keep)], row_starts(breaks), track.step, track.rate)


class Driver(nn.Module):
    """Poses to the codes of every garment: temporal models over projected features and scaled codes, the mean of what they say; where there
    is a kriged model too, it has its share of that."""

    def __init__(self, settings, features, sizes, models=1, kriged=0):
        """`features`: P of a pose; `sizes` {garment: Z}; `models`: how many; `kriged`: frames that taught a kriged model, 0 for none."""
        super().__init__()
        self.settings, self.sizes = settings, dict(sizes)
        total = sum(self.sizes.values())
        self.models = nn.ModuleList(untaught(settings, total) for _ in range(models))
        self.kriged = KrigedModel(COMPONENTS, total, kriged) if kriged else None
        self.projection = Projection(features)
        self.register_buffer("code_mean", torch.zeros(total))
        self.register_buffer("code_spread", torch.ones(total))
        self.register_buffer("code_weight", torch.ones(total) / total**0.5)  # their squares sum to 1
        self.register_buffer("code_range", torch.tensor([[-1.0], [1.0]]).repeat(1, total))  # of training, scaled
        self.register_buffer("code_trust", torch.ones(total))  # share of what is read that is believed, one a garment

    @torch.no_grad()
    def scale(self, features, codes, reach=None):
        """Sets projection, means and spreads from training features (T,P) and codes (F,Z). `reach(mean, spread)` (Z,): how far
        each number's spread moves the cloth; all alike by default."""
        self.projection.fit(features)
        self.code_mean.copy_(codes.mean(0))
        self.code_spread.copy_(codes.std(0, correction=0).clamp(min=1e-3))
        weight = torch.ones_like(self.code_mean) if reach is None else reach(self.code_mean, self.code_spread)
        weight = (weight / weight.norm()).clamp(min=LEAST_WEIGHT)
        self.code_weight.copy_(weight / weight.norm())
        known = self.scaled(codes)
        self.code_range.copy_(torch.stack([known.amin(0), known.amax(0)]))

    def scaled(self, codes):
        """Codes (F,Z) as the model gives them: their variances sum to 1, each number has a share as it moves the cloth."""
        return (codes - self.code_mean) / self.code_spread * self.code_weight

    def latents(self, track):
        """{garment: (T,Z)} for every frame of a Track, kept within the range of the training's codes: beyond it the decoder
        was never taught, and a pose far from the training's must not tear the cloth. Smoothed over time."""
        codes = self.code_mean + self.code_spread * smoothed(self.read(track), track) / self.code_weight
        return dict(zip(self.sizes, codes.split(list(self.sizes.values()), dim=1)))

    def read(self, track):
        """Scaled codes (T,Z) of a Track as far as the model is believed, within the range of the training's."""
        return self._read(track).clamp(*self.code_range) * self.code_trust

    @torch.no_grad()
    def believe(self, unseen, targets):
        """Sets the share of each garment that leaves the least squared error, of codes (F,Z) that poses told where they were not taught
        and the right ones: what poses say by chance is not shown."""
        by_poses, right = self.scaled(unseen), self.scaled(targets)
        parts = zip(by_poses.split(list(self.sizes.values()), 1), right.split(list(self.sizes.values()), 1))
        shares = [(a * b).sum() / a.square().sum().clamp(min=1e-12) for a, b in parts]
        sizes = torch.tensor(list(self.sizes.values()))
        self.code_trust.copy_(torch.stack(shares).clamp(0, 1).repeat_interleave(sizes))

    def told(self, poses):
        """What the models say together, of windows (B,L,COMPONENTS) scaled codes (B,Z), of stretches (B,T,COMPONENTS) such (B,T,Z)."""
        codes = torch.stack([model(poses) for model in self.models]).mean(0)
        return codes if self.kriged is None else codes.lerp(self.kriged(poses), self.kriged.share)

    def _read(self, track):
        features = self.projection(track.features)
        if self.settings.model == "window":
            return self.told(windows(features, self.settings.window, track.first, track.step))
        rows = torch.unique(track.first).tolist() + [len(features)]
        read = features.new_zeros(len(features), len(self.code_mean))
        for a, b in zip(rows, rows[1:]):
            for row in range(a, min(a + track.step, b)):
                read[row : b : track.step] = self.told(features[None, row : b : track.step])[0]
        return read

    def windows_of(self, track, rows):
        """Projected features (F,L,COMPONENTS) of what the model reads for these rows of a Track (F,), to be taught with."""
        length = self.settings.window if self.settings.model == "window" else self.settings.stretch
        index = (rows[:, None] + track.step * torch.arange(1 - length, 1)).maximum(track.first[rows][:, None])
        return self.projection(track.features)[index]

    def errors(self, poses, targets):
        """(F,) squared errors of the scaled codes that windows (F,L,COMPONENTS) give, of scaled `targets` (F,Z)."""
        read = self.told(poses)
        return (read if read.dim() == 2 else read[:, -1]).sub(targets).square().sum(1)


def untaught(settings, codes):
    """A temporal model of TemporalSettings that answers the mean of scaled codes, which is 0."""
    if settings.model == "window":
        model = TemporalModel(COMPONENTS, codes, settings.window, settings.channels)
    else:
        model = DampedModel(COMPONENTS, codes, settings.channels)
    last = [part for part in model.modules() if isinstance(part, nn.Linear)][-1]
    for parameter in last.parameters():
        nn.init.zeros_(parameter)
    return model


def smoothed(codes, track):
    """Codes (T,Z) of a Track averaged over neighbouring rows by a Gaussian of SMOOTH."""
    total, weight = codes, torch.ones(len(codes), 1)
    for k in range(1, min(int(REACH * track.rate), len(codes) - 1) + 1):
        w = float(np.exp(-0.5 * (k / (SMOOTH * track.rate)) ** 2))
        near = w * (track.first[k:] == track.first[:-k])[:, None]
        pad = codes.new_zeros(k, 1)
        total = total + torch.cat([near * codes[k:], pad.expand(k, codes.shape[1])])
        total = total + torch.cat([pad.expand(k, codes.shape[1]), near * codes[:-k]])
        weight = weight + torch.cat([near, pad]) + torch.cat([pad, near])
    return total / weight


def load_driver(folder):
    """(Driver, stride of the poses it was trained on, what its training measured) of a trained avatar's folder."""
    path = Path(folder) / FILE
    if not path.exists():
        raise UserError(f"{path}: the file is missing: `toile train RUN {folder} --temporal` makes it")
    tensors, facts = read_tensors(path)
    if "models" not in facts:  # of an older toile, which had one
        tensors = {name.replace(f"{PREFIX}model.", f"{PREFIX}models.0.", 1): value for name, value in tensors.items()}
    try:
        models, kriged = int(facts.get("models", 1)), int(facts.get("kriged", 0))
        driver = Driver(TemporalSettings(**facts["settings"]), facts["features"], facts["sizes"], models, kriged)
    except ValidationError as error:
        raise UserError(
            f"{first_error(path, error)}; `toile train RUN {folder} --temporal` makes the model anew"
        ) from None
    except (KeyError, TypeError, ValueError, RuntimeError) as error:  # the last of sizes that no tensor has
        raise UserError(f"{path}: not a temporal model's facts: {first_line(error)}") from None
    try:
        load_model(driver, tensors, path)
    except UserError as error:
        raise UserError(f"{error}; `toile train RUN {folder} --temporal` makes the model anew") from None
    return driver.eval(), int(facts["stride"]), facts.get("measured", {})


def taught_before(folder):
    """The TemporalSettings that the model of an avatar's folder was taught with; None where there is none that can be read."""
    path = Path(folder) / FILE
    try:
        return TemporalSettings(**read_tensors(path)[1]["settings"]) if path.exists() else None
    except (UserError, ValidationError, KeyError, TypeError):
        return None


def hardly_foretold(measured):
    """What a user should know of a temporal model that knows no motion, or hardly that which was held out, by what its training measured."""
    if measured.get("frames") == 1:
        return ["one training frame teaches no driving: garments keep its shape in every pose; give more frames"]
    error = measured.get("held_out", 0.0)
    if error < FORETOLD:
        return []
    words = (
        f"poses foretell garments badly: in the frames held out codes err by {error:.2f} of their variance in training"
    )
    return [f"{words} (below {FORETOLD:g} is usual): a longer motion teaches more"]


def unseen_codes(folder):
    """([frame], {garment: (F,Z)}) of the training's frames: codes of temporal models alike, each taught without the frame. Nothing where
    none were left out."""
    tensors, facts = read_tensors(Path(folder) / FILE)
    return facts.get("unseen", []), {n.removeprefix(UNSEEN): z for n, z in tensors.items() if n.startswith(UNSEEN)}
