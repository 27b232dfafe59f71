"""The commands `toile evaluate`, `toile report`, `toile inspect` and `toile doctor`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import speech
from ..console import is_avatar, numbers_of, progress_bars, table
from ..errors import UserError

RunOrAvatar = Annotated[Path, typer.Argument(help="a run or an avatar")]
OfAvatar = Annotated[str | None, typer.Option(help="of an avatar: 1-50,60; default: what its training held out")]
ItsRun = Annotated[Path | None, typer.Option(help="of an avatar: its run, if that was moved")]
Driven = Annotated[bool, typer.Option("--driven", help="an avatar by poses and face alone, as an animation is")]


def inspect(
    capture: Path,
    out: Annotated[Path, typer.Option(help="the page")] = Path("inspection.html"),
):
    """Say what is wrong with a capture, a line a problem and a page of pictures; exit code 1 where registering is wasted."""
    from ..io.files import output_file
    from .inspection import inspect as look
    from .inspection.page import write_inspection

    if not capture.is_dir():
        raise UserError(f"{capture}: no such folder")
    page, found = output_file(out), look(capture)
    for finding in found.findings:
        speech.result(f"{'stops' if finding.serious else 'look '}  {finding.text}", serious=finding.serious)
    if not found.findings:
        speech.result("nothing was found to be wrong")
    write_inspection(found, page, capture.resolve().name)
    speech.result(f"{page}", page=page)
    if not found.wasted:
        speech.next_step("register", capture, "run")
    raise typer.Exit(1 if found.wasted else 0)


def doctor():
    """Say what is installed and what the machine has, and try every kernel against a reference; exit code 1 where one is off."""
    from .. import __version__, kernels
    from .doctor.checks import check_kernels
    from .doctor.machine import PROGRAMS, machine, packages, programs

    typer.echo(f"toile {__version__} in {Path(kernels.__file__).parents[1]}")
    for name, words in machine().items():
        typer.echo(f"  {name:<10} {words}")
    for name, version in programs().items():
        typer.echo(f"  {name:<10} {version or f'not installed ({PROGRAMS[name]})'}")
    found = list(packages())
    there = {name: version for name, version, _ in found if version}
    missing = {}
    for name, version, extra in found:
        if not version:
            missing.setdefault(extra, []).append(name)
    typer.echo(f"packages: {', '.join(f'{name} {version}' for name, version in there.items())}")
    for extra, names in missing.items():
        typer.echo(
            f"  not installed: {', '.join(dict.fromkeys(names))}{f' (pip install toile[{extra}])' if extra else ''}"
        )
    sound = not missing.get("")
    for checked in check_kernels():
        sound &= checked.sound
        error = f"error {checked.error:.1e}, at most {checked.most:.0e}" if checked.error is not None else checked.said
        word = "ok   " if checked.sound else "WRONG"
        typer.echo(f"  {word} {checked.name:<18} {checked.seconds:5.2f} s  {checked.against}: {error}")
    typer.echo("all kernels agree with their references" if sound else "something is wrong, see above")
    raise typer.Exit(0 if sound else 1)


def evaluate(
    path: RunOrAvatar,
    frames: OfAvatar = None,
    run: ItsRun = None,
    driven: Driven = False,
    physics: Annotated[
        bool | None,
        typer.Option(
            "--physics/--no-physics", help="with --driven: garments hang as cloth, or none does; default as animate"
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="only the JSON on stdout")] = False,
):
    """Measure a run against its scans and the truth, or an avatar on held-out pictures, where the capture has them."""
    if physics is not None and not driven:
        raise UserError("--physics: it drives an avatar: give --driven too")
    result = measure(path, frames, run, driven, physics)
    for warning in result.get("warnings", ()):
        speech.warn(warning)
    if as_json:
        typer.echo(json.dumps(result, allow_nan=False))
        return
    for line in table(result["all"]):
        typer.echo(line)
    for frame in result["per_frame"]:
        if frame.get("reasons"):
            typer.echo(f"frame {frame['frame']}: {frame['verdict']}: {'; '.join(frame['reasons'])}")
    speech.next_step("report", path)


def report(
    path: RunOrAvatar,
    out: Annotated[Path | None, typer.Option(help="default: report.html in that folder")] = None,
    frames: OfAvatar = None,
    run: ItsRun = None,
    driven: Driven = False,
):
    """Write one self-contained HTML page about a run or an avatar."""
    if is_avatar(path):
        from ..avatar.drive.driver import FILE
        from ..avatar.measure.report import write_avatar_report

        with progress_bars() as progress:
            options = dict(frames=numbers_of(frames), run=run, progress=progress, driven=driven)
            speech.result(str(write_avatar_report(path, out, **options)))
        if (path / FILE).exists():
            speech.next_step("view", path)
        return
    from .report import write_report

    no_avatar(path, frames, run, driven)
    with progress_bars() as progress:
        written = write_report(path, out, progress=progress)
    speech.result(str(written))
    speech.next_step("view", path)


def measure(path, frames, run, driven, physics=None):
    """The evaluation of a run or of an avatar."""
    if is_avatar(path):
        from ..avatar.measure.evaluation import evaluate_avatar

        with progress_bars() as progress:
            return evaluate_avatar(path, numbers_of(frames), run, progress, driven=driven, physics=physics)
    from .evaluate import evaluate as evaluate_run

    no_avatar(path, frames, run, driven)
    return evaluate_run(path)


def no_avatar(path, frames, run, driven):
    """Refuses the options that are an avatar's."""
    given = {f"--frames {frames}": frames is not None, f"--run {run}": run is not None, "--driven": driven}
    for option, there in given.items():
        if there:
            raise UserError(f"{option}: {path} is no avatar, it has no avatar.json")
