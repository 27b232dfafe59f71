"""The command `toile status`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer


def status(
    run: Path,
    as_json: Annotated[bool, typer.Option("--json", help="only JSON on stdout")] = False,
):
    """Say how a run stands, also while processes and shards work at it: done, failed, verdicts, time left, how to go on."""
    from .standing import standing, words

    found = standing(run)
    if as_json:
        typer.echo(json.dumps(asdict(found) | {"seconds_left": found.seconds_left, "whole": found.whole}))
    else:
        for line in words(run, found):
            typer.echo(line)
    raise typer.Exit(2 if found.failed or found.wrong else 0)
