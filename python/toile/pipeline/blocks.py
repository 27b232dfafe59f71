"""Several processes at one run: tasks spread over worker processes, and a lock that only one process holds."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context, parent_process

from .. import kernels

_own = None  # the object whose methods this worker process calls


@contextmanager
def locked(folder):
    """Holds FOLDER/.lock, made when it is not there; waits while another process holds it. A killed process lets go."""
    import fcntl

    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / ".lock", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


class Workers:
    """`count` processes, each with an object of its own that `make(*arguments)` gives; started when first needed.

    The processes are spawned, not forked: OpenMP's threads do not survive a fork. They end when their parent does.
    """

    def __init__(self, count, make, *arguments):
        self.count, self.start, self.pool = count, (max(kernels.threads() // count, 1), make, arguments), None

    def each(self, method, items):
        """Yields what the objects' generator `method(item)` yields, item by item as they are done."""
        if self.pool is None:
            self.pool = ProcessPoolExecutor(self.count, get_context("spawn"), _begin, self.start)
        futures = [self.pool.submit(_call, method, item) for item in items]
        for future in as_completed(futures):
            yield from future.result()

    def close(self):
        if self.pool is not None:
            self.pool.shutdown(cancel_futures=True)


def _begin(threads, make, arguments):
    global _own
    threading.Thread(target=_end_with_parent, daemon=True).start()
    kernels.set_threads(threads)
    _own = make(*arguments)


def _call(method, item):
    return list(getattr(_own, method)(item))


def _end_with_parent():
    parent_process().join()
    os._exit(1)
