"""The training loop: resumes to the bit, goes back when it diverges, keeps to its minutes."""

import json
from types import SimpleNamespace

import pytest
import torch

from tests.support.loop import Samples, settings, tiny_avatar, training
from toile.avatar.model.checkpoint import read_tensors, write_tensors
from toile.avatar.train import training as train
from toile.errors import UserError


class Killed(BaseException):
    """As abrupt as a signal: nothing of the loop handles it."""


def losses(folder):
    return [json.loads(line) for line in (folder / "losses.jsonl").read_text().splitlines()]


def weights(job):
    return torch.cat([value.flatten() for value in job.objective.state_dict().values()])


def spoiled(call, change):
    """Samples of which the `call`-th that is read, counted over the whole training, is changed."""

    def spoil(i, sample):
        return change(sample) if len(data.read) == call else sample

    data = Samples(spoil)
    return data


def kill(sample):
    raise Killed


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("undisturbed")
        job = training(folder, patch)
        job.run()
        return losses(folder), weights(job)


@pytest.mark.parametrize("sample", [1, 2, 30, 60, 61, 90, 105, 120, 160])
def test_killed_training_goes_on_to_the_bit(sample, undisturbed, tmp_path, monkeypatch):
    with pytest.raises(Killed):
        training(tmp_path, monkeypatch, spoiled(sample, kill)).run()
    job = training(tmp_path, monkeypatch)
    job.run()
    assert losses(tmp_path) == undisturbed[0]
    assert torch.equal(weights(job), undisturbed[1])


def test_killed_twice_and_while_it_writes(undisturbed, tmp_path, monkeypatch):
    with pytest.raises(Killed):
        training(tmp_path, monkeypatch, spoiled(50, kill)).run()
    (tmp_path / "checkpoints" / ".00000099.safetensors.1.part").write_bytes(b"half")
    with open(tmp_path / "losses.jsonl", "a") as file:
        file.write('{"phase": "body", "st')
    with pytest.raises(Killed):
        training(tmp_path, monkeypatch, spoiled(40, kill)).run()
    job = training(tmp_path, monkeypatch)
    job.run()
    assert losses(tmp_path) == undisturbed[0]
    assert torch.equal(weights(job), undisturbed[1])
    assert not list((tmp_path / "checkpoints").glob(".*"))


def test_finished_training_trains_nothing_more(tmp_path, monkeypatch):
    job = training(tmp_path, monkeypatch)
    job.run()
    before = weights(job)
    again = training(tmp_path, monkeypatch)
    again.run()
    assert torch.equal(weights(again), before)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e6])
def test_divergence_goes_back_with_half_the_learning_rate(value, tmp_path, monkeypatch):
    said, data = [], spoiled(40, lambda sample: sample | {"y": torch.tensor(value)})
    job = training(tmp_path, monkeypatch, data, say=said.append)
    job.run()
    assert len(said) == 1 and "body, step 12" in said[0] and "body, step 8" in said[0] and "x 0.5" in said[0]
    assert job.at.returns == 1
    lines = losses(tmp_path)
    assert [line["step"] for line in lines] == [*range(20), *range(15), *range(30)]
    assert all(line["loss"] < 1e3 for line in lines) and torch.isfinite(weights(job)).all()
    assert lines[9]["rate"] == pytest.approx(settings().lr * train.rate_at(9, 20, settings()) / 2)


def test_divergence_after_a_kill_is_the_same(tmp_path, monkeypatch):
    """The window of recent losses is part of a checkpoint."""
    spoil = lambda i, sample: sample | {"y": torch.tensor(1e6)} if job.at.total == 13 and not job.at.returns else sample
    runs = []
    for name, stop in (("whole", None), ("killed", 11)):
        with pytest.MonkeyPatch.context() as patch:
            if stop is not None:
                job = training(tmp_path / name, patch, Samples(lambda i, s: kill(s) if job.at.total == stop else s))
                with pytest.raises(Killed):
                    job.run()
            job = training(tmp_path / name, patch, Samples(spoil))
            job.run()
            assert job.at.returns == 1
            runs.append(losses(tmp_path / name))
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    "wrong",
    [{"phase": "x"}, {"phase": 77}, {"phase": -1}, {"step": 10**6}, {"steps": []}, {"steps": None}, {"recent": ["x"]}],
)
def test_a_checkpoint_of_no_place_in_the_training_is_refused_by_its_file(tmp_path, monkeypatch, wrong):
    with pytest.raises(Killed):
        training(tmp_path, monkeypatch, spoiled(30, kill)).run()
    newest = max((tmp_path / "checkpoints").glob("*.safetensors"))
    tensors, facts = read_tensors(newest)
    write_tensors(newest, tensors, facts | wrong)
    with pytest.raises(UserError, match=f"{newest.name}: .*{next(iter(wrong))}"):
        training(tmp_path, monkeypatch).run()


def test_gives_up_after_the_stated_number_of_returns(tmp_path, monkeypatch):
    said = []
    data = Samples(lambda i, sample: sample | {"y": torch.tensor(float("nan"))} if job.at.total >= 10 else sample)
    job = training(tmp_path, monkeypatch, data, settings(max_returns=3), said.append)
    with pytest.raises(UserError, match="after 3 returns .* --lr"):
        job.run()
    assert len(said) == 3


