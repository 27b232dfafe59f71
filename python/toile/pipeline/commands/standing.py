"""The commands `toile status`, `toile plan` and `toile template`, and what is said of how a run goes on."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ... import speech
from ...console import duration
from ...io.capture import Capture
from ...io.run_folder import read_config
from ..outcome import Outcome
from ..standing import Standing, standing

ALONE = "one process makes them, with its workers; shards that find it at work wait"
QUIET = 120.0  # s without a line after which it is said that nothing happens


def plan(capture: Path):
    """Print the stages that a capture asks for, each with the line that asks, and those left out with why."""
    from ...io.capture import open_capture
    from ..blocks import blocks
    from ..plan import plan as make_plan

    opened = open_capture(capture)
    for warning in opened.warnings:
        speech.warn(warning)
    warn_of_unread(opened)
    cameras = len(opened.cameras)
    speech.result(
        f"{opened.scene.name}: {len(opened.frames)} frames, {cameras} cameras", frames=opened.frames, cameras=cameras
    )
    for step in make_plan(opened):
        words = f"  {'run ' if step.runs else 'skip'}  {step.stage:<12} {step.why}"
        speech.result(words, stage=step.stage, runs=step.runs, why=step.why)
    count = len(blocks(opened.frames))
    words = f"  {count} temporal block{'s' * (count > 1)}: more workers or shards than that have nothing to track"
    speech.result(words, blocks=count)
    speech.next_step("register", capture, "run")


def warn_of_unread(capture: Capture) -> None:
    """A line a sort of what lies about a capture's frames and is not read; only names are looked at."""
    from ...measure.inspection.files import unpadded, unread

    for finding in unpadded(capture.root) + unread(capture):
        speech.warn(finding.text)


def status(
    run: Path,
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON on stdout")] = False,
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
        what = "the first pass" if found.waiting else "the last passes"
        done = behind if found.waiting else behind - found.passed
        left = found.seconds_left
        pace = f", {60 * found.pace:.3g} a minute" if found.pace else ""
        rest = (
            ""
            if left is None
            else f": about {duration(left)} left{' of it, then the last passes' if found.waiting else ''}"
        )
        lines.append(f"  {what}: {done} of {len(found.frames)} frames{pace}{rest}")
        if not found.waiting:
            lines.append(f"  {ALONE}{f'; so far: {found.last_pass}' if found.last_pass else ''}")
        if found.silence is None:
            lines.append("  no frame has ended yet: what all frames need is being made")
    if found.earlier:
        lines.append(f"  of what was asked before {len(found.earlier)} frames can be read until these take their place")
    if not found.whole and found.silence is not None and found.silence > QUIET:
        lines.append(f"  nothing was written for {duration(found.silence)}: is it still running?")
    told = {"failed": found.failed, "wrong": found.wrong, "doubtful": found.doubtful}
    reasons = [f"  frame {n}: {kind}: {why}" for kind, of in told.items() for n, why in of.items()]
    lines += reasons[:most] + ([f"  and {len(reasons) - most} more"] if len(reasons) > most else [])
    return lines + [f"  {line}" for line in next_steps(run, found)]


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


def template(
    run: Path,
    out: Annotated[Path, typer.Argument(help="the template, an .obj in the body model's rest pose")],
    name: Annotated[str, typer.Option(help="the garment's name")],
    label: Annotated[str, typer.Option(help="its label in the run's scene")],
):
    """Make a garment template from a run's tracked surface and labels."""
    from ...io.run import open_run
    from ..template import write_template

    speech.result(write_template(run, out, name, label))
    if words := open_run(run).judgement:
        speech.warn(words)
