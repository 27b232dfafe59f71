"""How a run stands, read from its folder alone while any processes work at it, on this machine or others: no lock is taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import UserError
from ..io.layout import DOUBTFUL, FAILED, OK, PENDING, WRONG
from ..io.run import is_run, open_run
from ..io.run_folder import config_file, read_config, read_diagnostics
from ..io.status import Status
from .blocks import FrameFolders
from .manifest import asked_last
from .outcome import RunStores

LAST_PASSES = {  # by what their lines are called
    "prints": "prints slide",
    "flicker": "flicker is measured",
    "motion": "smoothing",
    "fuse": "the body under the garments, from all frames",
    "inner": "inner layer and store",
    "verdict": "inner layer and store",
}
WINDOW = 600.0  # s before the last frame over which its pace is measured


@dataclass(frozen=True)
class Standing:
    """`frames` asked for; those `registered`, of which `doubtful` and `wrong` {frame: reasons}; `failed` {frame: reason};
    `passed`: through the first pass and not in the store yet; `waiting`: not begun, or in hand. `pace` of the pass that is
    under way [frames/s], None where two frames have not ended yet; `silence` since the last line [s]; `last_pass`: which of the
    last passes has made something, where the first one is behind; `earlier`: frames that can be read as they were registered before
    something else was asked for, until those take their place."""

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
    last_pass: str | None = None
    earlier: tuple[int, ...] = ()

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
        missing = "the file is missing: the folder holds no run of `toile register` or `toile align`"
        raise UserError(f"{config_file(run)}: {missing}" if run.is_dir() else f"{run}: no such folder")
    config, status = read_config(run), Status.of(run)
    aligned = "align" in config
    frames = config.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, int) for frame in frames):
        raise UserError(f"{config_file(run)}: frames: expected numbers")
    asked = None if aligned else asked_last(run)
    stored, earlier = _stored(run, asked and RunStores(run, tuple(frames), asked[0]).identity)
    identity = asked and partial(asked[0].of, asked[1])
    results = FrameFolders(run / ("slides" if aligned else "work/frames"), status, "frame", identity)
    failed: dict[int, str] = {}
    passed = waiting = 0
    for frame in frames:
        done, _ = stored.get(frame, (PENDING, None))
        if done == OK:
            continue
        kept = read_diagnostics(run, frame) if done == FAILED or asked is None else {}
        reason = results.reason(frame) or kept.get("reason")
        if done == FAILED or reason is not None:
            failed[frame] = reason or "it failed"
        elif results.whole(frame):
            passed += 1
        else:
            waiting += 1
    registered = tuple(frame for frame in frames if frame in stored and stored[frame][0] == OK)
    lines = list(status.lines())
    first = "align" if aligned else "track"
    pace, last = pace_of(lines, first if waiting else "verdict")
    named = [LAST_PASSES[line["stage"]] for line in lines if line.get("ok") and line.get("stage") in LAST_PASSES]
    last_pass = named[-1] if named and passed and not waiting else None
    silence = None if last is None else max((time.time() if now is None else now) - last, 0.0)
    judged: dict[int, dict[int, str]] = {DOUBTFUL: {}, WRONG: {}}
    for frame in registered:
        if stored[frame][1] in judged:
            judged[stored[frame][1]][frame] = "; ".join(read_diagnostics(run, frame).get("reasons", ()))
    told = judged[DOUBTFUL], judged[WRONG], failed, passed, waiting, pace, silence, last_pass
    return Standing(str(config.get("capture")), tuple(frames), registered, *told, earlier)


def _stored(
    run: Path, identity: Callable[[int], int] | None
) -> tuple[dict[int, tuple[int, int | None]], tuple[int, ...]]:
    """{frame: (done, verdict)} of what the run's store, and the one that grows beside it, have made of what is asked, all where
    nothing tells; and the registered frames of the run's that were made of what was asked before."""
    found: dict[int, tuple[int, int | None]] = {}
    earlier: list[int] = []
    for folder in (run / "work", run):
        opened = open_run(folder) if is_run(folder) else None
        for row, frame in enumerate([] if opened is None else opened.frames.tolist()):
            done, level = int(opened.done[row]), None if opened.verdict is None else int(opened.verdict[row])
            if identity is None or opened.identity is None or int(opened.identity[row]) == identity(frame):
                found[frame] = done, level
            elif folder == run and done == OK:
                earlier.append(frame)
    return found, tuple(frame for frame in earlier if frame not in found)


def pace_of(lines: Iterable[dict[str, Any]], stage: str) -> tuple[float | None, float | None]:
    """From the lines of a status, frames a second that left a stage over the last WINDOW, by all processes; and the time of the last line [s]. Of times
    on the other side of a clock's jump nothing is told."""
    times, last = [], None
    for line in lines:
        at = line.get("time")
        if isinstance(at, (int, float)):
            last = at
            if line.get("stage") == stage and line.get("ok"):
                times.append(at)
    recent = [at for at in times if abs(at - times[-1]) < WINDOW]
    span = max(recent) - min(recent) if recent else 0.0
    return ((len(recent) - 1) / span if span > 0 else None), last
