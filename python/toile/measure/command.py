"""The commands `toile inspect` and `toile doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import speech


def inspect(
    capture: Path,
    out: Annotated[Path, typer.Option(help="the page")] = Path("inspection.html"),
):
    """Say what is wrong with a capture, a line a problem and a page of pictures; exit code 1 where registering is wasted."""
    from ..errors import UserError
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
