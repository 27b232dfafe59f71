"""`--budget`: the finest quality that fits, and what it promises."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from toile.config import QUALITIES, preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.run_writer import RunWriter
from toile.pipeline import budget
from toile.pipeline.tuning.trial import Cost, Trial, alone

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SECONDS = {"draft": 0.5, "standard": 1.0}  # a frame, half of them in the first pass


@pytest.fixture
def tries(monkeypatch):
    """Trials that take SECONDS a frame; the list of the qualities that were tried."""
    asked = []

    def tried(capture, run, config, frames):
        asked.append(config.quality)
        each = 0.5 * SECONDS[config.quality]
        stages = {n: {"track": each, "inner": each} for n in frames}
        cost = Cost(each * len(frames), each * len(frames))
        once = Cost(cost.wall + 1.0, cost.cpu + 1.0)  # a second for what all frames of the last passes need
        return Trial(
            config.quality, run, frames, Cost(100.0, 100.0), cost, once, Cost(each, each), 0, 0.0, 0.0, 0, stages
        )

    monkeypatch.setattr(budget, "tried", tried)
    monkeypatch.setattr(budget, "_errors", lambda path: {"openings_mm": float(len(path.name))})
    return asked


@pytest.mark.parametrize(
    "seconds, chosen", [(100, "standard"), (1.001, "standard"), (0.999, "draft"), (0.501, "draft")]
)
def test_budget_chooses_the_finest_quality_that_fits(tries, seconds, chosen):
    quality, expected, errors = budget.choose(open_capture(SAMPLE), range(2000), seconds)
    assert (
        quality == chosen
        and expected == pytest.approx(SECONDS[chosen] + 1 / 2000)
        and errors == {"openings_mm": len(chosen)}
    )
    assert tries == [*reversed(QUALITIES)][: 1 + (chosen == "draft")]


def test_budget_tries_the_settings_that_the_job_has(tries):
    asked = []
    settings = lambda quality: asked.append(quality) or SimpleNamespace(quality=quality)
    budget.choose(open_capture(SAMPLE), range(2000), 2, settings)
    assert asked == ["standard"]


def test_budget_that_nothing_fits_is_refused_with_the_time_that_draft_takes(tries):
    with pytest.raises(UserError, match=r"--budget 0.1: draft would take about 0.50 s a frame on this machine"):
        budget.choose(open_capture(SAMPLE), range(2000), 0.1)


def test_a_trial_sees_two_places_of_a_long_job(tries, monkeypatch):
    seen = []
    monkeypatch.setattr(budget, "sampled", lambda numbers, places: seen.append(places) or (0, 1, 2))
    budget.choose(open_capture(SAMPLE), range(2000), 2)
    assert seen == [2] and alone((0, 1, 2)) == {0}


@pytest.mark.slow(seconds=120)
def test_budget_is_kept_by_a_real_run(tmp_path, threads):
    """Within 30 %: others on the machine take what they take between the trial and the run."""
    threads(2)
    capture = open_capture(SAMPLE)
    quality, expected, errors = budget.choose(capture, capture.frames, 60)
    trial = budget.tried(capture, tmp_path / "run", preset(quality), capture.frames)
    assert quality == "standard" and errors["openings_mm"] < 8
    taken = (trial.first.wall + trial.last.wall) / len(capture.frames)
    assert expected == pytest.approx(taken, rel=0.3)
    assert RunWriter.of(tmp_path / "run").whole
