"""Items that are made in steps, several at once as on an assembly line: while one frame is dressed, the next is tracked."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

from .. import kernels
from .stopping import asked

Item = TypeVar("Item")
LINES = 4  # items under way at once, at most: more threads than that go to the kernels of each


def overlapped(
    begin: Callable[[Item, Item | None], Iterator[Any]], items: Iterable[Item], threads: int | None = None
) -> Iterator[tuple[Item, Exception | None]]:
    """Yields each item in its order with what its work raised, None where it ended well.

    `begin(item, before)` starts an item's work: an iterator that yields after each step. `before` is the latest item
    before it that has not failed; a step begins once that item's step of the same number has ended, so that what step k
    keeps is one item's at a time, and may read what its step k has left. Where an item fails, those after it that had
    begun begin again, without it. `threads` are shared among the items under way and the kernels that they call
    (`kernels.threads()` by default); what is made does not depend on them. Where it is asked to stop, no item is begun any more.
    """
    threads = kernels.threads() if threads is None else threads
    lanes = min(threads, LINES)
    if lanes == 1:
        yield from _one_by_one(begin, items)
        return
    with ThreadPoolExecutor(lanes, "toile", kernels.set_threads, (threads // lanes,)) as pool:
        line = _Line(begin, items, lanes, pool)
        try:
            while work := line.following():
                yield work.item, work.error
        finally:
            line.drop()


def _one_by_one(begin, items):
    before = None
    for item in items:
        if asked():
            return
        work = _Work(item, begin(item, before))
        while not work.ended:
            work.step()
        if work.error is None:
            before = item
        yield item, work.error


class _Work:
    """One item's work: `steps` have ended, `running` is the future of the one under way."""

    def __init__(self, item, iterator):
        self.item, self.iterator, self.steps = item, iterator, 0
        self.running: Future | None = None
        self.ended, self.error = False, None

    def step(self):
        try:
            next(self.iterator)
        except StopIteration:
            self.ended = True
        except Exception as error:
            self.ended, self.error = True, error
        self.steps += 1


class _Line:
    """The items under way, in their order. The calling thread alone decides what runs."""

    def __init__(self, begin, items, lanes, pool):
        self.begin, self.waiting, self.lanes, self.pool = begin, deque(items), lanes, pool
        self.way: deque[_Work] = deque()
        self.last = None  # the latest item that ended well

    def following(self) -> _Work | None:
        """The next item's work once it has ended; None after the last."""
        while self.way or (self.waiting and not asked()):
            if self.way and self.way[0].ended:
                return self._leave()
            self._run()
            wait([work.running for work in self.way if work.running], return_when=FIRST_COMPLETED)
            for work in self.way:
                if work.running and work.running.done():
                    work.running.result()
                    work.running = None
        return None

    def _leave(self):
        work = self.way.popleft()
        if work.error is None:
            self.last = work.item
        else:
            self.waiting.extendleft(after.item for after in reversed(self.drop()))
        return work

    def drop(self):
        """Ends what is under way; the works that were."""
        dropped = list(self.way)
        self.way.clear()
        wait([work.running for work in dropped if work.running])
        for work in dropped:
            work.iterator.close()
        return dropped

    def _run(self):
        """Gives every free thread the next step of the earliest item that may go on; one item more than threads is begun."""
        while self.waiting and not asked() and len(self.way) <= self.lanes and not (self.way and self.way[-1].error):
            item = self.waiting.popleft()
            self.way.append(_Work(item, self.begin(item, self.way[-1].item if self.way else self.last)))
        free, earlier = self.lanes - sum(work.running is not None for work in self.way), None
        for work in self.way:
            clear = earlier is None or (earlier.ended and not earlier.error) or earlier.steps > work.steps
            if free and clear and not work.ended and work.running is None:
                work.running, free = self.pool.submit(work.step), free - 1
            earlier = work
