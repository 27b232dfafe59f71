"""The command `toile inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def inspect(
    capture: Path,
    out: Annotated[Path, typer.Option(help="the page")] = Path("inspection.html"),
):
    """Say what is wrong with a capture, a line a problem and a page of pictures; exit code 1 where registering is wasted."""
    from ..io.files import output_file
    from .inspection import inspect as look
    from .inspection.page import write_inspection

    page, found = output_file(out), look(capture)
    for finding in found.findings:
        typer.echo(f"{'stops' if finding.serious else 'look '}  {finding.text}")
    if not found.findings:
        typer.echo("nothing was found to be wrong")
    write_inspection(found, page, capture.resolve().name)
    typer.echo(f"{page}")
    raise typer.Exit(1 if found.wasted else 0)
