"""Work spread over the threads that the kernels may use."""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

from .. import kernels


def parallel_map(function, items):
    """[function(item) for item in items], by `kernels.threads()` threads, whose kernels then have one each. It pays where
    the time goes into numpy, OpenCV or the core, which let other threads run."""
    items, count = list(items), kernels.threads()
    if count == 1 or len(items) < 2:
        return [function(item) for item in items]
    return list(_pool(count).map(function, items))


@lru_cache(maxsize=1)
def _pool(count):
    return ThreadPoolExecutor(count, "toile", kernels.set_threads, (1,))
