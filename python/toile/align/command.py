"""The command `toile align`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import speech
from ..console import Changes, ConfigFile, Holdout, Scheduler, Workers


def align(
    run: Annotated[Path, typer.Argument(help="a registered run with garments and pictures")],
    out: Annotated[Path, typer.Argument(help="the aligned run; an alignment that was stopped there goes on")],
    workers: Workers = 1,
    scheduler: Scheduler = None,
    holdout: Holdout = None,
    shard: Annotated[
        str, typer.Option(help="i/n: every n-th block from the i-th on; give all n, in any order or at once")
    ] = "1/1",
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Slide garments along their surfaces until their prints lie still on them: a run with true interior correspondence."""
    from ..config import from_options
    from ..console import progress_bars, shard_of
    from ..io.run import open_run
    from .run import align as run_alignment
    from .settings import AlignSettings

    part, settings = shard_of(shard), from_options(lambda _: AlignSettings(), None, config, changes, "align")
    with progress_bars() as progress:
        outcome = run_alignment(run, out, settings, workers, part, progress, scheduler, holdout)
    waiting = f", {len(outcome.pending)} wait for other shards" if outcome.pending else ""
    between = f", {len(outcome.between)} between them" if outcome.between else ""
    words = f"{out}: {len(outcome.matched)} frames aligned{between}, {len(outcome.failed)} failed{waiting}"
    speech.result(
        words, aligned=outcome.matched, between=outcome.between, pending=outcome.pending, failed=outcome.failed
    )
    registered = open_run(run)
    for warning in (*filter(None, (registered.judgement, registered.outdated)), *outcome.warnings):
        speech.warn(warning)
    speech.frame_notes({"failed": outcome.failed})
    speech.next_step("status" if outcome.pending else "report", out)
    raise typer.Exit(2 if outcome.failed else 0)
