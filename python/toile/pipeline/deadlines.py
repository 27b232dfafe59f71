"""A frame that takes too long fails: where one of its steps ends too late, or does not end. What does not end is ended with
its process, since nothing else stops a loop in a kernel; other processes go on."""

from __future__ import annotations

import faulthandler
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import IO, Any

GRACE = 5.0  # s that a step may go on beyond a limit: to start another process takes about as long
_under_way: dict[int, tuple[float, IO[str]]] = {}  # of this process: when it is to end, and where to tell why
_lock, _keys = threading.Lock(), count()


@dataclass(frozen=True)
class Deadline:
    """A frame fails that takes more than `limit` [s]. A step of it that goes on for GRACE more ends with its
    process: where each thread stood is then told in the file `trace`, below the line `mark`."""

    limit: float
    trace: Path
    mark: str

    @property
    def end(self) -> float:
        """Seconds after which a frame's process ends."""
        return self.limit + GRACE

    def begun(self) -> bool:
        """A step was under way when its process ended."""
        return self._told() is not None

    def missed(self) -> str | None:
        """Why the frame failed, where its process ended since a step of it had not."""
        if not (self._told() or "").strip():
            return None
        return (
            f"the frame had not ended after {self.end:g} s, --frame-limit {self.limit:g}; where it stood: {self.trace}"
        )

    def _told(self) -> str | None:
        """What lies in the trace; None where none is there of the same `mark`."""
        mark, _, told = self.trace.read_text(errors="replace").partition("\n") if self.trace.exists() else ("", "", "")
        return told if mark == self.mark else None

    def within(self, begin: Callable[[], Iterator[Any]]) -> Iterator[None]:
        """Goes through the steps of `begin()`, and yields after each. TimeoutError: they have taken longer."""
        taken, ended = 0.0, False
        with closing(_steps(begin)) as steps:
            while not ended:
                start = time.monotonic()
                with self._alarm(self.end - taken):
                    ended = next(steps, True)
                taken += time.monotonic() - start
                if taken > self.limit:
                    raise TimeoutError(f"the frame took {taken:.1f} s so far, --frame-limit {self.limit:g}")
                if not ended:
                    yield

    @contextmanager
    def _alarm(self, seconds: float) -> Iterator[None]:
        """Ends this process if the block has not ended by then."""
        self.trace.parent.mkdir(parents=True, exist_ok=True)
        key = next(_keys)
        with open(self.trace, "w") as file:
            print(self.mark, file=file, flush=True)
            with _lock:
                _under_way[key] = time.monotonic() + seconds, file
                _set_alarm()
            try:
                yield
            finally:
                with _lock:
                    del _under_way[key]
                    _set_alarm()
                self.trace.unlink()


def _steps(begin):
    """Of `begin()`, which may do all its work when it is called; what is yielded is not True."""
    for _ in begin() or ():
        yield False


def _set_alarm():
    """For whatever is to end first. It needs no lock of Python's, so that it ends kernels that keep that too."""
    faulthandler.cancel_dump_traceback_later()
    if _under_way:
        end, file = min(_under_way.values(), key=lambda one: one[0])
        faulthandler.dump_traceback_later(max(end - time.monotonic(), 0.01), file=file, exit=True)
