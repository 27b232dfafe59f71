"""The resumable runner: frames in blocks, by this process, its workers and other shards, each frame's results in a folder.

A killed job goes on where it stood, with the same bits: what is whole is never made again. Temporal state lives inside
blocks of 50 absolute frame numbers, so that workers and shards, which take whole blocks, never change a bit.
"""

from __future__ import annotations

import errno
import json
import operator
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from numbers import Integral
from pathlib import Path

import numpy as np

from .. import kernels
from ..errors import UserError, first_line
from ..io.bounded import read_json
from ..io.files import write_text
from ..io.locks import locked, staying
from ..io.status import Status
from ..kernels import InputError, SolveError
from .deadlines import Deadline
from .overlap import overlapped
from .stopping import stoppable
from .threads import kernel_threads
from .workers import LIVES, Workers, check_workers, killed

Progress = Callable[[str, int, int], None]  # (stage, done, total)
BLOCK = 50
EXPECTED = (UserError, InputError, SolveError, OSError, MemoryError, np.linalg.LinAlgError)  # of bad frames
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EMFILE, errno.ENFILE}  # no frame's own fault


def raise_where_disk(error: Exception) -> None:
    """Raises again what the disk refuses: it is the run's, not a frame's."""
    if isinstance(error, OSError) and error.errno in DISK:
        raise error


