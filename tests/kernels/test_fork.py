"""After a kernel ran, a forked child computes the same bits, on one thread, and ends."""

import faulthandler
import gc
import multiprocessing
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.support.kernel_calls import CALLS, ball, bits, nricp, nricp_solver
from toile import kernels
from toile.vision.threads import parallel_map

SECONDS = 300  # a child that waits for threads that are not there waits for ever
TOLD = SECONDS - 20  # when such a child says where it stands


def in_forked_child(function):
    """function() in a child of os.fork; fails when the child does not answer in time."""
    gc.collect()  # garbage of other libraries, such as a film's decoder, waits for its threads where it is thrown away
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        gc.disable()
        faulthandler.dump_traceback_later(TOLD, file=sys.__stderr__)
        try:
            with os.fdopen(writer, "wb") as pipe:
                pickle.dump(function(), pipe)
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        answered = select.select([pipe], [], [], SECONDS)[0]
        if not answered:
            os.kill(child, signal.SIGKILL)
        answer = pipe.read()
    os.waitpid(child, 0)
    assert answered, f"the forked child did not answer in {SECONDS} s"
    return pickle.loads(answer)


@pytest.fixture(autouse=True)
def two_threads(threads):
    threads(2)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_forked_child_gives_the_bits_of_its_parent(call):
    solver = CALLS[call]()
    once = bits(call(solver))
    assert in_forked_child(lambda: bits(call(solver))) == once, "with the parent's solver"
    assert in_forked_child(lambda: bits(call(CALLS[call]()))) == once, "with a solver made in the child"


def test_a_solver_that_was_at_work_at_the_fork_is_refused_in_the_child():
    """What another thread was changing stays half changed, and what it held stays held: the child waited for ever."""
    solver, done = nricp_solver(), threading.Event()

    def work():
        while not done.is_set():
            nricp(solver)

    def outcome():
        try:
            return bits(nricp(solver))
        except kernels.InputError as error:
            return str(error)

    once, told = bits(nricp(solver)), []
    with ThreadPoolExecutor(1) as pool:
        pool.submit(work)
        while not told or told[-1] == once:  # forked between two solves
            time.sleep(0.03)
            told.append(in_forked_child(outcome))
        done.set()
    assert told[-1] == "nricp: another thread was at work on this solver when the process was forked; make it anew"


def test_children_that_are_forked_while_threads_build_trees_build_theirs():
    """Embree makes a device under a lock; a child that needed one of its own waited for the thread that held it."""
    program = """
import os, signal, threading
from tests.support.kernel_calls import ball
from toile import kernels
(V, F), done = ball(subdivisions=2), threading.Event()
def build():
    while not done.is_set():
        kernels.SurfaceIndex(V, F).closest(V)
threads = [threading.Thread(target=build) for _ in range(2)]
for thread in threads:
    thread.start()
ended = True
for _ in range(60):
    child = os.fork()
    if child == 0:
        signal.alarm(10)
        kernels.SurfaceIndex(V, F).closest(V)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        ended = False
        break
done.set()
raise SystemExit(not ended)
"""
    root = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", program], timeout=SECONDS, cwd=root).returncode == 0


def test_a_forked_child_has_one_thread_whatever_is_asked_for():
    _inside()
    assert in_forked_child(lambda: (kernels.set_threads(4), kernels.threads())) == (None, 1)
    assert kernels.threads() == 2


def test_work_spread_over_threads_ends_in_a_forked_child():
    parallel_map(abs, range(4))
    assert in_forked_child(lambda: parallel_map(abs, [-1, -2, -3])) == [1, 2, 3]


def test_forked_children_of_multiprocessing_give_the_bits_of_their_parent():
    once = _inside()
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.apply_async(_inside).get(SECONDS) == once


def test_a_forked_child_ends_as_programs_do():
    program = """
import os, sys
from tests.support.kernel_calls import CALLS, closest
from toile import kernels
kernels.set_threads(2)
index = CALLS[closest]()
closest(index)
child = os.fork()
closest(index)
if child:
    sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    root = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", program], timeout=SECONDS, cwd=root).returncode == 0


def _inside():
    V, F = ball()
    return kernels.winding_number(1.01 * V, V, F).tobytes()
