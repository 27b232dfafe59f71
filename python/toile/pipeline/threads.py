"""How many threads compute: of the kernels, as many as one likes; of BLAS, one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from .. import kernels


def one_blas_thread() -> threadpool_limits:
    """Holds numpy's and scipy's BLAS to one thread from now on, or as a context: another number sums in another order, to
    other bits. What is large runs in the kernels, so that this costs no time."""
    import scipy.linalg  # noqa: F401  a BLAS that is loaded later would not be held

    return threadpool_limits(1, "blas")


@contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Lets kernels called from this thread use `count` threads."""
    before = kernels.threads()
    kernels.set_threads(count)
    try:
        yield
    finally:
        kernels.set_threads(before)
