"""The command `toile tune`."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ... import speech
from ...console import Changes, ConfigFile, Step, frame_numbers, progress_bars


def tune(
    capture: Path,
    out: Annotated[Path, typer.Argument(help="a new folder: tune.html, tune.json, and the runs of the trial")],
    quality: Annotated[
        list[str] | None, typer.Option(help="one to try, repeatable; default draft and standard")
    ] = None,
    frames: Annotated[str | None, typer.Option(help="of the job: inclusive ranges 1-50,60; default all")] = None,
    step: Step = 1,
    workers: Annotated[
        list[int] | None, typer.Option(help="also forecast so many processes of one core each; repeatable", min=1)
    ] = None,
    heldout: Annotated[
        bool, typer.Option(help="try each quality again without some cameras, and compare with what those show")
    ] = True,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Before a long job: try every quality on few frames, and say what it shows and what all frames would take."""
    from ...config import QUALITIES, from_options, preset
    from ...io.capture import open_capture
    from ...io.files import write_text
    from ..tuning import tune as run_trial
    from ..tuning.page import errors, jobs, write_page

    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames, step)
    settings = {name: from_options(preset, name, config, changes) for name in quality or QUALITIES}
    counts = tuple(workers or (os.cpu_count() or 1,))
    with progress_bars() as progress:
        tuned = run_trial(opened, out, numbers, tuple(settings), counts, settings.__getitem__, heldout, progress)
    for name, said in tuned.said.items():
        for text in said or ["the template fits"]:
            speech.result(f"{name}: {text}", quality=name)
    for text in tuned.warnings:
        speech.warn(text)
    for row in jobs(tuned):
        speech.result("  ".join(f"{cell:<{width}}" for cell, width in zip(row, (10, 24, 8, 9, 32, 9))).rstrip())
    for words, *values in errors(tuned):
        speech.result(f"  {words:<44} " + "  ".join(f"{'-' if v is None else f'{v:.3g}':>8}" for v in values))
    told = {
        name: {"jobs": [asdict(job) for job in one.forecasts], "errors": one.errors, "heldout": one.heldout}
        for name, one in tuned.qualities.items()
    }
    write_text(
        out / "tune.json", json.dumps({"frames": tuned.frames, "template": tuned.said, "qualities": told}, indent=1)
    )
    speech.result(f"{write_page(tuned, out / 'tune.html')}", qualities=told)
    speech.next_step("register", capture, "run", "--quality", tuple(tuned.qualities)[-1])
