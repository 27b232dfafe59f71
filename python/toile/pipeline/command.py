"""The command `toile status`."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ..console import duration
from ..io.run_folder import config_file, read_config
from ..scene import frame_ranges
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


def next_steps(run: Path | str, found: Standing) -> list[str]:
    """Commands that go on with the run."""
    if "align" in read_config(run):
        return []
    again = ["toile", "register", found.capture, str(run), "--config", str(config_file(run))]
    again += ["--frames", frame_ranges(found.frames, between=",")]
    if not found.whole:
        return [f"where it was stopped it goes on with: {shlex.join(again)}"]
    steps = {"failed": found.failed, "wrong": found.wrong}
    return [f"{kind} frames again: {shlex.join([*again, '--retry', kind])}" for kind, frames in steps.items() if frames]
