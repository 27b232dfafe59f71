"""Work spread over threads: results in order, and tools that serve one item at a time."""

import threading
import time

import pytest

from toile.vision.threads import parallel_map_with


@pytest.mark.parametrize("count", [1, 3])
def test_a_tool_serves_one_item_at_a_time_and_results_keep_their_order(count, threads):
    made = []

    def work(lock, item):
        assert lock.acquire(blocking=False), "two items at one tool"
        time.sleep(0.002)
        lock.release()
        return item * item

    def make():
        made.append(threading.Lock())
        return made[-1]

    threads(count)
    assert parallel_map_with(make, work, range(20)) == [i * i for i in range(20)]
    assert 1 <= len(made) <= count
