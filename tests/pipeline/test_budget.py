"""`--budget`: the finest quality that fits, and what it promises."""

from pathlib import Path

import numpy as np
import pytest

from toile import kernels
from toile.config import QUALITIES, preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.measure.evaluate import evaluate
from toile.pipeline import budget
from toile.pipeline import run as pipeline

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def capture():
    return open_capture(SAMPLE)


def test_budget_chooses_the_finest_quality_that_fits(capture, monkeypatch):
    table = budget.front()
    monkeypatch.setattr(budget, "calibration", lambda: table["reference"]["calibration"])
    own = {q: sum(table[q]["seconds"].values()) for q in QUALITIES}
    assert own["draft"] < 0.8 * own["standard"]
    assert all(table["draft"]["errors"][e] != table["standard"]["errors"][e] for e in table["draft"]["errors"])
    for quality in QUALITIES:
        fits = [q for q in QUALITIES if own[q] <= 1.001 * own[quality]]
        chosen, seconds, errors = budget.choose(capture, capture.frames, 1.001 * own[quality])
        assert chosen == fits[-1] and np.isclose(seconds, own[chosen]) and errors == table[chosen]["errors"]
    assert budget.choose(capture, capture.frames, 100)[0] == "standard"


def test_budget_counts_the_machine_and_the_capture(capture, monkeypatch):
    table = budget.front()
    draft = sum(table["draft"]["seconds"].values())
    monkeypatch.setattr(budget, "calibration", lambda: 3 * table["reference"]["calibration"])
    assert np.isclose(budget.choose(capture, capture.frames, 4 * draft)[1], 3 * draft)
    twice = {k: 2 * table["reference"][k] for k in ("pixels", "faces")}
    assert 1 < budget.expected(table["draft"], table["reference"], twice, 1.0) / draft < 2


def test_budget_that_nothing_fits_is_refused_with_the_time_that_draft_takes(capture):
    with pytest.raises(UserError, match=r"--budget 0.001: draft would take about \d"):
        budget.choose(capture, capture.frames, 0.001)


@pytest.mark.slow
def test_budget_is_kept_by_a_real_run(capture, tmp_path):
    """Within 30 %; two threads, as the front was measured."""
    kernels.set_threads(2)
    table = budget.front()
    before = budget.calibration()
    seconds = 1.3 * sum(table["draft"]["seconds"].values()) * before / table["reference"]["calibration"]
    quality, _, _ = budget.choose(capture, capture.frames, seconds)
    pipeline.register(SAMPLE, tmp_path / "run", preset(quality), capture.frames)
    slowed = max(1, budget.calibration() / before)  # by others on the machine, meanwhile
    assert sum(evaluate(tmp_path / "run")["all"]["seconds"].values()) < 1.3 * seconds * slowed
