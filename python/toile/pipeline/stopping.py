"""Ctrl-C and SIGTERM let the frames in hand end."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

PATIENCE = 25.0  # s; batch systems kill 30 s after they have asked
_asked: list[int] = []  # signals that have come


class Terminated(KeyboardInterrupt):
    """SIGTERM stopped it."""


def raise_when_terminated() -> None:
    """From now on SIGTERM is raised as Terminated, as Ctrl-C is: what is half made is cleared away. Threads beside the main one get
    no signals."""

    def hear(number: int, _: FrameType | None) -> None:
        raise Terminated

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, hear)


def asked() -> bool:
    """Is it asked to end? No frame is begun any more."""
    return bool(_asked)


@contextmanager
def stoppable() -> Iterator[None]:
    """While this lasts, the first SIGINT or SIGTERM only makes `asked()` true, and is raised at the end; a second one is
    raised at once, and so is the first after PATIENCE. Of a thread beside the main one, which gets no signals, nothing
    changes. KeyboardInterrupt, Terminated."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    timer = threading.Timer(PATIENCE, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.daemon = True

    def hear(number: int, _: FrameType | None) -> None:
        _asked.append(number)
        if len(_asked) > 1:
            raise _interruption()
        timer.start()

    before = {number: signal.signal(number, hear) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
        if _asked:
            raise _interruption()
    finally:
        timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)
        _asked.clear()


def _interruption() -> KeyboardInterrupt:
    return Terminated() if _asked[0] == signal.SIGTERM else KeyboardInterrupt()
