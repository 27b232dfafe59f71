"""What several Python threads may do with the kernels at once: the bits of one thread, or an error that says why not."""

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy.sparse as sp
from threadpoolctl import threadpool_limits

from tests.support.kernel_calls import CALLS, SOLVERS, ball, bits, drape, drape_solver, tube, untangle_solver
from toile import _core, kernels
from toile.io.body import load_body_model

TOGETHER = 3  # threads


def at_once(function, items):
    with ThreadPoolExecutor(TOGETHER, initializer=kernels.set_threads, initargs=(1,)) as pool:
        return list(pool.map(function, items))


def ended(program):
    """What a program prints that comes to its end by itself."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_threads_get_the_bits_of_one_from_solvers_of_their_own(call):
    once = bits(call(CALLS[call]()))
    assert at_once(lambda _: bits(call(CALLS[call]())), range(TOGETHER)) == [once] * TOGETHER


@pytest.mark.parametrize("call", [call for call in SOLVERS if call is not drape], ids=lambda call: call.__name__)
def test_threads_get_the_bits_of_one_from_a_solver_that_they_share(call):
    once, shared = bits(call(SOLVERS[call]())), SOLVERS[call]()
    assert at_once(lambda _: bits(call(shared)), range(2 * TOGETHER)) == [once] * 2 * TOGETHER


def test_frames_of_several_threads_do_not_meet_in_an_untangler_that_they_share():
    """Its trees and its membrane hold the frame under way: two at once ended the process."""
    frames = [(tube()[0] * [1, 1, size], ball()[0] + [shift, 0, 0]) for size in (1, 1.1) for shift in (0, 0.01, 0.02)]
    alone, shared = [bits(untangle_solver().solve(*frame)) for frame in frames], untangle_solver()
    assert at_once(lambda frame: bits(shared.solve(*frame)), frames) == alone


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


def test_a_step_of_a_cloth_is_refused_while_another_thread_steps_it():
    """A step goes on from the last: steps of two threads are of no sequence, and two at once mixed their cloths."""
    (V, _), (body_V, _) = tube(), ball()
    solvers = drape_solver(), drape_solver()
    for solver in solvers:
        solver.start(V, body_V, settle=0)
    nowhere = np.full_like(body_V, np.nan)  # is refused by itself, and moves nothing
    step = lambda solver: bits(solver.step(body_V, 0.2))
    texts, stepped = refusals(lambda: step(solvers[0]), lambda: solvers[0].step(nowhere, 0.2))
    assert any(text.startswith("drape: another thread is at work on this object") for text in texts)
    assert stepped == step(solvers[1])


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


def test_a_factor_has_the_bits_of_one_thread_of_blas_whatever_was_set_since_it_was_made():
    """As by a registration in another thread, which ends and puts its caller's number back."""
    A, V = bilaplacian(5)
    factor = kernels.CholeskyFactor()
    once = factor.factorize(A).solve(V).tobytes()
    with threadpool_limits(4, "blas"):
        assert factor.factorize(A).solve(V).tobytes() == once


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


def test_a_guess_of_a_fusion_is_whole_or_refused_while_another_thread_steps_it():
    body = load_body_model()
    solver = kernels.InnerSolver(body, np.zeros(4), rounds=1, max_iterations=2)
    frame = np.zeros((len(body.J), 3)), np.zeros(3), body.v_template, np.ones(len(body.v_template)), []

    def guesses(fusion):
        made = []
        while not fusion.done:
            made.append(fusion.guess)
            fusion.step(solver.gather([frame], made[-1]))
        return made

    known, fusion, read = [bits(guess) for guess in guesses(solver.fusion())], solver.fusion(), []
    texts, _ = refusals(
        lambda: [solver.gather([frame], fusion.guess), guesses(fusion)], lambda: read.append(fusion.guess)
    )
    assert all(text.startswith("inner: another thread is at work on this object") for text in texts)
    assert all(bits(guess) in [*known, bits(fusion.guess)] for guess in read)


def test_a_hundred_thousand_trees_may_be_alive():
    """Each had a device of its own, with one of the 1024 keys for storage of threads that a process has."""
    V, F = np.eye(3), np.array([[0, 1, 2]], np.int32)
    kept = [_core.SurfaceIndex(V, F) for _ in range(100_000)]
    assert kept[-1].closest(V, 1.0, np.zeros(0, np.int32))[3].max() == 0


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


def test_views_live_as_long_as_a_call_reads_them():
    """Where another thread emptied the list of views, a kernel read memory that was free."""
    V, F = ball()
    K, T = np.array([[200.0, 0, 128], [0, 200, 128], [0, 0, 1]]), np.eye(4)
    view = lambda: _core.View(K, np.zeros(5), T, np.full((256, 256), 9.0), np.ones((256, 256, 8), np.float32), [0, 0])
    asked = lambda views: _core.view_odds(
        views, np.tile(V + [0, 0, 2], (40, 1)), np.tile(-V, (40, 1)), 2, 0, np.ones(40 * len(V), np.int32)
    )
    views = [view() for _ in range(8)]
    either = asked(views).tobytes(), asked([]).tobytes()
    for delay in (0.002, 0.005, 0.01, 0.02):
        with ThreadPoolExecutor(1) as pool:
            asking = pool.submit(asked, views)
            time.sleep(delay)
            views.clear()
        assert asking.result().tobytes() in either
        views = [view() for _ in range(8)]


def test_a_view_that_is_none_is_refused():
    with pytest.raises(TypeError):
        _core.view_odds([None], np.zeros((1, 3)), np.ones((1, 3)), 2, 0, np.ones(1, np.int32))


@pytest.mark.skipif(sys.version_info >= (3, 13), reason="the module that makes sub-interpreters has another name")
def test_a_sub_interpreter_is_refused():
    """pybind11 waited there for ever."""
    program = """
import _xxsubinterpreters as interpreters
interpreters.run_string(interpreters.create(), '''
try:
    from toile import _core
except ImportError as error:
    print(error)
''')
"""
    assert "main interpreter" in ended(program)
