"""Teaching a temporal model: when to stop, what is believed, and what a kriged model has to say."""

import numpy as np
import pytest
import torch

from tests.support.tracks import track
from toile.avatar.drive.driver import Driver
from toile.avatar.drive.teaching import FOLDS, code_reach, codes_unseen, stop_at, teach, teach_kriged
from toile.avatar.model.carried import COMPONENTS
from toile.avatar.model.checkpoint import load_avatar
from toile.avatar.settings import TemporalSettings


def test_models_taught_by_other_frames_and_draws_err_less_together_on_new_poses_than_one_by_one():
    torch.manual_seed(0)
    poses = torch.randn(400, 1, COMPONENTS)
    targets = poses[:, 0, :3] + torch.randn(400, 3)
    driver = Driver(TemporalSettings(window=1, channels=64, steps=200, lr=5e-3), 6, {"shirt": 3})
    _, copies = teach(driver, poses[:80], targets[:80], lambda *_: None)
    error = lambda one: float(one.errors(poses[80:], targets[80:]).mean().detach())
    together, models = error(driver), list(driver.models)
    assert (
        len(copies) == FOLDS
        and len(models) == 2 * FOLDS
        and all(copy.models[0] is models[k] for k, (_, copy) in enumerate(copies))
    )
    alone = []
    for model in models:
        driver.models = torch.nn.ModuleList([model])
        alone.append(error(driver))
    assert len(set(alone)) == len(models) and together < 0.97 * np.mean(alone)
    few = Driver(driver.settings, 6, {"shirt": 3})
    assert teach(few, poses[:39], targets[:39], lambda *_: None)[1] == [] and len(few.models) == 1


def test_a_kriged_model_s_share_leaves_the_least_error_in_frames_left_out_and_of_few_frames_none_is_taught():
    torch.manual_seed(0)
    motion, times, shares = track(range(80), features=6), 0.2 * torch.arange(80).double(), torch.linspace(0, 1, 11)
    lasting = torch.sin(times / 3)[:, None].float() * torch.ones(3)
    codes = torch.tanh(motion.features @ torch.randn(6, 3)) + lasting
    driver = Driver(TemporalSettings(window=1, channels=32, steps=100, lr=5e-3), 6, {"shirt": 3})
    driver.scale(motion.features, codes)
    poses, targets = driver.windows_of(motion, torch.arange(80)), driver.scaled(codes)
    copies = teach(driver, poses, targets, lambda *_: None)[1]
    teach_kriged(driver, copies, poses, targets, times)
    found = driver.kriged.share.clone()

    def error(share):
        for _, copy in copies:
            copy.kriged.share.copy_(share)
        return sum(copy.errors(poses[out], targets[out]).sum().item() for out, copy in copies)

    assert 0 < found <= 1 and error(found) <= min(map(error, shares)) + 1e-5
    few = Driver(driver.settings, 6, {"shirt": 3})
    teach_kriged(few, [], poses[:39], targets[:39], times[:39])
    assert few.kriged is None


def test_a_kriged_model_says_of_a_frame_left_out_what_the_others_taught_it():
    torch.manual_seed(0)
    motion, rows, times = track(range(80), features=6), torch.arange(80), 0.2 * torch.arange(80)
    codes = motion.features @ torch.randn(6, 3)
    driver = Driver(TemporalSettings(window=1, channels=8, steps=20), 6, {"shirt": 3})
    driver.scale(motion.features, codes)
    right, other = driver.scaled(codes), driver.scaled(codes)
    other[20:40] *= 1.1  # the second of four stretches
    poses, unseen = driver.windows_of(motion, rows), []
    copies = stop_at(driver, poses, right, lambda *_: None)[1]
    for targets in (right, other):
        teach_kriged(driver, copies, poses, targets, times)
        unseen.append(torch.cat([copy.kriged(poses[out]) for out, copy in copies]))
    assert torch.equal(unseen[0][20:40], unseen[1][20:40]) and not torch.equal(unseen[0][40:60], unseen[1][40:60])
    assert [len(copy.kriged.inputs) for _, copy in copies] == [60] * 4 and len(driver.kriged.inputs) == 80


