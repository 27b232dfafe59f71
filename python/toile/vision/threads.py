"""Work spread over the threads that the kernels may use."""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from queue import Empty, SimpleQueue

from .. import kernels


def parallel_map(function, items):
    """[function(item) for item in items], by `kernels.threads()` threads, whose kernels then have one each. It pays where
    the time goes into numpy, OpenCV or the core, which let other threads run."""
    items, count = list(items), kernels.threads()
    if count == 1 or len(items) < 2:
        return [function(item) for item in items]
    return list(_pool(count).map(function, items))


def parallel_map_with(make, function, items):
    """[function(tool, item) for item in items] as `parallel_map` does, where a tool serves one item at a time: each thread
    has one of its own from `make()`."""
    idle = SimpleQueue()

    def one(item):
        try:
            tool = idle.get_nowait()
        except Empty:
            tool = make()
        try:
            return function(tool, item)
        finally:
            idle.put(tool)

    return parallel_map(one, items)


@lru_cache(maxsize=1)
def _pool(count):
    return ThreadPoolExecutor(count, "toile", kernels.set_threads, (1,))
