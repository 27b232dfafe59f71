"""The resumable runner: frames in blocks, by this process, its workers and other shards, each frame's results in a folder.

A killed job goes on where it stood, with the same bits: what is whole is never made again. Temporal state lives inside
blocks of 50 absolute frame numbers, so that workers and shards, which take whole blocks, never change a bit.
"""

from __future__ import annotations

import errno
import json
import math
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from multiprocessing import get_context, parent_process
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from .. import kernels
from ..errors import UserError, first_line
from ..io.bounded import read_json
from ..io.files import write_text
from ..io.status import Status
from ..kernels import InputError, SolveError
from .overlap import overlapped

Progress = Callable[[str, int, int], None]  # (stage, done, total)
BLOCK = 50
SHARES = 4  # a worker, where the work is not in blocks
EXPECTED = (UserError, InputError, SolveError, OSError, MemoryError, np.linalg.LinAlgError)  # of bad frames
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EMFILE, errno.ENFILE}  # no frame's own fault


def blocks(frames: Sequence[int]) -> list[tuple[int, ...]]:
    """The frames, in order, cut where the block of 50 absolute numbers changes: no temporal state crosses a cut."""
    return [tuple(numbers) for _, numbers in groupby(frames, lambda number: number // BLOCK)]


@dataclass(frozen=True)
class FrameFolders:
    """ROOT/NNNNNN/ for every frame: its results with a file `whole`, or `failed.json` with the reason. Failures are also
    lines of `status`, as of the stage `stage`."""

    root: Path
    status: Status
    stage: str

    def folder(self, frame: int) -> Path:
        return self.root / f"{frame:06d}"

    def whole(self, frame: int) -> bool:
        return (self.folder(frame) / "whole").exists()

    def done(self, frame: int) -> bool:
        return self.whole(frame) or (self.folder(frame) / "failed.json").exists()

    def reason(self, frame: int) -> str | None:
        """Why a frame failed; None where it did not."""
        path = self.folder(frame) / "failed.json"
        return str(read_json(path, dict).get("reason")) if path.exists() else None

    def fail(self, frame: int, error: Exception) -> None:
        """Records that a frame failed, whatever raised; of what no bad file explains, the traceback too. What the disk
        refuses is raised again: it is the run's."""
        if isinstance(error, OSError) and error.errno in DISK:
            raise error
        reason, told = first_line(error), {}
        if not isinstance(error, EXPECTED):
            reason, told = f"{type(error).__name__}: {reason}", {"traceback": traceback.format_exception(error)}
        if f"{frame:06d}" not in reason:
            reason = f"frames/{frame:06d}: {reason}"
        write_text(self.folder(frame) / "failed.json", json.dumps({"reason": reason, **told}))
        self.status.add(frame=frame, stage=self.stage, seconds=0.0, ok=False, reason=reason)

    def reopen(self, frames: Sequence[int]) -> None:
        """These frames are no longer done."""
        for frame in frames:
            (self.folder(frame) / "failed.json").unlink(missing_ok=True)
            (self.folder(frame) / "whole").unlink(missing_ok=True)


@dataclass(frozen=True)
class BlockJob:
    """What is done to each frame. `prepare(*arguments)` gives what all frames need: it is called under the folder's lock, and
    again in every worker. `make(prepared, frame, previous, folders)` makes one frame's results in its folder, and may yield
    between its steps: while one frame takes a step, the next takes those before it, see `overlapped`. `previous` is the frame
    before it whose results give temporal state, or None: what that frame's steps up to the same one have left is there. `reach`: how many numbers that one may lie back.
    `title`: what progress calls it. Functions are named in modules, and arguments pickle: they go to other processes."""

    folder: Path
    results: FrameFolders
    prepare: Callable
    arguments: tuple
    make: Callable
    reach: int
    title: str


def run_job(
    job: BlockJob,
    frames: Sequence[int],
    whole: Callable[[], bool],
    complete: Callable,
    workers: int = 1,
    shard: tuple[int, int] = (1, 1),
    left: Callable[[], Sequence[int]] | None = None,
    progress: Progress = lambda stage, done, total: None,
) -> None:
    """Makes the blocks of this shard, and then, if every frame is done by whichever process, `complete(prepared, workers)`.

    `whole()`: the job ended before. `left()`: of `frames`, those that are to be made (all by default); the others only cut
    the blocks. `prepare` is given `progress(stage, done, total)` in this process."""
    own = blocks(frames)[shard[0] - 1 :: shard[1]]
    busy = min(workers, max(len(own), 1))  # the cores of workers that no block is left for go to threads
    with (
        one_blas_thread(),
        _threads(max(kernels.threads(), workers)),
        Workers(busy, job.prepare, *job.arguments) as pool,
    ):
        with locked(job.folder):
            if whole():
                return
            prepared, wanted = pool.prepared(progress), set(left() if left else frames)
        for i, _ in enumerate(pool.each(partial(_make_block, job.make, job.reach, job.results, wanted), own)):
            progress(job.title, i + 1, sum(map(len, own)))
        with locked(job.folder):
            if not whole() and all(job.results.done(number) for number in (left() if left else frames)):
                complete(prepared, pool)


def check_shares(workers: int, shard: tuple[int, int]) -> None:
    """UserError: not at least one worker, or no i-th of n shards."""
    if workers < 1 or not 1 <= shard[0] <= shard[1]:
        asked = f"workers {workers}, shard {shard[0]}/{shard[1]}"
        raise UserError(f"{asked}: expected at least one worker and 1 <= i <= n")


def _make_block(make, reach, results, wanted, prepared, numbers):
    """One block's frames, in their order and several under way at once; yields each number when it is behind."""
    place = {number: i for i, number in enumerate(numbers)}
    whole = [number for number in numbers if results.whole(number)]
    left = [number for number in numbers if number in wanted and not results.done(number)]

    def begin(number, before):
        earlier = [n for n in whole if place[n] < place[number]] + ([] if before is None else [before])
        last = max(earlier, key=place.get, default=None)
        near = last is not None and 0 < number - last <= reach
        yield from make(prepared, number, last if near else None, results) or ()

    yield from (number for number in numbers if number not in left)
    for number, error in overlapped(begin, left):
        if error is None:
            write_text(results.folder(number) / "whole", "")
        else:
            results.fail(number, error)
        yield number


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Holds FOLDER/.lock, made when it is not there; waits while another process holds it. A killed process lets go."""
    import fcntl

    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def one_blas_thread() -> threadpool_limits:
    """Holds numpy's and scipy's BLAS to one thread from now on, or as a context: another number sums in another order, to
    other bits. What is large runs in the kernels, so that this costs no time."""
    import scipy.linalg  # noqa: F401  a BLAS that is loaded later would not be held

    return threadpool_limits(1, "blas")


@contextmanager
def _threads(count):
    """Lets kernels called from this thread use `count` threads."""
    before = kernels.threads()
    kernels.set_threads(count)
    try:
        yield
    finally:
        kernels.set_threads(before)


class Workers:
    """This process, or `count` others, each with what `prepare(*arguments)` gives there.

    The processes are spawned when first needed, not forked: OpenMP's threads do not survive a fork. They end when their
    parent does.
    """

    def __init__(self, count: int, prepare: Callable, *arguments):
        self.count, self.prepare, self.arguments = count, prepare, arguments
        self._pool, self._prepared = None, []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind, *_) -> None:
        if self._pool is not None:
            for process in list((self._pool._processes or {}).values()) if kind is not None else ():
                process.terminate()  # not waited for: what they were about is made again
            self._pool.shutdown(cancel_futures=True)

    def prepared(self, *progress):
        """What this process has prepared, made once; `prepare` is given the progress as its last argument."""
        if not self._prepared:
            self._prepared.append(self.prepare(*self.arguments, *progress))
        return self._prepared[0]

    def shares(self, items: Sequence) -> list[tuple]:
        """The items in shares for `each`: one for this process, several a worker, so that all end at about one time."""
        most = len(items) if self.count == 1 else math.ceil(len(items) / (SHARES * self.count))
        return [tuple(items[i : i + most]) for i in range(0, len(items), max(most, 1))]

    def each(self, function: Callable, items: Sequence) -> Iterator:
        """Yields what the generator `function(prepared, item)` yields, item by item as they are done."""
        if self.count == 1 or len(items) < 2:
            for item in items:
                yield from function(self.prepared(), item)
            return
        if self._pool is None:
            start = max(kernels.threads() // self.count, 1), self.prepare, self.arguments
            self._pool = ProcessPoolExecutor(self.count, get_context("spawn"), _begin, start)
        blocked = signal.pthread_sigmask(
            signal.SIG_BLOCK, {signal.SIGINT}
        )  # inherited: Ctrl-C is this process's matter
        try:
            futures = [self._pool.submit(_call, function, item) for item in items]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        try:
            for future in as_completed(futures):
                yield from future.result()
        except BrokenProcessPool:
            raise UserError(
                "a worker process was ended from outside, for want of memory perhaps; go on with fewer"
            ) from None


_own = []  # what this worker process has prepared


def _begin(threads, prepare, arguments):
    threading.Thread(target=_end_with_parent, daemon=True).start()
    kernels.set_threads(threads)
    one_blas_thread()
    _own.append(prepare(*arguments))


def _call(function, item):
    return list(function(_own[0], item))


def _end_with_parent():
    parent_process().join()
    os._exit(1)
