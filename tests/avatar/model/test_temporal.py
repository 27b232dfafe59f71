"""The temporal models: causal, long enough, stable."""

import pytest
import torch

from toile.avatar.model.temporal import DampedModel, TemporalModel, dilations, windows

LENGTHS = (1, 3, 8, 15, 30)


@pytest.mark.parametrize("length", LENGTHS)
def test_a_future_pose_never_changes_a_past_latent(length):
    torch.manual_seed(0)
    model, poses = TemporalModel(6, 4, length, channels=16), torch.randn(40, 6)
    changed = poses.clone()
    changed[20:] += 1
    before, after = (model(windows(p, length))[:20] for p in (poses, changed))
    assert torch.equal(before, after)
    assert not torch.equal(model(windows(poses, length))[20], model(windows(changed, length))[20])


@pytest.mark.parametrize("length", LENGTHS)
def test_the_receptive_field_spans_the_window_and_nothing_before_it(length):
    torch.manual_seed(0)
    model = TemporalModel(6, 4, length, channels=16)
    poses = torch.randn(1, 40, 6, requires_grad=True)
    model(poses).square().sum().backward()
    seen = torch.nonzero(poses.grad[0].abs().sum(1)).flatten()
    assert seen.tolist() == list(range(40 - length, 40))
    assert 1 + 2 * sum(dilations(length)) >= length


def test_the_first_frame_is_read_as_if_it_had_always_been():
    torch.manual_seed(0)
    model, poses = TemporalModel(6, 4, 15, channels=16), torch.randn(3, 6)
    assert torch.allclose(model(windows(poses, 15))[0], model(poses[:1].expand(15, 6)[None])[0], atol=1e-6)
    assert torch.allclose(model(poses[None, :1]), model(poses[:1].expand(15, 6)[None]), atol=1e-6)


def test_windows_end_at_their_own_frame():
    table = windows(torch.arange(5.0)[:, None], 3)[..., 0]
    assert table.tolist() == [[0, 0, 0], [0, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4]]


@pytest.mark.parametrize("raw", (-20.0, 0.0, 20.0))
def test_a_damped_latent_comes_to_rest_at_the_poses_own(raw):
    torch.manual_seed(0)
    model = DampedModel(6, 4, channels=16)
    with torch.no_grad():
        model.stiffness.fill_(min(raw, 0.0))
        model.damping.fill_(raw)
    poses = torch.cat([torch.randn(1, 1, 6), torch.randn(1, 1, 6).expand(1, 3000, 6)], 1)
    states = model(poses)
    assert states.isfinite().all() and states.abs().max() < 10 * model.rest(poses).abs().max()
    if raw == 0.0:
        assert torch.allclose(states[0, -1], model.rest(poses)[0, -1], atol=1e-5)


def test_a_later_pose_never_changes_an_earlier_damped_latent():
    torch.manual_seed(0)
    model, poses = DampedModel(6, 4, channels=16), torch.randn(1, 20, 6)
    changed = poses.clone()
    changed[:, 10:] += 1
    assert torch.equal(model(poses)[:, :10], model(changed)[:, :10])


def test_a_delayed_pose_is_learned_by_a_window_and_not_by_a_single_pose():
    torch.manual_seed(0)
    poses = torch.randn(400, 3)
    wanted = torch.cat([poses[:4] * 0, poses[:-4]])

    def error(length):
        torch.manual_seed(1)
        model = TemporalModel(3, 3, length, channels=32)
        optimiser = torch.optim.AdamW(model.parameters(), 3e-3)
        for _ in range(150):
            loss = (model(windows(poses, length)) - wanted)[10:].square().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        return float(loss.detach())

    assert error(8) < 0.1 * error(1)