def test_loss_that_is_never_finite_is_refused(tmp_path, monkeypatch):
    data = Samples(lambda i, sample: sample | {"y": torch.tensor(float("nan"))})
    with pytest.raises(UserError, match="body, step 0: the loss is not finite before anything was learnt"):
        training(tmp_path, monkeypatch, data).run()


def test_each_epoch_shows_every_sample_once(tmp_path, monkeypatch):
    job = training(tmp_path, monkeypatch)
    order = iter(train.BatchOrder(12, job.phases[0], (0, 0), 0, job.fabric))
    first, second = (sorted(i for _ in range(4) for i in next(order)) for _ in range(2))
    assert first == second == list(range(12))
    late = iter(train.BatchOrder(12, job.phases[0], (0, 0), 3, job.fabric))
    whole = iter(train.BatchOrder(12, job.phases[0], (0, 0), 0, job.fabric))
    assert [next(whole) for _ in range(9)][3:] == [next(late) for _ in range(6)]


def test_processes_share_the_samples_without_overlap(tmp_path, monkeypatch):
    phase, found = training(tmp_path, monkeypatch).phases[0], []
    for rank in range(2):
        order = iter(train.BatchOrder(12, phase, (0, 0), 0, type("Fabric", (), {"global_rank": rank, "world_size": 2})))
        found += [i for _ in range(2) for i in next(order)]
    assert sorted(found) == list(range(12))


def test_colour_has_its_own_learning_rate(tmp_path, monkeypatch):
    job = training(tmp_path, monkeypatch)
    groups = job._optimiser(job.phases[0], None).param_groups
    assert [group["base"] for group in groups] == [1e-2, 1e-3]
    assert groups[1]["params"] == [job.objective.avatar.colour]


def test_clipping_bounds_the_gradient(tmp_path, monkeypatch):
    data, norms = Samples(lambda i, sample: sample | {"y": torch.tensor(1e4)}), []
    job = training(tmp_path, monkeypatch, data)

    class Optimiser(torch.optim.AdamW):
        def step(self, closure=None):
            norms.append(torch.cat([p.grad.flatten() for p in job.objective.parameters()]).norm())
            return super().step(closure)

    monkeypatch.setattr(torch.optim, "AdamW", Optimiser)
    job.run()
    assert max(norms) <= 1 + 1e-5 and min(norms) > 0.99


@pytest.mark.parametrize("pause", [0.001, 0.02])
@pytest.mark.parametrize("slower", [1.0, 3.0])
def test_minutes_are_kept_within_a_third(pause, slower, tmp_path, monkeypatch):
    """On a clock that only samples move; `slower`: so much from half of the time on, as on a busy machine."""
    now = [100.0]
    monkeypatch.setattr(train, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def slow(i, sample):
        now[0] += pause * (slower if now[0] > 102.0 else 1)
        return sample

    chosen = settings(checkpoint_every=8)
    job = training(tmp_path, monkeypatch, Samples(slow), chosen, seconds=4.0)
    job.run()
    assert now[0] - 100 == pytest.approx(4.0, rel=0.3)
    taken = job.at.steps
    assert len(losses(tmp_path)) == sum(taken) and min(taken) > 0 and (slower > 1 or taken[2] > taken[1])


def test_a_training_that_goes_on_is_planned_to_its_minutes(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(train, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def slow(i, sample):
        now[0] += 0.02
        return sample

    with pytest.raises(Killed):
        training(tmp_path, monkeypatch, spoiled(60, kill)).run()
    begun, said = now[0], []
    job = training(tmp_path, monkeypatch, Samples(slow), say=said.append, seconds=4.0)
    job.run()
    assert now[0] - begun == pytest.approx(4.0, rel=0.3) and sum(job.at.steps) > 65
    assert said == [f"{tmp_path}: begun without --minutes, which decide from here on how many steps are left"]


def test_timing_leaves_no_trace(tmp_path, monkeypatch):
    job = training(tmp_path, monkeypatch, seconds=1.0)
    before = weights(job)
    job._time_a_step(job.phases[0])
    assert torch.equal(weights(job), before) and job.at.total == 0


def test_phases_of_layers_that_are_not_there_are_left_out(tmp_path, monkeypatch):
    data = Samples()
    data.layers = data.layers[:1]
    assert [phase.name for phase in training(tmp_path, monkeypatch, data).phases] == ["body", "joint"]


def test_baseline_takes_as_many_steps():
    layered, surface = (list(settings().phases(layered)) for layered in (True, False))
    assert sum(phase.steps for phase in layered) == sum(phase.steps for phase in surface)
    assert layered[-1].steps == surface[-1].steps


def test_unused_parameters_stay_as_they_are(tmp_path, monkeypatch):
    """AdamW leaves what has no gradient alone, so a phase needs no list of its modules."""
    avatar = tiny_avatar()
    monkeypatch.setattr("tests.support.loop.tiny_avatar", lambda: avatar)
    avatar.other = torch.nn.Linear(2, 2)
    before = avatar.other.weight.detach().clone()
    training(tmp_path, monkeypatch).run()
    assert torch.equal(avatar.other.weight, before)
