"""Which quality keeps to a time a frame, `--budget` of the command line: tried on few frames of the capture itself, on this
machine as it is."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..config import QUALITIES, Config, preset
from ..errors import UserError
from ..io.capture import Capture
from ..io.run import open_run
from ..measure.evaluate import evaluate
from .blocks import Progress
from .tuning.fit import loop_fits
from .tuning.forecast import seconds_a_frame
from .tuning.trial import sampled, tried

PLACES = 2  # of the sequence, that are tried


def choose(
    capture: Capture,
    numbers: Sequence[int],
    seconds: float,
    config: Callable[[str], Config] = preset,
    progress: Progress = lambda stage, done, total: None,
) -> tuple[str, float, dict[str, float]]:
    """The finest quality that is expected to keep to `seconds` a frame, what all need not counted, that time, and the errors
    {name_mm: mean} that the trial left. `config(quality)` gives the settings.

    UserError: even draft would take longer, or the capture cannot be registered."""
    frames = sampled(numbers, PLACES)
    with tempfile.TemporaryDirectory(prefix="toile-budget-") as folder:
        for quality in reversed(QUALITIES):
            progress(f"try {quality}", 0, 1)
            trial = tried(capture, Path(folder) / quality, config(quality), frames)
            progress(f"try {quality}", 1, 1)
            expected = seconds_a_frame(trial, numbers)
            if expected <= seconds:
                return quality, expected, _errors(Path(folder) / quality)
    raise UserError(f"--budget {seconds:g}: draft would take about {expected:.2f} s a frame on this machine")


def _errors(path):
    """What tells qualities apart without truth: the body to the scan, and openings to those that were seen."""
    run = open_run(path)
    found = {"body to scan_mm": evaluate(run)["all"]["evidence"]["surface_to_scan_mm"]["mean"]}
    off = [fit.off_mm for name in run.garments for fit in loop_fits(run, name) if fit.off_mm is not None]
    found["openings_mm"] = float(np.mean(off)) if off else None
    return {name: value for name, value in found.items() if value is not None}
