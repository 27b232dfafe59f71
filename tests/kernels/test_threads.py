"""What several Python threads may do with the kernels at once: the bits of one thread, or an error that says why not."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.sparse as sp

from tests.support.kernel_calls import ball
from toile import kernels

TOGETHER = 3  # threads


def at_once(function, items):
    with ThreadPoolExecutor(TOGETHER, initializer=kernels.set_threads, initargs=(1,)) as pool:
        return list(pool.map(function, items))


def ended(program):
    """What a program prints that comes to its end by itself."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def refusals(work, other):
    """What `other`, called again and again, is refused with while a thread does `work`, and what that gives; where `other` was
    first, it is done again."""
    texts = set()

    def worked():
        while True:
            try:
                return work()
            except kernels.InputError:
                pass

    with ThreadPoolExecutor(1) as pool:
        working = pool.submit(worked)
        while not working.done():
            try:
                other()
            except kernels.InputError as error:
                texts.add(str(error))
        return texts, working.result()


def bilaplacian(subdivisions):
    """(n,n) positive definite, and (n,3) right sides."""
    V, F = ball(subdivisions=subdivisions)
    A = sp.csc_matrix(sp.eye(len(V)) - kernels.cotangent_laplacian(V, F))
    return sp.csc_matrix(A @ A), V


def test_a_factor_serves_threads_side_by_side_and_refuses_those_that_change_it_meanwhile():
    A, V = bilaplacian(4)
    factor = kernels.CholeskyFactor().factorize(A)
    once = factor.solve(V).tobytes()
    assert at_once(lambda _: factor.solve(V).tobytes(), range(4 * TOGETHER)) == [once] * 4 * TOGETHER
    texts, _ = refusals(lambda: factor.solve(np.tile(V, 400)), lambda: factor.factorize(A))
    assert all(text.startswith("cholesky: another thread is at work on this object") for text in texts) and texts
    assert factor.solve(V).tobytes() == once


def test_large_matrices_are_ordered_by_threads_as_by_one():
    """METIS draws from random numbers of the C library, which threads share: each factor had other bits."""
    A, V = bilaplacian(6)
    factorised = lambda _: kernels.CholeskyFactor().factorize(A).solve(V[:, :1]).tobytes()
    assert len(set(at_once(factorised, range(TOGETHER)))) == 1


def test_a_handler_of_signals_serves_again_and_again_after_a_large_matrix_was_ordered():
    """METIS gave it back as one that serves once: the second SIGTERM ended the process at once."""
    program = """
import os, signal
from tests.kernels.test_threads import bilaplacian
from toile import kernels
signal.signal(signal.SIGTERM, lambda *_: print("heard"))
kernels.CholeskyFactor().factorize(bilaplacian(6)[0])
for _ in range(2):
    os.kill(os.getpid(), signal.SIGTERM)
"""
    assert ended(program) == "heard\n" * 2


def test_a_thread_that_computes_for_ever_does_not_abort_the_program_that_ends():
    """Python 3.11 unwinds a thread that asks for its lock then; a destructor of the core was in the way."""
    program = """
import threading, time
from tests.support.kernel_calls import nricp, nricp_solver
solver, begun = nricp_solver(), threading.Event()
def work():
    begun.set()
    while True:
        nricp(solver)
threading.Thread(target=work, daemon=True).start()
begun.wait()
time.sleep(0.05)
"""
    ended(program)
