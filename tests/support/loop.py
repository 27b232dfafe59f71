"""A tiny model in place of the avatar, so that tests of the training loop take seconds."""

from types import SimpleNamespace

import torch
from lightning_fabric import Fabric

from toile.avatar.settings import AvatarSettings
from toile.avatar.train import training as train

FRAMES = 12


class Samples(torch.utils.data.Dataset):
    """y = 3 x + noise; `spoil(i, sample)` may change what is read."""

    layers = [SimpleNamespace(name="body", kind="body"), SimpleNamespace(name="shirt", kind="garment")]

    def __init__(self, spoil=lambda i, sample: sample):
        self.spoil, self.read = spoil, []

    def __len__(self):
        return FRAMES

    def __getitem__(self, i):
        self.read.append(i)
        x = torch.tensor([float(i), float(i % 3), 1.0]) / FRAMES
        return self.spoil(i, {"x": x, "y": 3 * x.sum()})


class TinyObjective(torch.nn.Module):
    """Draws noise as a VAE does, has a colour parameter and terms named as the real ones."""

    def __init__(self, avatar, settings, half=False):
        super().__init__()
        self.avatar, self.settings = avatar, settings

    def prepare(self, data, to_device):
        pass

    def forward(self, batch, phase, share):
        z = batch["x"] + 0.01 * torch.randn_like(batch["x"])
        error = (self.avatar.net(z)[:, 0] * (1 + self.avatar.colour) - batch["y"]).square().mean()
        return {"image" if "image" in phase.terms else "geometry": error}

    def picture(self, batch):
        return torch.zeros(3, 4, 8)


def tiny_avatar():
    torch.manual_seed(7)
    avatar = torch.nn.Module()
    avatar.net = torch.nn.Sequential(torch.nn.Linear(3, 8), torch.nn.Tanh(), torch.nn.Linear(8, 1))
    avatar.colour = torch.nn.Parameter(torch.zeros(()))
    return avatar


def settings(**changes):
    values = dict(
        body_steps=20,
        garment_steps=15,
        joint_steps=30,
        batch=3,
        joint_batch=2,
        lr=1e-2,
        checkpoint_every=8,
        picture_every=20,
    )
    return AvatarSettings(**values | changes)


def training(folder, monkeypatch, data=None, chosen=None, say=lambda message: None, **arguments):
    """A Training of the tiny model in `folder`, as a new process would make it."""
    monkeypatch.setattr(train, "Objective", TinyObjective)
    chosen = chosen or settings()
    fabric = Fabric(accelerator="cpu", devices=1)
    return train.Training(
        folder, tiny_avatar(), data or Samples(), chosen, list(chosen.phases()), fabric,
        lambda *_: None, say, **arguments
    )  # fmt: skip
