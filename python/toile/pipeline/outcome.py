"""Where a run stands, and how it ended."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..io.layout import DOUBTFUL, WRONG
from ..io.run import is_run
from ..io.run_folder import read_diagnostics
from ..io.run_writer import RunWriter
from ..io.status import Status
from .blocks import FrameFolders, locked


@dataclass(frozen=True)
class Outcome:
    """How a run ended: frames registered; frames failed with their reasons; registered frames in which hands touch cloth
    in a way that the layers cannot represent; what the garments' preparation warned of; frames that wait for other shards;
    those of the registered frames that are judged doubtful and wrong, with their reasons; what was made again and why.
    """

    ok: tuple[int, ...]
    failed: dict[int, str]
    unsupported_contact: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    pending: tuple[int, ...] = ()
    doubtful: dict[int, str] = field(default_factory=dict)
    wrong: dict[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def is_whole(run: Path) -> bool:
    """Are all frames behind the run, and its store and diagnostics written?"""
    return is_run(run) and RunWriter.of(run).whole


def frames_left(run: Path, frames: Sequence[int]) -> Sequence[int]:
    """Those of the frames that the store does not have."""
    return RunWriter.of(run).pending(frames) if is_run(run) else frames


def failed_frames(run: Path, frames: Sequence[int], results: FrameFolders) -> tuple[int, ...]:
    """Those of the frames that failed."""
    return tuple(n for n in frames if results.reason(n) is not None or "reason" in read_diagnostics(run, n))


def wrong_frames(run: Path, frames: Sequence[int]) -> tuple[int, ...]:
    """Those of the frames that were registered and judged wrong."""
    return tuple(n for n in frames if read_diagnostics(run, n).get("verdict") == WRONG)


def reopen(run: Path, frames: Sequence[int], results: FrameFolders) -> None:
    """These frames become pending."""
    with locked(run):
        if is_whole(run):
            shutil.rmtree(run / "work", ignore_errors=True)
        for made in ("slid", "smoothed"):
            shutil.rmtree(run / "work" / made, ignore_errors=True)  # with other neighbours, other results
        results.reopen(frames)
        if is_run(run):
            RunWriter.of(run).reopen(frames)


def outcome_of(run: Path, frames: Sequence[int], results: FrameFolders) -> Outcome:
    """What became of each frame so far."""
    with locked(run):
        failed, contact, pending = {}, [], set(frames_left(run, frames))
        judged: dict[int, dict[int, str]] = {DOUBTFUL: {}, WRONG: {}}
        for number in frames:
            diagnostics = {} if number in pending else read_diagnostics(run, number)
            reason = results.reason(number) or diagnostics.get("reason")
            if reason is not None:
                failed[number] = reason
                continue
            if any(stage.get("unsupported_contact") for stage in numbers_of(diagnostics).values()):
                contact.append(number)
            if diagnostics.get("verdict") in judged:
                judged[diagnostics["verdict"]][number] = "; ".join(diagnostics.get("reasons", ()))
        ok = tuple(number for number in frames if number not in failed and number not in pending)
        waiting = tuple(number for number in frames if number in pending and number not in failed)
        told = tuple(contact), tuple(results.status.warnings())
        return Outcome(ok, failed, *told, waiting, judged[DOUBTFUL], judged[WRONG])


def numbers_of(diagnostics: dict) -> dict[str, dict]:
    """What the stages measured {stage: {name: number}}, without what is said in words."""
    return {stage: values for stage, values in diagnostics.items() if isinstance(values, dict)}


def diagnostics_of(run: Path, frames: Sequence[int], status: Status) -> dict[int, dict]:
    """{frame: {stage: {name: number}}}: what every stage measured of itself, and its seconds."""
    table = {}
    for number in frames:
        stages = numbers_of(read_diagnostics(run, number))
        table[number] = {stage.replace(" ", "."): values for stage, values in stages.items()}
    for line in status.lines():
        if line.get("ok") and line.get("frame") in table:
            table[line["frame"]].setdefault("seconds", {})[line["stage"]] = line["seconds"]
    return table
