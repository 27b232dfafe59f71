"""Where a run stands, and how it ended."""

from __future__ import annotations

import os
import shutil
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..io.inputs import digest
from ..io.layout import DOUBTFUL, STORE, WRONG
from ..io.locks import locked
from ..io.run import is_run, open_run
from ..io.run_folder import read_diagnostics
from ..io.run_writer import RunWriter
from ..io.status import Status
from ..measure.verdicts import severity
from .blocks import FrameFolders, frame_numbers_of
from .identity import LAST, Identities

COVERED = 0.05  # of a garment: where others cover more of it, that is said


@dataclass(frozen=True)
class Outcome:
    """How a run ended: frames registered; frames failed with their reasons; registered frames in which hands touch cloth
    in a way that the layers cannot represent; what the preparation warned of, and of empty masks and covered cloth; frames that wait for other shards;
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


# The store: RUN/registered.zarr. Where what all its frames share changes, the next one grows in RUN/work, and takes its
# place once it is whole ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class RunStores:
    """What the stores of a run hold of these frames that is made of what `identities` ask for."""

    run: Path
    frames: tuple[int, ...]
    identities: Identities

    @property
    def shared(self) -> str:
        """The identity of what all frames share: their numbers, the person, the templates, which of them are held out."""
        stages = self.identities.stages
        return digest(list(self.frames), stages["person"], stages["template"], stages["track"])

    @property
    def folder(self) -> Path:
        """Where the store lies that takes these frames: the run's own as long as it has none, or one of this kind."""
        same = not is_run(self.run) or RunWriter.of(self.run).identity == self.shared
        return self.run if same else self.run / "work"

    @property
    def whole(self) -> bool:
        """Are all frames behind the run, and its store and diagnostics written?"""
        return self.folder == self.run and is_run(self.run) and RunWriter.of(self.run).whole and not self.left()

    def identity(self, frame: int) -> int:
        """What a frame's rows say they were made of."""
        return int(self.identities.of(LAST, frame)[:16], 16)

    def behind(self, folder: Path) -> frozenset[int]:
        """The frames that the store in a folder has."""
        return RunWriter.of(folder).made_of(self.identity) if is_run(folder) else frozenset()

    def left(self) -> tuple[int, ...]:
        """The frames that no store has."""
        behind = self.behind(self.run) | self.behind(self.run / "work")
        return tuple(number for number in self.frames if number not in behind)

    def reopen_damaged(self, frames: Iterable[int]) -> dict[int, str]:
        """Those of the frames that cannot be read become pending; {frame: why}."""
        found: dict[int, str] = {}
        for folder in (self.run, self.run / "work"):
            damaged = open_run(folder).damaged(frames) if is_run(folder) else {}
            if damaged:
                RunWriter.of(folder).reopen(damaged)
            found |= damaged
        return found

    def install(self) -> None:
        """The store that has grown beside the run's own takes its place."""
        old = self.run / "work" / "replaced.zarr"
        if self.folder != self.run:
            os.replace(self.run / STORE, old)
            os.replace(self.run / "work" / STORE, self.run / STORE)
            shutil.rmtree(old)


def recover(run: Path) -> None:
    """Ends an `install` that was killed."""
    old, grown = run / "work" / "replaced.zarr", run / "work" / STORE
    if old.exists():
        if not is_run(run):
            os.replace(grown if grown.exists() else old, run / STORE)
        shutil.rmtree(old, ignore_errors=True)


def again(
    stored: RunStores, own: Sequence[int], results: FrameFolders, retry: bool | str | Iterable[int], limits
) -> list[int]:
    """The frames among `own` that are to be given again; see `register`. UserError: `retry` is none of these."""
    if not isinstance(retry, (bool, str)):
        asked = set(frame_numbers_of("retry", retry))
        if not asked & set(stored.frames):
            raise UserError("retry: the run has none of these frames")
        return [number for number in own if number in asked]
    if retry is False:
        return []
    kind, _, count = str(retry).partition(":")
    told = {number: read_diagnostics(stored.run, number) for number in own}
    if kind == "worst" and count.isdecimal() and int(count) > 0:
        measured = [number for number in own if "evidence" in told[number]]
        worst = sorted(measured, key=lambda number: -severity(told[number]["evidence"], limits))
        return sorted(worst[: int(count)])
    if retry not in (True, "failed", "wrong"):
        raise UserError(f"retry {retry}: expected failed, wrong, worst:N or frame numbers")
    failed = [number for number in own if results.reason(number) is not None or "reason" in told[number]]
    wrong = [number for number in own if told[number].get("verdict") == WRONG]
    return failed if retry != "wrong" else sorted({*failed, *wrong})


def outcome_of(stored: RunStores, results: FrameFolders) -> Outcome:
    """What became of each frame so far."""
    run, frames = stored.run, stored.frames
    with locked(run):
        failed, contact, empty, left = {}, [], [], frozenset(stored.left())
        covered: dict[str, list[float]] = defaultdict(list)
        judged: dict[int, dict[int, str]] = {DOUBTFUL: {}, WRONG: {}}
        for number in frames:
            diagnostics = {} if number in left else read_diagnostics(run, number)
            reason = diagnostics.get("reason") or (results.reason(number) if number in left else None)
            if reason is not None:
                failed[number] = reason
                continue
            if any(stage.get("unsupported_contact") for stage in numbers_of(diagnostics).values()):
                contact.append(number)
            evidence = diagnostics.get("evidence", {})
            if evidence.get("masks_empty"):
                empty.append(number)
            for key in evidence:
                if key.endswith(".covered"):
                    covered[key.removesuffix(".covered")].append(evidence[key])
            if diagnostics.get("verdict") in judged:
                judged[diagnostics["verdict"]][number] = "; ".join(diagnostics.get("reasons", ()))
        pending = tuple(number for number in frames if number in left and number not in failed)
        ok = tuple(number for number in frames if number not in failed and number not in left)
        warnings = (*results.status.warnings(), *_said_of_empty(empty), *said_of_covered(covered))
        return Outcome(ok, failed, tuple(contact), warnings, pending, judged[DOUBTFUL], judged[WRONG])


def _said_of_empty(frames: Sequence[int]) -> list[str]:
    """What to warn of frames in which masks that are empty where the person is were left out of the verdicts."""
    text = "masks that are empty where scan, keypoints or other masks show the person are left out of verdicts"
    return [f"{text}: frames {frame_ranges(frames)}"] if frames else []


def said_of_covered(shares: dict[str, list[float]]) -> list[str]:
    """What to warn of garments of which others cover a good part: {name: the share of each frame}."""
    middle = {name: median(found) for name, found in shares.items()}
    return [
        f"{name}: other garments cover {100 * share:.0f} % of it, where no verdict looks at it"
        for name, share in middle.items()
        if share > COVERED
    ]


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