def test_training_stops_where_frames_left_out_are_met_best():
    """Codes that follow the pose are learnt for as long as allowed; codes of pure noise only until the mean is known."""
    torch.manual_seed(0)
    motion = track(range(80), features=6)
    driver = Driver(TemporalSettings(window=1, channels=16, steps=400, lr=2e-3), 6, {"shirt": 3})
    noise, told, stops = torch.randn(80, 3), [], {}
    for name, codes in (("pose", motion.features @ torch.randn(6, 3)), ("noise", noise)):
        driver.scale(motion.features, codes)
        poses = driver.windows_of(motion, torch.arange(80))
        stops[name], copies = stop_at(
            driver, poses, driver.scaled(codes), lambda done, total: told.append((done, total))
        )
    assert stops["pose"] > 300 and stops["noise"] < 100
    assert told[-1] == (400, 400) and all(done <= total for done, total in told)
    assert stop_at(driver, poses[:39], noise[:39], None) == (400, [])  # too few to leave any out
    assert codes_unseen([], motion, torch.arange(39)) == {}


def test_what_poses_tell_by_chance_is_not_believed():
    """A garment that follows the pose, and one of pure noise, by one model."""
    torch.manual_seed(0)
    motion, rows = track(range(80), features=6), torch.arange(80)
    driver = Driver(TemporalSettings(window=1, channels=32, steps=300, lr=5e-3), 6, {"shirt": 3, "trousers": 3})
    codes = torch.cat([motion.features @ torch.randn(6, 3), torch.randn(80, 3)], 1)
    driver.scale(motion.features, codes)
    copies = stop_at(driver, driver.windows_of(motion, rows), driver.scaled(codes), lambda *_: None)[1]
    unseen = codes_unseen(copies, motion, rows)
    driver.believe(torch.cat(list(unseen.values()), 1), codes)
    shirt, trousers = driver.code_trust.split(3)
    assert len(shirt.unique()) == 1 and shirt[0] > 0.8 and trousers[0] < 0.4
    believed = codes_unseen(copies, motion, rows, driver.code_trust)["trousers"]
    error = lambda x: (x - codes[:, 3:]).square().sum()
    assert error(believed) < error(unseen["trousers"])
    assert torch.allclose(
        believed, codes[:, 3:].mean(0) + trousers * (unseen["trousers"] - codes[:, 3:].mean(0)), atol=1e-5
    )


def test_a_code_of_a_frame_left_out_is_by_a_model_that_was_not_taught_it():
    torch.manual_seed(0)
    motion, rows = track(range(80), features=6), torch.arange(80)
    driver = Driver(TemporalSettings(window=1, channels=16, steps=60, lr=5e-3), 6, {"shirt": 3})

    def unseen(codes):
        copies = stop_at(driver, driver.windows_of(motion, rows), driver.scaled(codes), lambda *_: None)[1]
        return codes_unseen(copies, motion, rows)["shirt"]

    codes = motion.features @ torch.randn(6, 3)
    driver.scale(motion.features, codes)
    other = codes.clone()
    other[20:40] = codes[:20]  # the second of four stretches
    assert torch.equal(unseen(codes)[20:40], unseen(other)[20:40])
    assert not torch.equal(unseen(codes)[40:60], unseen(other)[40:60])


def test_numbers_of_a_code_count_as_far_as_they_move_the_cloth(sample_avatar):
    avatar = load_avatar(sample_avatar)
    model = avatar.model("tshirt")
    torch.manual_seed(0)
    mean, spread = torch.zeros(model.code_size), torch.rand(model.code_size) + 0.1
    reach = code_reach(avatar, {"tshirt": model.code_size}, mean, spread)
    for k in (0, len(model.modes) - 1, model.code_size - 1):
        z = torch.stack([mean, mean + spread[k] * torch.eye(model.code_size)[k]])
        at, moved = avatar.unposed_by("tshirt", z).detach()
        assert reach[k].item() == pytest.approx(
            (moved - at).norm(dim=1).square().mean().sqrt().item(), rel=1e-3, abs=1e-7
        )
    driver = Driver(TemporalSettings(window=1, channels=8), 3, {"shirt": 3})
    codes = torch.randn(50, 3) * torch.tensor([1.0, 5.0, 0.2])
    driver.scale(torch.randn(50, 3), codes, lambda mean, spread: torch.tensor([3.0, 4.0, 0.0]))
    share = driver.scaled(codes).var(0, correction=0)
    assert share.sum().item() == pytest.approx(1, abs=1e-5) and (share[1] / share[0]).item() == pytest.approx(
        16 / 9, rel=1e-3
    )
    assert share[2].sqrt().item() == pytest.approx(0.02, rel=1e-2)
