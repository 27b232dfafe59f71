"""From poses to a garment's latent by Gaussian processes: what moves the cloth when frames that teach are few and follow one another.

docs/method/animation.md: kriging with errors that last (Rasmussen and Williams 2006, sections 2.2 and 5.4).
"""

from __future__ import annotations

import torch
from torch import nn

AXES = 128  # principal axes of the codes at most, each foretold by a process of its own
CHUNK = 256  # poses at a time
STEPS = 100  # of Adam, after which the likelihood rises no more
RATE = 0.1
LEARNT = 128  # frames at most that processes are chosen on
LEAST_NOISE = 1e-5  # of a number's variance
# What a process begins with: of the variance what poses tell, and in a straight line, errors' share and noise; how long errors last [s]; reaches of
# a pose and of its change
BEGIN = {"poses": 0.5, "slope": 0.1, "lasting": 0.3, "noise": 0.05, "span": 1.0, "reach": 4.0, "change": 10.0}


class KrigedModel(nn.Module):
    """The first and the last pose of a window, p and q = p - first, to numbers y of the code along principal axes:

    y_a = sum_i w_ai k_a(x, x_i),   k_a(x, x') = s_a exp(-|p - p'|^2 / (2 r_a^2) - |q - q'|^2 / (2 c_a^2)) + b_a p p'

    over the frames i that taught.
    """

    def __init__(self, features, latent, frames):
        """Of windows (B,L,`features`) to latents (B,`latent`), taught by so many `frames`; untaught it answers 0."""
        super().__init__()
        axes = min(AXES, latent)
        self.register_buffer("inputs", torch.zeros(frames, 2 * features))
        self.register_buffer("reaches", torch.ones(axes, 2))  # of poses and of their changes
        self.register_buffer("weights", torch.zeros(axes, frames))  # s_a w_ai
        self.register_buffer("slopes", torch.zeros(axes, features))  # b_a sum_i w_ai p_i
        self.register_buffer("axes", torch.zeros(axes, latent))
        self.register_buffer("share", torch.ones(()))  # of what it says together with other models

    def forward(self, poses):
        """Pose features (B,L,P), the current frame last -> latents (B,Z)."""
        return torch.cat([self._told(part) for part in inputs_of(poses).split(CHUNK)])

    def _told(self, x):
        apart = squares(x, self.inputs)
        near = torch.stack([similar(apart, reach) @ weights for reach, weights in zip(self.reaches, self.weights)], 1)
        return (near + x.chunk(2, 1)[0] @ self.slopes.T) @ self.axes

    @torch.no_grad()
    def teach(self, poses, targets, times):
        """Of windows (F,L,P), latents (F,Z) about their mean 0 and `times` (F,) [s]. An axis's process is the likeliest of the sum of

        k_a, of errors that last (Ornstein and Uhlenbeck: e_a exp(-|t - t'| / tau_a)) and of noise:

        neighbouring frames err alike, and say less than as many apart. What lasts is told from what poses say, and is not foretold.
        """
        x, targets, times = inputs_of(poses).double(), targets.double(), torch.as_tensor(times, dtype=torch.float64)
        axes = torch.linalg.svd(targets, full_matrices=False).Vh[: len(self.axes)]
        values = targets @ axes.T
        spread = values.square().mean(0).sqrt().clamp(min=1e-12)
        some = torch.linspace(0, len(x) - 1, min(len(x), LEARNT)).round().long()
        chosen = likeliest(between(x[some], times[some]), (values / spread)[some], spread.square())
        poses, all_frames = x.chunk(2, 1)[0], between(x, times)
        for a, one in enumerate(chosen):
            weights = torch.linalg.solve(covariance(all_frames, one[None])[0], values[:, a])
            self.weights[a], self.slopes[a] = one[0] * weights, one[1] * weights @ poses
        self.inputs.copy_(x)
        self.reaches[: len(axes)] = chosen[:, 5:].float()
        self.axes[: len(axes)] = axes


def inputs_of(poses):
    """(B,2P): the last pose of each window (B,L,P), and how it differs from the first."""
    return torch.cat([poses[:, -1], poses[:, -1] - poses[:, 0]], 1)


def squares(a, b):
    """(2,A,B) squared distances of rows (A,2P) and (B,2P): of poses, and of their changes."""
    return torch.stack([torch.cdist(x, y).square() for x, y in zip(a.chunk(2, 1), b.chunk(2, 1))])


def similar(apart, reaches):
    """exp(-d_p^2 / (2 r^2) - d_q^2 / (2 c^2)) of `squares` (2,A,B) and reaches (...,2)."""
    return torch.exp(-0.5 * torch.tensordot(reaches**-2, apart, 1))


def between(x, times):
    """What a covariance is made of, of inputs (F,2P) and `times` (F,): `squares` (2,F,F), products p p' and spans |t - t'| (F,F)."""
    poses = x.chunk(2, 1)[0]
    return squares(x, x), poses @ poses.T, (times[:, None] - times).abs()


def covariance(frames, chosen):
    """(A,F,F) of processes (A,7) in the order of BEGIN, of what is `between` frames."""
    apart, products, after = frames
    near, slope, lasting, noise, span = (x[:, None, None] for x in chosen[:, :5].unbind(1))
    told = near * similar(apart, chosen[:, 5:]) + slope * products
    own = torch.eye(len(after), dtype=after.dtype)
    return told + lasting * torch.exp(-after / span) + (noise + LEAST_NOISE) * own


@torch.enable_grad()
def likeliest(frames, values, weight):
    """(A,7) in the order of BEGIN: processes of the greatest likelihood of `values` (F,A) of variance 1, each number of a process
    log-normal of spread 1 about one that all have in common. In that an axis counts by its `weight` (A,). `frames`: what is `between` them."""
    like = {"dtype": values.dtype}
    common = torch.tensor(list(BEGIN.values()), **like).log().requires_grad_()
    own = torch.zeros(values.shape[1], len(BEGIN), **like, requires_grad=True)
    optimiser, weight = torch.optim.Adam([common, own], RATE), weight / weight.sum()
    for _ in range(STEPS):
        L = torch.linalg.cholesky(covariance(frames, (common + own).exp()))
        white = torch.linalg.solve_triangular(L, values.T[:, :, None], upper=False)
        unlikely = 0.5 * white.square().sum((1, 2)) + L.diagonal(dim1=1, dim2=2).log().sum(1)
        loss = (weight * (unlikely + 0.5 * own.square().sum(1))).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return (common + own).exp().detach()
