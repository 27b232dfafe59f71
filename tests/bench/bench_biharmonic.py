"""biharmonic, a frame with a prepared factor, against igl.harmonic(V, F, b, bc, 2): the same process, times interleaved.

    python tests/bench/bench_biharmonic.py [--repeats 5] [--threads 2]

prints, for a shirt-like tube between two known loops: milliseconds (median) to prepare and to solve, the median of
igl's time over ours, and the distance of both answers from a refined one, relative to the largest displacement.
With pytest-benchmark: python -m pytest tests/bench/bench_biharmonic.py -o python_files='bench_*.py'
-o python_functions='bench_*', ratios in extra_info.
"""

import os
import sys

if __name__ == "__main__":  # the pool of threads is sized when it is loaded
    threads = sys.argv[sys.argv.index("--threads") + 1] if "--threads" in sys.argv else "2"
    os.environ["OMP_NUM_THREADS"] = threads

import argparse
import statistics
import time

import numpy as np
import pytest

from toile import kernels

SIZES = {"3k": (55, 55), "12k": (110, 110), "50k": (225, 225), "198k": (445, 445)}  # rings, vertices a ring


def tube(rings, around):
    """A dented tube open at both ends, 0.7 m high: V, F and the vertices of its two loops."""
    angle, z = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(0, 0.7, rings))
    r = 0.2 + 0.03 * np.sin(3 * angle + 4 * z) + 0.01 * np.cos(9 * z + angle)
    V = np.stack([r * np.cos(angle), 0.7 * r * np.sin(angle), z], -1).reshape(-1, 3)
    i = np.arange(rings * around).reshape(rings, around)
    j = np.roll(i, -1, axis=1)
    a, b, c, d = i[:-1].ravel(), j[:-1].ravel(), i[1:].ravel(), j[1:].ravel()
    return V, np.r_[np.c_[a, b, d], np.c_[a, d, c]], np.r_[i[0], i[-1]]


def problem(size):
    V, F, known = tube(*SIZES[size])
    noise = np.random.default_rng(0).normal(size=(len(known), 3))
    return V, F, known, 0.02 * np.sin(20 * V[known]) + 0.01 * noise


def race(V, F, known, D_known, repeats):
    import igl

    start = time.perf_counter()
    solver = kernels.BiharmonicSolver(V, F, known)
    prepare = time.perf_counter() - start
    ours, theirs = [], []
    for _ in range(repeats):
        start = time.perf_counter()
        D = solver.solve(D_known)
        middle = time.perf_counter()
        peer = igl.harmonic(V, F, known, D_known, 2)
        ours.append(middle - start)
        theirs.append(time.perf_counter() - middle)
    refined = kernels.BiharmonicSolver(V, F, known, accuracy=3e-12).solve(D_known)
    distance = lambda A: float(np.abs(A - refined).max() / np.abs(refined).max())
    return dict(prepare=prepare, toile=statistics.median(ours), igl=statistics.median(theirs), error=distance(D),
                igl_error=distance(peer), ratio=statistics.median(t / o for t, o in zip(theirs, ours)))  # fmt: skip


@pytest.mark.parametrize("size", SIZES)
def bench_biharmonic(benchmark, size):
    pytest.importorskip("igl")
    V, F, known, D_known = problem(size)
    benchmark.extra_info.update(race(V, F, known, D_known, 5))
    benchmark.pedantic(kernels.BiharmonicSolver(V, F, known).solve, [D_known], rounds=9, warmup_rounds=1)
    assert benchmark.extra_info["error"] <= 1e-8


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    kernels.set_threads(arguments.threads)
    for size in SIZES:
        meshes = problem(size)
        r = race(*meshes, arguments.repeats)
        print(f"{len(meshes[0]):6d} vertices: prepare {1e3 * r['prepare']:7.1f} ms, solve {1e3 * r['toile']:6.2f}, igl {1e3 * r['igl']:8.1f} = "
              f"{r['ratio']:.0f} x, errors {r['error']:.1e} and igl's {r['igl_error']:.1e}", flush=True)  # fmt: skip
