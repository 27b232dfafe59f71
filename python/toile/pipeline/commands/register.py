"""The command `toile register`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ... import speech
from ...console import (
    Changes,
    ConfigFile,
    Frames,
    Holdout,
    Scheduler,
    Step,
    Workers,
    frame_numbers,
    numbers_of,
    positive,
    progress_bars,
    shard_of,
    shown,
)
from ...errors import UserError
from ...frame_numbers import frame_ranges
from ...io.capture import Capture
from ...io.faults import faults
from .standing import go_on, warn_of_unread


def register(
    capture: Path,
    run: Path,
    quality: Annotated[str | None, typer.Option(help="draft, or standard (the default)")] = None,
    budget: Annotated[float | None, typer.Option(help="seconds a frame: the finest quality that keeps to them")] = None,
    frames: Frames = None,
    step: Step = 1,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: Annotated[
        str, typer.Option(help="i/n: every n-th block from the i-th on; give all n, in any order or at once")
    ] = "1/1",
    retry: Annotated[
        str | None,
        typer.Option(
            help="frames to give again: failed, wrong (those judged wrong too), worst:20, or numbers, 1-50,60"
        ),
    ] = None,
    frame_limit: Annotated[
        float | None, typer.Option(help="seconds after which a frame fails; a stage that hangs is ended")
    ] = None,
    keep: Annotated[
        bool, typer.Option(help="keep RUN/work, so that a changed setting redoes only what depends on it")
    ] = True,
    verify: Annotated[
        bool, typer.Option("--verify", help="compare the contents of every input that a run has read")
    ] = False,
    check: Annotated[
        bool, typer.Option("--check", help="only read every file of those frames, name the bad ones, and make nothing")
    ] = False,
    moved: Annotated[
        bool, typer.Option("--moved", help="only note that the capture of this run, or aligned run, lies there now")
    ] = False,
    template_from_scan: Annotated[
        list[str] | None, typer.Option(help="a garment whose template is cut from the capture itself, by its label")
    ] = None,
    holdout: Holdout = None,
    config: ConfigFile = None,
    changes: Changes = None,
):
    """Register a capture: the body and each garment, every frame, in fixed topologies.

    Of a run that is there, what is not given stays as it was asked: settings and frames. What depends on a setting or a
    file that has changed is made again, and nothing else.
    """
    from ...config import changed, from_options, preset
    from ...io.capture import open_capture
    from ...io.holdout import apart, span_of
    from ..manifest import config_of, note_moved
    from ..run import register as run_pipeline
    from ..scanning import lacks_scan

    again, limit = retried(retry), positive("--frame-limit", frame_limit)
    part, budget = shard_of(shard), positive("--budget", budget)
    if moved and check:
        raise UserError("--moved: --check is given too")
    opened = open_capture(capture)
    if moved:
        note_moved(run, opened)
        return speech.result(f"{run}: its capture is {capture}")
    numbers = frame_numbers(frames, opened.frames, step)
    warn_of_unread(replace(opened, frames=tuple(numbers)))
    if check:
        return check_frames(opened, numbers, run)
    own = {"template_from_scan": list(template_from_scan)} if template_from_scan else {}
    own |= {} if holdout is None else {"holdout": span_of(holdout)}
    named = quality or budget or config or any(word.startswith("quality") for word in changes or ())
    before = config_of(run)
    afresh = preset if before is None else lambda name: changed(preset(name), {"holdout": before.holdout})
    base = afresh if named or before is None else lambda _: before
    settings_of = lambda name: changed(from_options(base, name, config, changes), own)
    if budget is not None:
        if quality is not None:
            raise UserError(f"--budget {budget:g}: --quality {quality} is given too")
        seen = apart(numbers, settings_of(quality).holdout)
        quality = quality_within(budget, opened, run, seen, settings_of)
    settings, new = settings_of(quality), not run.exists()
    bare = sum(lacks_scan(opened, number) for number in numbers) if settings.make_scans and new else 0
    if bare:
        made = "made of their pictures (--set make_scans=false goes without)"
        speech.note(f"{bare} of {len(numbers)} frames bring no scan: it is {made}")
    with progress_bars() as progress:
        asked = None if frames is None and step == 1 else numbers
        options = dict(verify=verify, scheduler=scheduler, frame_limit=limit, keep=keep)
        outcome = run_pipeline(capture, run, settings, asked, progress, workers, part, again, **options)
    waiting = f", {len(outcome.pending)} wait for other shards" if outcome.pending else ""
    judged = f" ({len(outcome.doubtful)} doubtful, {len(outcome.wrong)} wrong)" if outcome.ok else ""
    words = f"{run}: {len(outcome.ok)} frames registered{judged}, {len(outcome.failed)} failed{waiting}"
    of_verdict = {"failed": outcome.failed, "wrong": outcome.wrong, "doubtful": outcome.doubtful}
    speech.result(words, registered=outcome.ok, pending=outcome.pending, **of_verdict)
    for note in outcome.notes:
        speech.note(f"  {note}")
    for warning in outcome.warnings:
        speech.warn(warning)
    if outcome.unsupported_contact:
        speech.warn(f"unsupported contact, hands touch the cloth: frames {frame_ranges(outcome.unsupported_contact)}")
    speech.frame_notes(of_verdict)
    go_on(run, outcome)
    raise typer.Exit(2 if outcome.failed or outcome.wrong else 0)


def retried(text):
    """What --retry asks for, as `register` takes it."""
    if text is None:
        return False
    if text in ("failed", "wrong") or re.fullmatch("worst:[1-9][0-9]{0,5}", text):
        return text
    try:
        return numbers_of(text)
    except UserError:
        said = "expected failed, wrong, worst:N or frame numbers such as 1-50,60"
        raise UserError(f"--retry {shown(text)}: {said}") from None


def quality_within(budget, capture, run, numbers, settings):
    """The quality that --budget chooses, said with the time and the errors to expect; that of a run which goes on."""
    from ...io.run_folder import config_file, read_config
    from ..budget import choose

    if config_file(run).exists():
        return read_config(run).get("settings", {}).get("quality")
    with progress_bars() as progress:
        quality, seconds, errors = choose(capture, numbers, budget, settings, progress)
    expect = ", ".join(f"{name.removesuffix('_mm')} {value:.1f} mm" for name, value in errors.items())
    speech.result(f"--budget {budget}: quality {quality}, about {seconds:.2f} s a frame; on frames tried: {expect}")
    return quality


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
