"""How a run stands, read from its folder alone while any processes work at it, on this machine or others: no lock is taken."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from ..errors import UserError
from ..io.layout import DOUBTFUL, FAILED, OK, WRONG
from ..io.run import is_run, open_run
from ..io.run_folder import config_file, read_config, read_diagnostics
from ..io.status import Status
from .blocks import FrameFolders

WINDOW = 600.0  # s before the last frame over which its pace is measured
QUIET = 120.0  # s without a line after which it is said that nothing happens


@dataclass(frozen=True)
class Standing:
    """`frames` asked for; those `registered`, of which `doubtful` and `wrong` {frame: reasons}; `failed` {frame: reason};
    `passed`: through the first pass and not in the store yet; `waiting`: not begun, or in hand. `pace` of the pass that is
    under way [frames/s], None where two frames have not ended yet; `silence` since the last line [s]."""

    capture: str
    frames: tuple[int, ...]
    registered: tuple[int, ...]
    doubtful: dict[int, str]
    wrong: dict[int, str]
    failed: dict[int, str]
    passed: int
    waiting: int
    pace: float | None
    silence: float | None

    @property
    def whole(self) -> bool:
        return self.passed + self.waiting == 0

    @property
    def seconds_left(self) -> float | None:
        """Of the pass that is under way."""
        left = self.waiting or self.passed
        return 0.0 if left == 0 else left / self.pace if self.pace else None


def standing(run: Path | str, now: float | None = None) -> Standing:
    """How a run of `toile register` or `toile align` stands at the time `now` [s since 1970]."""
    run = Path(run)
    if not config_file(run).exists():
        raise UserError(f"{config_file(run)}: missing: the folder holds no run")
    config, status = read_config(run), Status.of(run)
    aligned = "align" in config
    frames = config.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, int) for frame in frames):
        raise UserError(f"{config_file(run)}: frames: expected numbers")
    stored = states(run)
    results = FrameFolders(run / ("slides" if aligned else "work/frames"), status, "frame")
    failed: dict[int, str] = {}
    passed = waiting = 0
    for frame in frames:
        if stored.get(frame) == OK:
            continue
        reason = results.reason(frame) or read_diagnostics(run, frame).get("reason")
        if stored.get(frame) == FAILED or reason is not None:
            failed[frame] = reason or "it failed"
        elif results.whole(frame):
            passed += 1
        else:
            waiting += 1
    registered = tuple(frame for frame in frames if stored.get(frame) == OK)
    first = "align" if aligned else "track"
    pace, last = pace_of(status, first if waiting else "verdict")
    silence = None if last is None else max((time.time() if now is None else now) - last, 0.0)
    judged = {level: judged_as(run, registered, level) for level in (DOUBTFUL, WRONG)}
    told = judged[DOUBTFUL], judged[WRONG], failed, passed, waiting, pace, silence
    return Standing(str(config.get("capture")), tuple(frames), registered, *told)


def states(run: Path) -> dict[int, int]:
    """{frame: its `done`} of the store, {} where it is not there yet."""
    if not is_run(run):
        return {}
    opened = open_run(run)
    return dict(zip(opened.frames.tolist(), opened.done.tolist()))


def judged_as(run: Path, frames: Sequence[int], level: int) -> dict[int, str]:
    """{frame: reasons} of those of this verdict."""
    verdict = open_run(run).verdict if frames else None
    if verdict is None:
        return {}
    rows = dict(zip(open_run(run).frames.tolist(), verdict.tolist()))
    found = [frame for frame in frames if rows.get(frame) == level]
    return {frame: "; ".join(read_diagnostics(run, frame).get("reasons", ())) for frame in found}


def pace_of(status: Status, stage: str) -> tuple[float | None, float | None]:
    """Frames a second that left a stage over the last WINDOW, by all processes; and the time of the last line [s]."""
    times, last = [], None
    for line in status.lines():
        at = line.get("time")
        if isinstance(at, (int, float)):
            last = at if last is None else max(last, at)
            if line.get("stage") == stage and line.get("ok"):
                times.append(at)
    recent = [at for at in times if at > max(times) - WINDOW]
    span = max(recent) - min(recent) if recent else 0.0
    return ((len(recent) - 1) / span if span > 0 else None), last


def words(run: Path | str, found: Standing, most: int = 20) -> list[str]:
    """What to tell a user: where it stands, how long it takes, what is wrong, and how to go on."""
    good = len(found.registered) - len(found.doubtful) - len(found.wrong)
    lines = [
        f"{run}: {len(found.registered)} of {len(found.frames)} frames registered "
        f"({good} good, {len(found.doubtful)} doubtful, {len(found.wrong)} wrong), {len(found.failed)} failed"
    ]
    if not found.whole:
        behind = len(found.frames) - found.waiting
        what = "the first pass" if found.waiting else "the last pass"
        done = behind if found.waiting else behind - found.passed
        left = found.seconds_left
        pace = f", {60 * found.pace:.3g} a minute" if found.pace else ""
        rest = (
            ""
            if left is None
            else f": about {duration(left)} left{' of it, then the last pass' if found.waiting else ''}"
        )
        lines.append(f"  {what}: {done} of {len(found.frames)} frames{pace}{rest}")
        if found.silence is None:
            lines.append("  no frame has ended yet: what all frames need is being made")
    if not found.whole and found.silence is not None and found.silence > QUIET:
        lines.append(f"  nothing was written for {duration(found.silence)}: is it still running?")
    told = {"failed": found.failed, "wrong": found.wrong, "doubtful": found.doubtful}
    reasons = [f"  frame {n}: {kind}: {why}" for kind, of in told.items() for n, why in of.items()]
    lines += reasons[:most] + ([f"  and {len(reasons) - most} more"] if len(reasons) > most else [])
    return lines + [f"  {line}" for line in next_steps(run, found)]


def next_steps(run: Path | str, found: Standing) -> list[str]:
    """Commands that go on with the run."""
    if "align" in read_config(run):
        return []
    again = ["toile", "register", found.capture, str(run), "--config", str(config_file(run))]
    again += ["--frames", ranges_of(found.frames)]
    if not found.whole:
        return [f"where it was stopped it goes on with: {shlex.join(again)}"]
    steps = {"failed": found.failed, "wrong": found.wrong}
    return [f"{kind} frames again: {shlex.join([*again, '--retry', kind])}" for kind, frames in steps.items() if frames]


def ranges_of(frames: Iterable[int]) -> str:
    """[0, 1, 2, 7] -> "0-2,7"."""
    runs = [[n for _, n in part] for _, part in groupby(enumerate(sorted(frames)), lambda pair: pair[1] - pair[0])]
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


def duration(seconds: float) -> str:
    """ "40 s", "12 min", "3.5 h"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
