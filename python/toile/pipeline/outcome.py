"""Where a run stands, and how it ended."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..io.run import is_run
from ..io.run_folder import read_diagnostics
from ..io.run_writer import RunWriter
from ..io.status import Status
from .blocks import FrameFolders, locked


@dataclass(frozen=True)
class Outcome:
    """How a run ended: frames registered; frames failed with their reasons; registered frames in which hands touch cloth
    in a way that the layers cannot represent; what the garments' preparation warned of; frames that wait for other shards.
    """

    ok: tuple[int, ...]
    failed: dict[int, str]
    unsupported_contact: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    pending: tuple[int, ...] = ()


def is_whole(run: Path) -> bool:
    """Are all frames behind the run, and its store and diagnostics written?"""
    return is_run(run) and RunWriter.of(run).whole


def frames_left(run: Path, frames: Sequence[int]) -> Sequence[int]:
    """Those of the frames that the store does not have."""
    return RunWriter.of(run).pending(frames) if is_run(run) else frames


def failed_frames(run: Path, frames: Sequence[int], results: FrameFolders) -> tuple[int, ...]:
    """Those of the frames that failed."""
    return tuple(n for n in frames if results.reason(n) is not None or "reason" in read_diagnostics(run, n))


def reopen_failed(run: Path, results: FrameFolders) -> None:
    """Failed frames become pending."""
    with locked(run):
        if is_whole(run):
            shutil.rmtree(run / "work", ignore_errors=True)
        results.reopen_failed()
        if is_run(run):
            RunWriter.of(run).reopen()


def outcome_of(run: Path, frames: Sequence[int], results: FrameFolders) -> Outcome:
    """What became of each frame so far."""
    with locked(run):
        failed, contact, pending = {}, [], frames_left(run, frames)
        for number in frames:
            diagnostics = {} if number in pending else read_diagnostics(run, number)
            reason = results.reason(number) or diagnostics.get("reason")
            if reason is not None:
                failed[number] = reason
            elif any(stage.get("unsupported_contact") for stage in diagnostics.values()):
                contact.append(number)
        pending = tuple(number for number in pending if number not in failed)
        ok = tuple(number for number in frames if number not in failed and number not in pending)
        return Outcome(ok, failed, tuple(contact), tuple(results.status.warnings()), pending)


def diagnostics_of(run: Path, frames: Sequence[int], status: Status) -> dict[int, dict]:
    """{frame: {stage: {name: number}}}: what every stage measured of itself, and its seconds."""
    table = {}
    for number in frames:
        stages = read_diagnostics(run, number)
        table[number] = {} if "reason" in stages else {stage.replace(" ", "."): v for stage, v in stages.items()}
    for line in status.lines():
        if line.get("ok") and line.get("frame") in table:
            table[line["frame"]].setdefault("seconds", {})[line["stage"]] = line["seconds"]
    return table
