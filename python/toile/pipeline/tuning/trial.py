"""Few frames of a capture, registered in a process of their own, and what that took."""

from __future__ import annotations

import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

from ... import kernels
from ...config import Config
from ...errors import UserError
from ...frame_numbers import evenly
from ...io.capture import Capture
from ...io.run import open_run
from ..blocks import BLOCK
from ..run import register

PLACES, TOGETHER = 5, 3  # of the sequence, and frames at each: the later ones have one before them
FIRST = 5  # frames at the first place: fewer in a row say nothing of flicker, and nothing would be smoothed
FIRST_STAGES = ("reconstruct", "track", "segment", "dress")  # of the first pass
LAST_STAGES = ("prints", "flicker", "motion", "fuse", "store")  # of the last passes, what grows with the frames


@dataclass(frozen=True)
class Cost:
    """Wall clock and processor time [s]."""

    wall: float
    cpu: float


@dataclass(frozen=True)
class Trial:
    """What registering `frames` took: what is prepared for all, the first pass, the rest, and `each`, what of the rest
    a frame adds; `peak` memory, what passes between
    the stages in RUN/work, `kept` of the run itself, each [bytes], the latter two a frame; `stages` [s] a frame."""

    quality: str
    run: Path
    frames: tuple[int, ...]
    prepare: Cost
    first: Cost
    last: Cost
    each: Cost
    peak: int
    work: float
    kept: float
    fixed: int  # bytes of the run that do not grow with the frames
    stages: dict[int, dict[str, float]]


def sampled(numbers: Sequence[int], places: int = PLACES) -> tuple[int, ...]:
    """Frames at so many places spread over the sequence, TOGETHER from each on, FIRST from the first; all of a short one."""
    starts = evenly(range(max(len(numbers) - TOGETHER + 1, 1)), places)
    return tuple(sorted({n for at in starts for n in numbers[at : at + (TOGETHER if at else FIRST)]}))


def first_at_each_place(frames: Sequence[int]) -> tuple[int, ...]:
    """Of the frames that `sampled` chose, the first at each place."""
    return (*frames[:1], *frames[FIRST::TOGETHER])


def alone(numbers: Sequence[int]) -> set[int]:
    """Those of the frames that begin without the state of one before them: another block's, or not the next number's."""
    follow = {b for a, b in pairwise(numbers) if b - a == 1 and a // BLOCK == b // BLOCK}
    return {number for number in numbers if number not in follow}


def tried(capture: Capture, run: Path, config: Config, frames: Sequence[int]) -> Trial:
    """Registers the frames into the folder `run` and returns the Trial. Errors are those of `register`. UserError: the process was
    ended from outside. Where this one is stopped, that one is too."""
    spawned = get_context("spawn")
    here, there = spawned.Pipe(duplex=False)
    process = spawned.Process(target=_tell, args=(there, capture, run, config, tuple(frames), kernels.threads()))
    process.start()
    there.close()  # so that its end over there is heard here
    try:
        trial, error = here.recv()
    except EOFError:
        ended = "the process that registered was ended from outside, for want of memory perhaps"
        raise UserError(f"{run}: {ended}: try fewer --frames, or a machine with more memory") from None
    finally:
        process.kill()
        process.join()
    if error is not None:
        raise error
    return trial


def _tell(there, *given):
    """Sends (Trial, None), or (None, what went wrong)."""
    try:
        told = _registered(*given), None
    except BaseException as error:
        error.add_note(traceback.format_exc())  # where it was, which is lost on the way
        told = None, error
    there.send(told)


def _registered(capture, run, config, frames, threads):
    """What `tried` does, in the process of its own."""
    kernels.set_threads(threads)
    marks = [("begin", _now())]
    register(capture, run, config, frames, lambda stage, *_: marks.append((stage, _now())))
    end = _now()
    prepared = [at for stage, at in marks if stage in ("begin", "prepare")][-1]
    titles = list(dict.fromkeys(stage for stage, _ in marks if stage not in ("begin", "prepare")))
    passed = [at for stage, at in marks if stage == titles[0]][-1] if titles else prepared
    spans = [_between(*pair) for pair in ((marks[0][1], prepared), (prepared, passed), (passed, end))]
    opened = open_run(run)
    kept, work = _framed_bytes(opened), _bytes(run / "work")
    rest = _bytes(run) - work - kept
    stages, lines = {number: {} for number in frames}, list(opened.status.lines())
    for line in lines:
        if line.get("ok") and line.get("frame") in stages and "seconds" in line:
            stages[line["frame"]][line["stage"]] = line["seconds"]
    count = len(frames)
    return Trial(
        config.quality, run, frames, *spans, growing(lines, count), _peak(), work / count, kept / count, rest, stages
    )


def growing(lines, count):
    """What a frame adds to the last passes; what is built for all of them, or with the first one, is not counted."""
    grown = [line for line in lines if line.get("ok") and line.get("stage") in LAST_STAGES and "seconds" in line]
    return Cost(*(sum(_of_frames(line, clock) for line in grown) / count for clock in ("seconds", "cpu")))


def _of_frames(line, clock):
    whole = line.get(clock, line["seconds"])
    return line["frames"] * line[f"each_{clock}"] if f"each_{clock}" in line else whole


def _now():
    return time.perf_counter(), time.process_time()


def _between(start, end):
    return Cost(end[0] - start[0], end[1] - start[1])


def _peak():
    """Most memory [bytes] that this process has held. (A child's ru_maxrss starts at its parent's.)"""
    return 1024 * int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])


def _bytes(folder):
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _framed_bytes(run):
    """Bytes that grow with the frames: arrays of the store whose first axis they are, and files beside it."""
    beside = sum(_bytes(run.path / name) for name in ("diagnostics", "inputs", "scans") if (run.path / name).exists())
    return beside + run.framed_bytes()
