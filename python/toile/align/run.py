"""`toile align RUN RUN2`: a run whose garments have slid along their surfaces until their prints lie as in the anchors.

prepare   the reference print of each garment            match   every pictured frame, in blocks of 50 frame numbers
write     the new run, once all blocks are done           report  the textures before and after

Blocks share nothing but the reference, so that shards and workers may take any of them; results lie in RUN2/slides, so that
a killed alignment goes on with the same bits.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from ..errors import UserError
from ..io.files import copy_file
from ..io.holdout import agreed, apart, held, words_of
from ..io.layout import PENDING
from ..io.locks import locked
from ..io.registration import registration
from ..io.run import is_run, open_run
from ..io.run_folder import capture_folder
from ..io.status import Status
from ..pipeline.blocks import BlockJob, FrameFolders, Progress, check_shares, run_job
from ..pipeline.manifest import check_own, claim, place_of
from ..pipeline.workers import everywhere
from ..prints.reference import NEAR
from .matching import match
from .outcome import Alignment, outcome_of
from .preparation import prepare
from .report import write_report
from .settings import AlignSettings
from .writing import write


def align(
    run: Path | str,
    out: Path | str,
    settings: AlignSettings | None = None,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    progress: Progress | None = None,
    scheduler: str | None = None,
    holdout: str | None = None,
) -> Alignment:
    """Aligns the garments of a registered run into the run `out`; returns an Alignment. UserError: it cannot be done.

    The same call on what was killed goes on where it stood. `shard` (i, n) takes every n-th block from the i-th on;
    whichever ends last writes the run. The bits depend on neither workers nor shards. `progress(stage, done, total)`. `scheduler`: of
    running dask workers, which do the work. `holdout`, "A-B": the frames that others take nothing of, which are those of the run."""
    out, settings, progress = (
        everywhere(Path(out), scheduler),
        settings or AlignSettings(),
        progress or (lambda *_: None),
    )
    check_shares(workers, shard, scheduler)
    run = open_run(everywhere(Path(run), scheduler))
    _check(run, out)
    span = agreed(holdout, run.holdout, run.path)
    if span != run.holdout:
        raise UserError(f"--holdout {words_of(span)}: {run.path} was registered without, register it with the same")
    if not apart(run.pictured, span):
        raise UserError(f"--holdout {words_of(span)}: no pictured frame is left to align by")
    _begin(run, out, settings)
    results = FrameFolders(out / "slides", Status.of(out), "align")
    job = BlockJob(out, results, prepare, (run, out, settings, span), match, NEAR, "match", held(span))
    last = partial(write, run, out, results, progress, span)
    run_job(job, run.pictured, partial(is_run, out), last, workers, shard, progress=progress, scheduler=scheduler)
    with locked(out):
        if is_run(out) and not (out / "alignment.json").exists():
            matched = [number for number in run.pictured if results.whole(number)]
            write_report(run, open_run(out), matched or run.pictured, progress)
    return outcome_of(run, out, results, span)


def _check(run, out):
    if out.resolve() == run.path.resolve():
        raise UserError(f"{out}: the aligned run needs a folder of its own")
    check_own(out)
    if not run.garments:
        raise UserError(f"{run.path}: the scene names no garment, there is nothing to align")
    if (run.done == PENDING).any():
        raise UserError(f"{run.path}: frames are pending, end its registration first")
    if not run.pictured:
        raise UserError(f"{run.path}: no registered frame has pictures, prints cannot be aligned")


def _begin(run, out, settings):
    """Makes OUT with its config.toml and the run's status lines, or checks that it is of the same run and settings."""
    from .. import __version__

    origin = {
        "run": str(run.path.resolve()),
        "frames_ok": len(run.ok),
        "registration": registration(run, run.ok, run.garments.values()),
        "toile": __version__,
        "settings": settings.model_dump(mode="json"),
    }
    place = place_of(out, capture_folder(run.path, check=False))
    other = "this run was aligned from another run, from another registration of it, or with other settings"
    claim(out, run.config | place | {"align": origin}, other)
    with locked(out):
        if run.status.path.exists() and not Status.of(out).path.exists():
            copy_file(run.status.path, Status.of(out).path)
