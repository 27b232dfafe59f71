"""Items made in steps, several at once: what is handed on, what is done side by side, and what a failure undoes."""

import threading
import time

import pytest

from toile import kernels
from toile.pipeline.overlap import overlapped

STEPS = 3


class Line:
    """Items of three steps that note what they meet."""

    def __init__(self, bad=(), seconds=0.002):
        self.bad, self.seconds, self.lock = dict(bad), seconds, threading.Lock()
        self.left, self.before, self.threads = {}, {}, set()
        self.running, self.shared = [0] * STEPS, False

    def begin(self, item, before):
        self.before[item] = before
        self.left[item] = -1
        for step in range(STEPS):
            with self.lock:
                self.running[step] += 1
                self.shared |= self.running[step] > 1
                self.threads.add(kernels.threads())
                if before is not None:
                    assert self.left[before] >= step, "a step ran before its turn"
            time.sleep(self.seconds)
            with self.lock:
                self.running[step] -= 1
                self.left[item] = step
            if self.bad.get(item) == step:
                raise ValueError(f"item {item}")
            if step < STEPS - 1:
                yield


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_items_end_in_their_order_and_each_has_the_one_before_it(threads):
    line = Line()
    assert list(overlapped(line.begin, range(6), threads)) == [(i, None) for i in range(6)]
    assert line.before == {0: None} | {i: i - 1 for i in range(1, 6)}


def test_steps_of_neighbours_run_side_by_side_and_the_same_step_never():
    met, line = threading.Barrier(2, timeout=300), Line(seconds=0.02)

    def begin(item, before):
        for step in range(STEPS):
            if item + step == 1:  # the second step of item 0, the first of item 1
                met.wait()
            yield

    assert list(overlapped(begin, range(2), 2)) == [(0, None), (1, None)]
    list(overlapped(line.begin, range(6), 3))
    assert not line.shared


def test_the_threads_are_shared_among_items_and_kernels():
    line, own = Line(), kernels.threads()
    list(overlapped(line.begin, range(4), 8))
    assert line.threads == {2} and kernels.threads() == own


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("step", range(STEPS))
def test_an_item_that_fails_gives_nothing_to_those_after_it(threads, step):
    line = Line(bad={2: step})
    ended = list(overlapped(line.begin, range(6), threads))
    assert [item for item, _ in ended] == list(range(6))
    assert [type(error) for _, error in ended] == [type(None)] * 2 + [ValueError] + [type(None)] * 3
    assert line.before == {0: None, 1: 0, 2: 1, 3: 1, 4: 3, 5: 4}


def test_leaving_early_ends_what_is_under_way():
    line = Line(seconds=0.02)
    for item, _ in overlapped(line.begin, range(9), 2):
        if item == 1:
            break
    began = len(line.before)
    time.sleep(0.1)
    assert sum(line.running) == 0 and len(line.before) == began < 9


def test_an_interrupt_in_a_step_reaches_the_caller():
    def begin(item, before):
        yield
        raise KeyboardInterrupt

    for threads in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            list(overlapped(begin, range(3), threads))


def test_nothing_to_make_is_no_work():
    assert list(overlapped(Line().begin, (), 2)) == []
