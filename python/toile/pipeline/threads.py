"""How many threads compute: of the kernels, as many as one likes; of BLAS, one."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import OpenBLASController, threadpool_limits

from .. import kernels


class one_blas_thread:
    """Holds numpy's and scipy's BLAS to one thread from now on, or as a context: another number sums in another order, to
    other bits. What is large runs in the kernels, so that this costs no time.

    The number is that of the process, whose threads may hold it at once: it is put back when the last of them lets go."""

    _lock = threading.Lock()
    _held: list[threadpool_limits] = []  # by each that holds it or has held it beside one that still does
    _holders = 0

    def __init__(self) -> None:
        import scipy.linalg  # noqa: F401  a BLAS that is loaded later would not be held

        with self._lock:
            _let_any_thread_set()
            self._held.append(threadpool_limits(1, "blas"))
            one_blas_thread._holders += 1

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        self.let_go()

    def let_go(self) -> None:
        """The end of the context; called once."""
        with self._lock:
            one_blas_thread._holders -= 1
            if not self._holders:
                _let_any_thread_set()
                while self._held:
                    self._held.pop().restore_original_limits()
                _let_any_thread_set()


def _let_any_thread_set() -> None:
    """From 3.8 on threadpoolctl silently refuses whoever would set OpenBLAS' number while the thread is alive that set it last."""
    if clear := getattr(OpenBLASController, "clear_controlling_thread", None):
        clear(force=True)


@contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Lets kernels called from this thread use `count` threads."""
    before = kernels.threads()
    kernels.set_threads(count)
    try:
        yield
    finally:
        kernels.set_threads(before)
