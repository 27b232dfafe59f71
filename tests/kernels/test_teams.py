"""Factorising on several threads at once leaves the OpenMP runtime as it was, whichever of two runtimes serves."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

BINDINGS = Path(__file__).parents[2] / "cpp" / "bind"

PROGRAM = """
import ctypes
from concurrent.futures import ThreadPoolExecutor
{first}
import numpy as np
from toile import kernels
from tests.support.shapes import sphere

runtime = ctypes.CDLL("libgomp.so.1")  # the one that is loaded: torch brings its own
before = runtime.omp_get_max_active_levels()
V, F = sphere(12, 16)
loop = np.arange(3, dtype=np.int32)
with ThreadPoolExecutor(4) as pool:
    list(pool.map(lambda _: kernels.BiharmonicSolver(V, F, loop).solve(np.zeros((3, 3))), range(200)))
assert before > 0 and runtime.omp_get_max_active_levels() == before
"""


@pytest.mark.parametrize("first", ["", "import torch"])
def test_threads_that_factorise_together_leave_every_other_its_team(first):
    """With the level left at 0 no kernel had a second thread, and torch waited for ever for one that never came."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(first=first)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


TRAINING = """
import torch
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from toile import kernels
from tests.support.shapes import sphere

V, F = sphere(20, 30)
loop = np.arange(24, dtype=np.int32)
layer, picture = torch.nn.Conv2d(16, 16, 3), torch.rand(4, 16, 64, 64)
with ThreadPoolExecutor(4) as pool:
    solved = pool.map(lambda _: kernels.biharmonic(V, F, loop, np.ones((24, 3))), range(100))
    for _ in range(30):
        layer(picture).sum().backward()
    list(solved)
"""


def test_a_training_beside_threads_that_factorise_comes_back():
    """While one factorised, torch's team was of one thread, which waited for ever for the second."""
    done = subprocess.run([sys.executable, "-c", TRAINING], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


MAKING = """
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from toile import _core

V, F = np.eye(3), np.array([[0, 1, 2]], np.int32)


def make(kind):
    for _ in range(40):
        [kind() for _ in range(200)]


with ThreadPoolExecutor(4) as pool:
    list(pool.map(make, [lambda: _core.SurfaceIndex(V, F), _core.CholeskyFactor] * 12))
"""


def test_threads_that_make_objects_together_lose_none_of_them():
    """pybind11's table of objects was written without the interpreter's lock; the process aborted when an object went."""
    done = subprocess.run([sys.executable, "-c", MAKING], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("binding", sorted(BINDINGS.glob("*.cpp")), ids=lambda path: path.stem)
def test_no_constructor_is_bound_under_a_guard_that_releases_the_lock(binding):
    """A factory that returns a holder is registered with pybind11 under the guard; one in its body ends before."""
    assert not re.search(r"py::init[<(](?:(?!\.def).)*(?:\bfree\b|call_guard)", binding.read_text(), re.DOTALL)
