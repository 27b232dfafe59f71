"""What registering all frames would take, from a trial on few."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..blocks import blocks
from .trial import FIRST_STAGES, Trial, alone


@dataclass(frozen=True)
class Forecast:
    """Of `frames` frames on `workers` processes: `seconds` from start to end; `disk` [bytes] of the run, `passing`
    more in RUN/work; `memory` [bytes] of all processes together."""

    quality: str
    frames: int
    workers: int
    seconds: float
    disk: int
    passing: int
    memory: int


def seconds_a_frame(trial: Trial, numbers: Sequence[int]) -> float:
    """On this machine, with its cores as threads of one process; what is prepared for all is not counted."""
    first, last = _passes(trial, numbers, "wall")
    return (first + last) / len(numbers)


def in_one_process(trial: Trial, numbers: Sequence[int]) -> Forecast:
    """On this machine, with its cores as threads of one process."""
    return _forecast(trial, numbers, 1, trial.prepare.wall + len(numbers) * seconds_a_frame(trial, numbers))


def on_workers(trial: Trial, numbers: Sequence[int], workers: int) -> Forecast:
    """On workers of one core each, here or elsewhere: each takes whole blocks, what all need is made once before."""
    first, last = _passes(trial, numbers, "cpu")
    alike = _once(trial, "cpu")  # each of them builds it
    parts = [len(block) for block in blocks(numbers)]
    most = max(sum(sorted(parts, reverse=True)[i::workers]) for i in range(min(workers, len(parts))))
    shared = (first + last - alike) * most / len(numbers)
    return _forecast(trial, numbers, workers, trial.prepare.cpu + alike + shared)


def _passes(trial, numbers, clock):
    """The seconds of the first pass and of the last ones, by the `clock` of a Cost."""
    first = getattr(trial.first, clock) * _frames_worth(trial, numbers) / _frames_worth(trial, trial.frames)
    return first, _once(trial, clock) + len(numbers) * getattr(trial.each, clock)


def _once(trial, clock):
    """What the last passes take however many frames there are."""
    return max(getattr(trial.last, clock) - len(trial.frames) * getattr(trial.each, clock), 0.0)


def _forecast(trial, numbers, workers, seconds):
    count = len(numbers)
    disk = trial.fixed + math.ceil(trial.kept * count)
    return Forecast(trial.quality, count, workers, seconds, disk, math.ceil(trial.work * count), trial.peak * workers)


def _frames_worth(trial, numbers):
    """The time [s] that the stages of the first pass report for such frames: one that begins without another's state is
    searched for, and takes longer."""
    begun = alone(trial.frames)
    spent = {n: sum(of.get(stage, 0.0) for stage in FIRST_STAGES) for n, of in trial.stages.items() if of}
    begin = [seconds for n, seconds in spent.items() if n in begun]
    follow = [seconds for n, seconds in spent.items() if n not in begun] or begin
    count = len(alone(numbers))
    mean = lambda values: sum(values) / max(len(values), 1)
    return count * mean(begin) + (len(numbers) - count) * mean(follow)
