"""The search for the baseline's learning rate, and how fine its texture must be."""

from dataclasses import dataclass, field
from pathlib import Path

import pytest

from toile.avatar.model.checkpoint import read_facts
from toile.avatar.settings import AvatarSettings
from toile.avatar.train import baseline
from toile.avatar.train.baseline import equal_settings, search, texel_factor
from toile.errors import UserError
from toile.io.run import open_run
from toile.surface.layers import read_layers, surface_layer
from toile.surface.uv import UvMap


@dataclass
class Job:
    """A training that notes what it was asked for."""

    frames: list
    held: list = field(default_factory=list)
    known: list | None = None
    asked: list = field(default_factory=list)

    def train(self, folder, settings, title, layered, cache):
        self.asked.append((settings.lr, self.frames, self.held))


def searched(monkeypatch, best, factors=(0.5, 1.0, 2.0), frames=range(16)):
    """(job, learning rates tried) where `best` would be the best of all."""
    error = lambda job, folder, settings, *_: abs(settings.lr - best)
    monkeypatch.setattr(baseline, "unseen_error", error)
    job = Job(list(frames))
    return job, search(job, Path("/nowhere"), AvatarSettings(lr=1.0 / 64, baseline_lr=factors))


@pytest.mark.parametrize(
    "best, tried",
    [(1, [0.5, 1, 2]), (2, [0.5, 1, 2, 4]), (100, [0.5, 1, 2, 4, 8, 16]), (0.01, [0.0625, 0.125, 0.25, 0.5, 1, 2])],
)
def test_the_search_goes_on_beyond_an_end_that_is_best_but_not_for_ever(monkeypatch, best, tried):
    _, scores = searched(monkeypatch, best / 64)
    assert sorted(64 * rate for rate in scores) == tried


def test_trials_are_judged_on_training_frames_that_they_have_not_seen(monkeypatch):
    job, _ = searched(monkeypatch, 1 / 64)
    assert all(kept == list(range(14)) and unseen == [14, 15] for _, kept, unseen in job.asked) and len(job.asked) == 3


def test_the_cloth_has_as_many_texels_on_the_body_s_chart_as_on_its_own(sample_run):
    run = open_run(sample_run)
    garment, surface = read_layers(run)[1], surface_layer(run)
    finer = texel_factor(run, [garment], run.ok, 64)
    cloth = (run.labels.at(0) == garment.label)[surface.faces].all(1)
    texels = {}
    for k in (1, 2, 4):
        shown = UvMap(surface, 64 * k)
        texels[k] = cloth[shown.face[shown.inside]].sum()
    assert texels[finer] > 0.9 * UvMap(garment, 64).inside.sum() > texels[finer // 2]
    assert texel_factor(run, [], run.ok, 64) == 1


def test_where_as_many_texels_would_need_more_parameters_the_texture_is_the_finest_that_does_not(
    sample_avatar, sample_run, monkeypatch
):
    run, facts, said = open_run(sample_run), read_facts(sample_avatar), []
    own = facts["settings"].data.texture_size
    monkeypatch.setattr(baseline, "texel_factor", lambda *_: 64)
    found = equal_settings(run, sample_avatar, facts, said.append)
    assert own <= found.data.texture_size < 64 * own
    assert said[0].startswith(f"baseline: a texture of {found.data.texture_size} texels a side: {64 * own}")
    monkeypatch.setattr(baseline, "texel_factor", lambda *_: found.data.texture_size // own)
    assert equal_settings(run, sample_avatar, facts, said.append) == found and len(said) == 1
    monkeypatch.setattr(baseline, "matched_settings", lambda *_: None)
    with pytest.raises(UserError, match="no baseline has as many parameters"):
        equal_settings(run, sample_avatar, facts)
