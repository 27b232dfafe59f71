"""Factorising on several threads at once leaves the OpenMP runtime as it was, whichever of two runtimes serves."""

import subprocess
import sys

import pytest

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
