"""Who makes the items of a job: this process, processes of this machine, or those of a dask scheduler that runs elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from numbers import Integral
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from .. import kernels
from ..errors import UserError
from .threads import one_blas_thread

if TYPE_CHECKING:
    from .cluster import Cluster

LIVES = 3  # workers that an item may cost


def check_workers(workers: int, scheduler: str | None) -> None:
    """UserError: not at least one worker, or workers of this machine and a scheduler's too."""
    if not isinstance(workers, Integral) or workers < 1:
        raise UserError(f"workers {workers!r}: expected a whole number from 1 on")
    if scheduler is not None and workers > 1:
        raise UserError(f"workers {workers}: scheduler {scheduler} is given too, which has workers of its own")


def everywhere(path: Path, scheduler: str | None) -> Path:
    """The path as other machines know it, where a scheduler's workers are to find it: absolute."""
    return path if scheduler is None else path.absolute()


def give_up(item: Any, deaths: int) -> Any:
    """`lost` of `Workers.each` by default: the same item again, until it has cost LIVES workers. Then UserError."""
    if deaths < LIVES:
        return item
    raise UserError(f"{killed(deaths)}; go on with fewer workers")


def killed(deaths: int) -> str:
    """What is said where items cost their workers."""
    return f"{deaths} worker processes were ended from outside over the same work, for want of memory perhaps"


class Workers:
    """This process, `count` others on this machine, or the workers of `scheduler` (tcp://HOST:PORT, or the .json file that
    `dask scheduler --scheduler-file` writes). Each has what `prepare(*arguments)` gives there. `apart`: not this process,
    though one is enough: an item may cost its process.

    As a context, numpy's BLAS has one thread here as it has there. Processes start when first needed, or with `start`. They
    are spawned, not forked: OpenMP's threads do not survive a fork. They end when their parent does. Where one is lost,
    another takes its place and makes what it was about again.
    """

    def __init__(
        self, count: int, prepare: Callable, *arguments: Any, scheduler: str | None = None, apart: bool = False
    ):
        self.count, self.scheduler, self.apart = count, scheduler, apart
        self.prepare, self.arguments = prepare, arguments
        self._prepared: list[Any] = []
        self._opening: Future[Cluster] | None = None

    def __enter__(self) -> Workers:
        self._blas = one_blas_thread()
        return self

    def __exit__(self, kind: Any, *_: Any) -> None:
        self._blas.let_go()
        self._close(at_once=kind is not None)

    def start(self) -> None:
        """Starts the processes, which takes seconds, while this one goes on."""
        if self._opening is None and (self.count > 1 or self.apart or self.scheduler is not None):
            self._open()

    def resize(self, count: int) -> None:
        """From now on as many processes."""
        if count != self.count:
            self._close()
            self.count = count

    def prepared(self, *progress: Callable) -> Any:
        """What this process has prepared, made once; `prepare` is given the progress as its last argument."""
        if not self._prepared:
            self._prepared.append(self.prepare(*self.arguments, *progress))
        return self._prepared[0]

    def each(self, function: Callable, items: Sequence, lost: Callable[[Any, int], Any] = give_up) -> Iterator:
        """Yields what the generator `function(prepared, item)` yields, as soon as it does, of several items at once.

        What a lost worker was about is made again, and of what it had yielded nothing is yielded twice: the generator yields
        as often as before. `lost(item, deaths)` gives the item that is tried then, or raises; it is called with the number
        of workers that the item has cost so far, counted anew after LIVES."""
        if self.scheduler is None and not self.apart and (self.count == 1 or len(items) < 2):
            for item in items:
                yield from function(self.prepared(), item)
        else:
            yield from self._cluster().each(function, items, lost, LIVES)

    def _close(self, at_once: bool = False) -> None:
        if self._opening is not None and self._opening.exception() is None:
            self._opening.result().close(at_once=at_once)
        self._opening = None

    def _cluster(self) -> Cluster:
        return (self._opening or self._open()).result()

    def _open(self) -> Future[Cluster]:
        """The Cluster to be, made by a thread of its own."""
        self._opening = Future()
        Thread(target=self._make, args=(self._opening, kernels.threads()), name="toile-cluster").start()
        return self._opening

    def _make(self, made: Future[Cluster], threads: int) -> None:
        try:
            kernels.set_threads(threads)  # of this thread, as of the one that asked
            from .cluster import Cluster  # half a second

            made.set_result(Cluster(self.count, self.scheduler, self.prepare, self.arguments))
        except BaseException as error:
            made.set_exception(error)
