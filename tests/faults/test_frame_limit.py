"""A frame that takes too long fails, whether it ends or not; no other is harmed."""

import ctypes
import threading
import time
from functools import partial
from types import SimpleNamespace

import pytest

from toile.io.files import write_text
from toile.io.status import Status
from toile.pipeline import deadlines
from toile.pipeline.blocks import BlockJob, FrameFolders, run_job
from toile.pipeline.deadlines import GRACE, Deadline

LIMIT = 10.0  # s; frames that do nothing stay within it on a machine with far too much to do
FRAMES = range(46, 53)
DEAF, IN_A_KERNEL = 47, 49  # frames that hang: one keeps Python's lock, one does not
BESIDE = 46  # its last step is under way when the deaf one takes the lock


def prepare(progress=None):
    return None


def make(prepared, number, previous, results):
    """Its own number and the one before; in two steps."""
    if number == DEAF:
        ctypes.PyDLL(None).sleep(10_000)
    if number == IN_A_KERNEL:
        threading.Event().wait()
    yield
    if number == BESIDE:
        time.sleep(2.0)
    before = "none" if previous is None else (results.folder(previous) / "made").read_text().split()[0]
    write_text(results.folder(number) / "made", f"{number} {before}")


def run(folder, frames, **options):
    results = FrameFolders(folder / "frames", Status.of(folder), "make")
    job, told = BlockJob(folder, results, prepare, (), make, 1, "make", **options), []
    run_job(job, frames, lambda: False, lambda *_: None, progress=lambda stage, done, _: told.append(done))
    assert told == list(range(1, len(frames) + 1))
    return results, {n: (results.folder(n) / "made").read_text() for n in frames if results.whole(n)}


@pytest.mark.slow(seconds=90)
def test_a_stage_that_hangs_ends_with_its_process_and_costs_its_frame_alone(tmp_path):
    good = [number for number in FRAMES if number not in (DEAF, IN_A_KERNEL)]
    results, made = run(tmp_path / "hangs", FRAMES, limit=LIMIT)
    assert made == run(tmp_path / "without", good)[1]
    for number, line in ((DEAF, "ctypes.PyDLL(None)"), (IN_A_KERNEL, "threading.Event()")):
        trace = results.folder(number) / "late.txt"
        told = f"the frame had not ended after {LIMIT + GRACE:g} s, --frame-limit {LIMIT:g}; where it stood: {trace}"
        assert results.reason(number) == told
        there = next(i for i, text in enumerate(open(__file__), 1) if line in text)
        assert f"line {there} in make" in trace.read_text()


@pytest.fixture
def clock(monkeypatch):
    """The deadlines' clock, which stands still; `clock.now` [s] moves it."""
    found = SimpleNamespace(now=0.0, monotonic=lambda: found.now)
    monkeypatch.setattr(deadlines, "time", found)
    return found


def test_the_steps_of_a_frame_are_counted_together_and_what_lies_between_them_is_not(tmp_path, clock):
    def steps(seconds):
        for each in seconds:
            clock.now += each
            yield

    deadline = Deadline(1000.0, tmp_path / "late.txt", "mark")
    for _ in deadline.within(partial(steps, [300.0] * 3)):
        clock.now += 500
    with pytest.raises(TimeoutError, match="the frame took 1200.0 s so far, --frame-limit 1000$"):
        list(deadline.within(partial(steps, [400.0] * 5)))
    with pytest.raises(TimeoutError, match="took 1001.0 s"):  # the last step too
        list(deadline.within(lambda: setattr(clock, "now", clock.now + 1001)))
    assert not list(tmp_path.iterdir()) and not deadlines._under_way


def test_what_raises_in_time_is_raised_and_leaves_no_alarm(tmp_path):
    def fails():
        raise ValueError("bad")
        yield

    with pytest.raises(ValueError, match="bad"):
        list(Deadline(1000.0, tmp_path / "late.txt", "mark").within(fails))
    assert not deadlines._under_way and not list(tmp_path.iterdir())


def test_a_trace_counts_for_what_it_was_left_by(tmp_path):
    trace = tmp_path / "late.txt"
    own = Deadline(1.0, trace, "mark")
    for text, late in (("mark\n", False), ("mark\nTimeout (0:00:02)!\nThread", True), ("other\nTimeout", False)):
        trace.write_text(text)
        assert (own.missed() is not None) == late


def test_frames_that_failed_keep_their_traces_and_blame_nobody_later(tmp_path):
    results = FrameFolders(tmp_path / "frames", Status.of(tmp_path), "make")
    trace = {number: results.folder(number) / "late.txt" for number in (1, 2, 3)}

    def ended(number):
        write_text(trace[number], f"{number:06d}\nTimeout (0:00:15)!\nThread")

    for number in (1, 2):  # one after the other
        ended(number)
        assert results.fail_late([1, 2, 3], LIMIT) is True
    assert results.fail_late([1, 2, 3], LIMIT) is None  # as when what is left is made by a later pass
    assert all(trace[number].exists() and results.reason(number) for number in (1, 2))
    ended(3)
    assert results.fail_late([1, 2, 3], LIMIT) is True and results.reason(3)
