"""The commands `toile status` and `toile tune`."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .. import speech
from ..console import Changes, ConfigFile, duration, frame_numbers, progress_bars
from ..io.capture import Capture
from ..io.faults import faults
from ..io.run_folder import read_config
from .outcome import Outcome
from .standing import Standing, standing

QUIET = 120.0  # s without a line after which it is said that nothing happens


def status(
    run: Path,
    as_json: Annotated[bool, typer.Option("--json", help="only JSON on stdout")] = False,
):
    """Say how a run stands, also while processes and shards work at it: done, failed, verdicts, time left, how to go on."""
    found = standing(run)
    if as_json:
        typer.echo(json.dumps(asdict(found) | {"seconds_left": found.seconds_left, "whole": found.whole}))
    else:
        for line in words(run, found):
            typer.echo(line)
    raise typer.Exit(2 if found.failed or found.wrong else 0)


def words(run: Path | str, found: Standing, most: int = 20) -> list[str]:
    """What to tell a user: where it stands, how long it takes, what is wrong, and how to go on."""
    good = len(found.registered) - len(found.doubtful) - len(found.wrong)
    lines = [
        f"{run}: {len(found.registered)} of {len(found.frames)} frames registered "
        f"({good} good, {len(found.doubtful)} doubtful, {len(found.wrong)} wrong), {len(found.failed)} failed"
    ]
    if not found.whole:
        behind = len(found.frames) - found.waiting
        what = "the first pass" if found.waiting else "the last pass"
        done = behind if found.waiting else behind - found.passed
        left = found.seconds_left
        pace = f", {60 * found.pace:.3g} a minute" if found.pace else ""
        rest = (
            ""
            if left is None
            else f": about {duration(left)} left{' of it, then the last pass' if found.waiting else ''}"
        )
        lines.append(f"  {what}: {done} of {len(found.frames)} frames{pace}{rest}")
        if found.silence is None:
            lines.append("  no frame has ended yet: what all frames need is being made")
    if not found.whole and found.silence is not None and found.silence > QUIET:
        lines.append(f"  nothing was written for {duration(found.silence)}: is it still running?")
    told = {"failed": found.failed, "wrong": found.wrong, "doubtful": found.doubtful}
    reasons = [f"  frame {n}: {kind}: {why}" for kind, of in told.items() for n, why in of.items()]
    lines += reasons[:most] + ([f"  and {len(reasons) - most} more"] if len(reasons) > most else [])
    return lines + [f"  {line}" for line in next_steps(run, found)]


def check_frames(capture: Capture, numbers: Sequence[int], run: Path) -> None:
    """What `toile register --check` does; exit code 1 where a file is bad."""
    bad: dict[int, list[str]] = {}
    with progress_bars() as progress:
        for done, (number, found) in enumerate(faults(capture, numbers), 1):
            progress("read", done, len(numbers))
            if found:
                bad[number] = found
    for number, found in bad.items():
        for words in found:
            speech.frame_note(number, "bad", words)
    count = sum(map(len, bad.values()))
    words = f"{count} bad files in {len(bad)} of {len(numbers)} frames" if bad else f"all {len(numbers)} frames read"
    speech.result(f"{capture.root}: {words}", checked=numbers, bad=bad)
    if bad:
        raise typer.Exit(1)
    speech.next_step("register", capture.root, run)


def go_on(run: Path, outcome: Outcome) -> None:
    """Names the command that follows a registration."""
    if outcome.pending:
        return speech.next_step("status", run)
    for line in next_steps(run, standing(run)) if outcome.failed or outcome.wrong else ():
        speech.note(f"next: {line}")
    speech.next_step("report", run)


def next_steps(run: Path | str, found: Standing) -> list[str]:
    """Commands that go on with the run."""
    if "align" in read_config(run):
        return []
    again = ["toile", "register", found.capture, str(run)]
    if not found.whole:
        return [f"where it was stopped it goes on with: {shlex.join(again)}"]
    steps = {"failed": found.failed, "wrong": found.wrong}
    return [f"{kind} frames again: {shlex.join([*again, '--retry', kind])}" for kind, frames in steps.items() if frames]


def tune(
    capture: Path,
    out: Annotated[Path, typer.Argument(help="a new folder: tune.html, tune.json, and the runs of the trial")],
    quality: Annotated[
        list[str] | None, typer.Option(help="one to try, repeatable; default draft and standard")
    ] = None,
    frames: Annotated[str | None, typer.Option(help="of the job: inclusive ranges 1-50,60; default all")] = None,
    step: Annotated[int, typer.Option(help="every n-th of those frames", min=1)] = 1,
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
    from ..config import QUALITIES, from_options, preset
    from ..io.capture import open_capture
    from ..io.files import write_text
    from .tuning import tune as run_trial
    from .tuning.page import errors, jobs, write_page

    opened = open_capture(capture)
    numbers = frame_numbers(frames, opened.frames, step)
    settings = {name: from_options(preset, name, config, changes) for name in quality or QUALITIES}
    counts = tuple(workers or (os.cpu_count() or 1,))
    with progress_bars() as progress:
        tuned = run_trial(opened, out, numbers, tuple(settings), counts, settings.__getitem__, heldout, progress)
    for name, said in tuned.said.items():
        for text in said or ["the template fits"]:
            speech.result(f"{name}: {text}", quality=name)
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
