"""From a window of poses to a garment's latent: what moves the cloth when there is no picture of it.

docs/method/animation.md (after Xiang et al. 2021, section on temporal modelling): E_TCN = |z - z_c|^2, z_c the VAE's mean code.
"""

from __future__ import annotations

import torch
from torch import nn


class TemporalModel(nn.Module):
    """Causal temporal convolutions over the last `window` poses.

    1x1 in -> residual blocks of kernel 3, dilations 1, 2, 4, ... until the receptive field spans the window -> latent.
    """

    def __init__(self, features, latent, window=15, channels=256):
        super().__init__()
        if window < 1:
            raise ValueError(f"TemporalModel: window is {window}, must be at least 1")
        self.window = window
        self.inlet = nn.Conv1d(features, channels, 1)
        self.blocks = nn.ModuleList(CausalBlock(channels, d) for d in dilations(window))
        self.outlet = nn.Linear(channels, latent)

    def forward(self, poses):
        """Pose features (B,L,P), the current frame last -> latents (B,Z). Only the last `window` of them are read."""
        x = self.inlet(poses[:, -self.window :].transpose(1, 2))
        for block in self.blocks:
            x = block(x)
        return self.outlet(nn.functional.leaky_relu(x[..., -1], 0.2))


class CausalBlock(nn.Module):
    """x + conv(LeakyReLU(x)): kernel 3, no look ahead; before the first pose stands the first pose."""

    def __init__(self, channels, dilation):
        super().__init__()
        self.reach = 2 * dilation
        self.conv = nn.utils.parametrizations.weight_norm(nn.Conv1d(channels, channels, 3, dilation=dilation))

    def forward(self, x):
        padded = nn.functional.pad(nn.functional.leaky_relu(x, 0.2), (self.reach, 0), mode="replicate")
        return x + self.conv(padded)


def dilations(window):
    """1, 2, 4, ...: as few as give a receptive field 1 + 2 sum(d) of at least `window`; none for a single pose."""
    chosen = []
    while 1 + 2 * sum(chosen) < window:
        chosen.append(2 ** len(chosen))
    return chosen


class DampedModel(nn.Module):
    """A second-order system in the latent space, driven by the pose: z'' = k (f(pose) - z) - c z', k and c learned.

    Semi-implicit steps in the frame's own time, with stiffness k in (0,1) and damping c in (0,2) per dimension, so that
    every step is stable (the roots of r^2 - (2-c-k) r + (1-c) lie in the unit circle for c + k/2 < 2). Its state is a
    previous state of the cloth, which a TemporalModel does without; the paper could not get such models to work.
    """

    def __init__(self, features, latent, channels=256):
        super().__init__()
        self.rest = nn.Sequential(
            nn.Linear(features, channels), nn.LeakyReLU(0.2), nn.Linear(channels, channels), nn.LeakyReLU(0.2),
            nn.Linear(channels, latent),
        )  # fmt: skip
        self.stiffness, self.damping = nn.Parameter(torch.zeros(latent)), nn.Parameter(torch.zeros(latent))

    def forward(self, poses):
        """Pose features (B,T,P) of T frames in a row -> latents (B,T,Z), started at rest in the first pose."""
        target = self.rest(poses)
        k, c = torch.sigmoid(self.stiffness), 1.5 * torch.sigmoid(self.damping)
        z, speed = target[:, 0], torch.zeros_like(target[:, 0])
        states = [z]
        for now in target[:, 1:].unbind(1):
            speed = speed + k * (now - z) - c * speed
            z = z + speed
            states.append(z)
        return torch.stack(states, 1)


def windows(poses, length, first=None, step=1):
    """Pose features (T,P) -> (T,length,P): what was known at each frame, `step` rows apart. `first` (T,): where the row of
    neighbouring frames that it belongs to begins, 0 by default; before that stands the first."""
    first = torch.zeros(len(poses), dtype=torch.long) if first is None else first
    index = torch.arange(len(poses))[:, None] + step * torch.arange(1 - length, 1)
    return poses[index.maximum(first[:, None])]
