"""Codes from poses by Gaussian processes: their equations, and errors that last."""

import numpy as np
import pytest
import torch

from toile.avatar.model.kriging import BEGIN, KrigedModel, between, covariance, inputs_of, likeliest

TIMES = 0.2 * torch.arange(120, dtype=torch.float64)


def lasting(seed, span, size=3):
    """(T,size) of variance 1 whose correlation falls by e in `span` seconds."""
    K = torch.exp(-(TIMES[:, None] - TIMES).abs() / span) + 1e-9 * torch.eye(len(TIMES))
    return (
        torch.linalg.cholesky(K) @ torch.randn(len(TIMES), size, generator=torch.Generator().manual_seed(seed)).double()
    )


def windows(seed):
    """(T,2,3): poses that change smoothly, each beside the one before."""
    poses = lasting(seed, 0.5).float()
    return torch.stack([poses[(torch.arange(len(poses)) - 1).clamp(min=0)], poses], 1)


def test_an_untaught_model_answers_nought():
    assert not KrigedModel(3, 5, 7)(torch.randn(4, 2, 3)).any()


def test_a_taught_model_says_what_the_formulas_of_kriging_say():
    poses, new = windows(0), windows(1)
    targets = torch.cat([poses[:, 1], lasting(2, 1.0, 1).float()], 1)
    targets = targets - targets.mean(0)
    model = KrigedModel(3, 4, len(poses))
    model.teach(poses, targets, TIMES)
    x, y = inputs_of(poses).double(), targets.double()
    axes = np.linalg.svd(y.numpy(), full_matrices=False)[2]
    values = y.numpy() @ axes.T
    spread = torch.as_tensor(values).square().mean(0).sqrt()
    chosen = likeliest(between(x, TIMES), torch.as_tensor(values) / spread, spread**2).numpy()
    expected = np.zeros((len(new), 4))
    far = lambda a, b: np.square(a[:, None] - b[None]).sum(2)
    for a, (near, slope, lasts, noise, span, reach, change) in enumerate(chosen):

        def told(one, other):
            p, q = one[:, :3], other[:, :3]
            apart = far(p, q) / reach**2 + far(one[:, 3:], other[:, 3:]) / change**2
            return near * np.exp(-apart / 2) + slope * p @ q.T

        after = np.abs(TIMES.numpy()[:, None] - TIMES.numpy())
        K = told(x.numpy(), x.numpy()) + lasts * np.exp(-after / span) + (noise + 1e-5) * np.eye(len(x))
        at = inputs_of(new).double().numpy()
        expected += np.outer(told(at, x.numpy()) @ np.linalg.solve(K, values[:, a]), axes[a])
    assert np.abs(model(new).numpy() - expected).max() < 1e-3 * np.abs(expected).max()


def test_a_smooth_function_of_pose_and_change_is_learnt():
    truth = lambda w: torch.stack([torch.sin(w[:, 1, 0]), w[:, 1, 1] * w[:, 1, 0] / 2, (w[:, 1] - w[:, 0])[:, 2]], 1)
    poses, new = windows(0), windows(1)
    mean = truth(poses).mean(0)
    model = KrigedModel(3, 3, len(poses))
    model.teach(poses, truth(poses) - mean, TIMES)
    error = (model(new) + mean - truth(new)).square().sum()
    assert error < 0.05 * (truth(new) - mean).square().sum()


@pytest.mark.parametrize("span", [0.5, 4.0])
def test_how_long_errors_last_is_found(span):
    found = likeliest(between(inputs_of(windows(0)).double(), TIMES), lasting(3, span, 8), torch.ones(8))
    assert span / 2 < found[:, list(BEGIN).index("span")].median() < span * 2


def test_errors_that_last_are_told_from_what_poses_say():
    """Frames of a row err alike: who takes each for a witness by itself lays more of the errors upon the poses."""
    poses, new, error = windows(0), windows(1), {}
    for seed in range(4):
        slope = torch.randn(3, 5, generator=torch.Generator().manual_seed(seed))
        targets = poses[:, 1] @ slope + 2 * lasting(10 + seed, 2.0, 5).float()
        for name, times in (("as it is", TIMES), ("apart", 1e6 * TIMES)):
            model = KrigedModel(3, 5, len(poses))
            model.teach(poses, targets - targets.mean(0), times)
            off = model(new) - (new[:, 1] - poses[:, 1].mean(0)) @ slope
            error[name] = error.get(name, 0) + off.square().sum().item()
    assert error["as it is"] < 0.7 * error["apart"]


def test_what_stands_still_and_a_single_frame_teach_the_mean():
    for frames in (1, 5):
        model = KrigedModel(3, 4, frames)
        model.teach(torch.ones(frames, 2, 3), torch.zeros(frames, 4), TIMES[:frames])
        assert torch.equal(model(windows(1)), torch.zeros(len(TIMES), 4))


def test_a_covariance_is_positive_for_equal_frames():
    frames = between(torch.zeros(9, 6).double(), torch.zeros(9).double())
    assert torch.linalg.eigvalsh(covariance(frames, torch.tensor([list(BEGIN.values())]).double())).min() > 0