def blocks(frames: Sequence[int], apart: Sequence[int] = ()) -> list[tuple[int, ...]]:
    """The frames, in order, cut where the block of 50 absolute numbers changes, and where those held `apart` begin and end: no
    temporal state crosses a cut."""
    return [tuple(numbers) for _, numbers in groupby(frames, lambda number: (number // BLOCK, number in apart))]


@dataclass(frozen=True)
class FrameFolders:
    """ROOT/NNNNNN/ for every frame: its results with a file `whole`, or `failed.json` with the reason. Failures are also
    lines of `status`, as of the stage `stage`. `identity(frame)`: what its results are to be made of; where others lie there,
    the frame is not done."""

    root: Path
    status: Status
    stage: str
    identity: Callable[[int], str] | None = None

    def folder(self, frame: int) -> Path:
        return self.root / f"{frame:06d}"

    def whole(self, frame: int) -> bool:
        path = self.folder(frame) / "whole"
        return path.exists() and (self.identity is None or path.read_text() == self.identity(frame))

    def end(self, frame: int) -> None:
        """All results of a frame are there."""
        write_text(self.folder(frame) / "whole", self.identity(frame) if self.identity else "")

    def done(self, frame: int) -> bool:
        return self.whole(frame) or self.reason(frame) is not None

    def reason(self, frame: int) -> str | None:
        """Why a frame failed; None where it did not."""
        path = self.folder(frame) / "failed.json"
        found = read_json(path, dict) if path.exists() else {}
        same = self.identity is None or found.get("identity") == self.identity(frame)
        return str(found["reason"]) if same and "reason" in found else None

    def timed(self, frame: int, limit: float | None, begin: Callable) -> Iterator:
        """The steps of `begin()`, which makes a frame; within the limit [s], where there is one."""
        return iter(begin() or ()) if limit is None else self._deadline(frame, limit).within(begin)

    def fail_late(self, frames: Iterable[int], limit: float | None) -> bool | None:
        """Those of the frames that have ended a process by their limit, and have not failed yet, have failed. None: there are none.
        False: others were under way in it, and any of them may have kept Python's lock from all: none has failed, they are to be
        made alone."""
        if limit is None:
            return None
        deadlines = {frame: self._deadline(frame, limit) for frame in frames if self.reason(frame) is None}
        late = {frame: why for frame, deadline in deadlines.items() if (why := deadline.missed()) is not None}
        known = sum(deadline.begun() for deadline in deadlines.values()) == 1
        for frame, why in late.items():
            if known:
                self.fail(frame, TimeoutError(why))
            else:
                deadlines[frame].trace.unlink()
        return known if late else None

    def _deadline(self, frame, limit):
        mark = self.identity(frame) if self.identity else f"{frame:06d}"
        return Deadline(limit, self.folder(frame) / "late.txt", mark)

    def fail(self, frame: int, error: Exception) -> None:
        """Records that a frame failed, whatever raised; of what no bad file explains, the traceback too. What the disk
        refuses is raised again: it is the run's."""
        raise_where_disk(error)
        reason, told = first_line(error), {}
        if not isinstance(error, EXPECTED):
            reason, told = f"{type(error).__name__}: {reason}", {"traceback": traceback.format_exception(error)}
        if f"{frame:06d}" not in reason:
            reason = f"frames/{frame:06d}: {reason}"
        told |= {"identity": self.identity(frame)} if self.identity else {}
        write_text(self.folder(frame) / "failed.json", json.dumps({"reason": reason, **told}))
        self.status.add(frame=frame, stage=self.stage, seconds=0.0, ok=False, reason=reason)


@dataclass(frozen=True)
class BlockJob:
    """What is done to each frame. `prepare(*arguments)` gives what all frames need: it is called under the folder's lock, and
    again in every worker. `make(prepared, frame, previous, folders)` makes one frame's results in its folder, and may yield
    between its steps: while one frame takes a step, the next takes those before it, see `overlapped`. `previous` is the frame
    before it whose results give temporal state, or None: what that frame's steps up to the same one have left is there. `reach`: how many numbers that one may lie back.
    `title`: what progress calls it. `apart`: frames that others take no state from, nor they from others. `limit` [s]: a frame
    fails that takes longer, and is made by a process beside this one, which can be ended. Functions are named in modules, and arguments pickle: they go to other processes."""

    folder: Path
    results: FrameFolders
    prepare: Callable
    arguments: tuple
    make: Callable
    reach: int
    title: str
    apart: Sequence[int] = ()
    limit: float | None = None


@dataclass(frozen=True)
class Block:
    """Frame numbers in order, of which those in `wanted` are to be made; `alone`: one at a time."""

    numbers: tuple[int, ...]
    wanted: frozenset[int]
    alone: bool = False

    def left(self, results: FrameFolders) -> list[int]:
        """Those that are still to be made."""
        return [number for number in self.numbers if number in self.wanted and not results.done(number)]


def run_job(
    job: BlockJob,
    frames: Sequence[int],
    whole: Callable[[], bool],
    complete: Callable,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    left: Callable[[], Sequence[int]] | None = None,
    progress: Progress = lambda stage, done, total: None,
    scheduler: str | None = None,
) -> None:
    """Makes the blocks of this shard, and then, if every frame is done by whichever process, `complete(prepared, workers)`. UserError:
    the folder of the job is removed meanwhile.

    `whole()`: the job ended before. `left()`: of `frames`, those that are to be made (all by default); the others only cut
    the blocks. `prepare` is given `progress(stage, done, total)` in this process. `workers`, `scheduler`: see `Workers`."""
    every = blocks(frames, job.apart)
    own = every[shard[0] - 1 :: shard[1]]
    busy = min(workers, max(len(own), 1))  # the cores of workers that no block is left for go to threads
    with (
        staying(job.folder) as check_stays,
        kernel_threads(max(kernels.threads(), workers)),
        Workers(busy, job.prepare, *job.arguments, scheduler=scheduler, apart=job.limit is not None) as pool,
    ):
        with locked(job.folder):
            if whole():
                return
            pool.start()
            prepared, wanted = pool.prepared(progress), set(left() if left else frames)
        items = [Block(numbers, frozenset(wanted.intersection(numbers))) for numbers in own]
        make = partial(_make_block, job.make, job.reach, job.results, job.limit)
        lost = partial(_after_death, job.results, job.limit)
        for i, _ in enumerate(pool.each(make, items, lost)):
            check_stays()
            progress(job.title, i + 1, sum(map(len, own)))
        with locked(job.folder):
            if not whole() and all(job.results.done(number) for number in (left() if left else frames)):
                pool.resize(min(workers, max(len(every), 1)))
                complete(prepared, pool)
        check_stays()


def check_shares(workers: int, shard: tuple[int, int], scheduler: str | None = None) -> None:
    """UserError: not at least one worker, no i-th of n shards, or workers and a scheduler."""
    check_workers(workers, scheduler)
    match shard:
        case Integral() as i, Integral() as n if 1 <= i <= n:
            return
    raise UserError(f"shard {shard}: expected (i, n) with 1 <= i <= n")


def frame_numbers_of(name: str, values: Iterable[int]) -> tuple[int, ...]:
    """The frame numbers that the argument `name` gives, rising and each once. UserError: they are no whole numbers."""
    try:
        return tuple(sorted({operator.index(value) for value in values}))
    except TypeError:
        raise UserError(f"{name}: expected whole numbers of frames, came {type(values).__name__}") from None


def _make_block(make, reach, results, limit, prepared, block):
    """One block's frames, in their order and several under way at once; yields each number when it is behind."""
    place = {number: i for i, number in enumerate(block.numbers)}
    alone = results.fail_late(block.left(results), limit) is False or block.alone
    whole, left = [number for number in block.numbers if results.whole(number)], block.left(results)

    def begin(number, before):
        earlier = [n for n in whole if place[n] < place[number]] + ([] if before is None else [before])
        last = max(earlier, key=place.get, default=None)
        near = last is not None and 0 < number - last <= reach
        steps = partial(make, prepared, number, last if near else None, results)
        yield from results.timed(number, limit, steps)

    yield from (number for number in block.numbers if number not in left)
    with stoppable():
        for number, error in overlapped(begin, left, threads=1 if alone else None):
            if error is None:
                results.end(number)
            else:
                results.fail(number, error)
            yield number


def _after_death(results, limit, block, deaths):
    """The block as it is tried again. First its frames are made alone, so that it shows which one ends its worker; that one
    fails when it has cost LIVES of them. Where a limit ended the worker, that is known at once if one frame was under way."""
    known = results.fail_late(block.left(results), limit)
    if known is not None:
        return block if known else replace(block, alone=True)
    left = block.left(results)
    if block.alone and deaths >= LIVES and left:
        results.fail(left[0], UserError(killed(deaths)))
    return replace(block, alone=True)
