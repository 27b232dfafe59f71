"""Every quality on few frames of a capture: what it shows, and what all frames would take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...config import QUALITIES, Config, preset
from ...errors import UserError
from ...io.capture import Capture
from ...io.layout import FAILED
from ...io.run import Run, open_run
from ...measure.evaluate import evaluate
from ..blocks import Progress
from .fit import LoopFit, diagnosis, loop_fits
from .forecast import Forecast, in_one_process, on_workers
from .heldout import agreement, witnesses
from .trial import Trial, sampled, tried


@dataclass(frozen=True)
class Tried:
    """One quality: its trial, what the whole job would take, `errors` as `evaluate` measures them, the agreement with
    held-out cameras, and each garment's loops as the frames show them."""

    trial: Trial
    run: Run
    forecasts: tuple[Forecast, ...]
    errors: dict[str, Any]
    heldout: dict[str, float]
    loops: dict[str, list[LoopFit]]


@dataclass(frozen=True)
class Tuned:
    """`qualities` from coarse to fine; the cameras held out; what does not fit of each garment's template, in words;
    frames that failed, and what its preparation warned of."""

    capture: Capture
    frames: tuple[int, ...]
    cameras: tuple[str, ...]
    qualities: dict[str, Tried]
    said: dict[str, list[str]]
    warnings: tuple[str, ...]


def tune(
    capture: Capture,
    out: Path,
    numbers: Sequence[int],
    qualities: Sequence[str] = QUALITIES,
    workers: Sequence[int] = (),
    config: Callable[[str], Config] = preset,
    heldout: bool = True,
    progress: Progress = lambda stage, done, total: None,
) -> Tuned:
    """Registers few of the frames `numbers` at each quality into OUT/QUALITY, a new folder, and with `heldout` once more
    without some cameras into OUT/QUALITY-heldout. `config(quality)` gives the settings; `workers`: numbers of processes of
    one core each for which the job is forecast too. UserError: the folder holds something, the capture cannot be
    registered, or no frame of it could be."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UserError(f"{out}: it is there already: a trial wants a new folder")
    frames = sampled(numbers)
    cameras = witnesses(capture, frames[0]) if heldout else ()
    found = {}
    for quality in qualities:
        settings, title, steps = config(quality), f"try {quality}", 2 if cameras else 1
        progress(title, 0, steps)
        trial = tried(capture, out / quality, settings, frames)
        run = open_run(out / quality)
        if not run.ok:
            raise UserError(f"{run.path}: no frame could be registered: {run.diagnostics.at(frames[0]).get('reason')}")
        told = (in_one_process(trial, numbers), *(on_workers(trial, numbers, count) for count in workers))
        progress(title, 1, steps)
        loops = {name: loop_fits(run, name) for name in run.garments}
        seen = _unshown(capture, out / f"{quality}-heldout", settings, frames, cameras) if cameras else {}
        progress(title, steps, steps)
        found[quality] = Tried(trial, run, told, evaluate(run)["all"], seen, loops)
    finest = found[qualities[-1]]
    said = {name: diagnosis(loops) for name, loops in finest.loops.items()}
    warnings = (*failures(finest.run), *finest.run.status.warnings())
    return Tuned(capture, frames, cameras, found, said, warnings)


def failures(run):
    """A line a frame that the trial could not register, and that is in none of its figures."""
    for row in np.flatnonzero(run.done == FAILED):
        number = int(run.frames[row])
        yield f"frame {number} failed: {run.diagnostics.at(number).get('reason')}"


def _unshown(capture, run, settings, frames, cameras):
    """The agreement with these cameras of every third of the frames, registered without them."""
    tried(capture.without(cameras), run, settings, frames[1::3] or frames[:1])
    return agreement(open_run(run), capture, cameras)
