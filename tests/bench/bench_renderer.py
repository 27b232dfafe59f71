"""The differentiable renderer against the raster under it: a body of 27k triangles, and one with cloth before it.

    python tests/bench/bench_renderer.py [--repeats 20] [--threads 2]

prints milliseconds (median) of the raster alone, of forward, and of forward + backward (vertices and texture), and the
medians of their ratios to the raster in the same round.
With pytest-benchmark, ratios in extra_info:
    python -m pytest tests/bench/bench_renderer.py -o python_files='bench_*.py' -o python_functions='bench_*'
"""

import os
import sys

if __name__ == "__main__":  # the pool of threads is sized when it is loaded
    threads = sys.argv[sys.argv.index("--threads") + 1] if "--threads" in sys.argv else "2"
    os.environ["OMP_NUM_THREADS"] = threads

import argparse
import time

import numpy as np
import pytest

from toile import kernels

SIZES = (256, 512)
SCENES = ("body", "body and cloth", "body and cloth, layer depth")


def problem(size, scene):
    """-> {"raster": ..., "forward": ..., "forward + backward": ...}: functions without arguments."""
    import torch

    from tests.support import surfaces as shapes
    from toile.avatar.render.renderer import render

    meshes = [shapes.body()] + [shapes.sheet(60, turn=0.3)] * ("cloth" in scene)
    drawn = [shapes.surface(V, F, seed, size=512) for seed, (V, F) in enumerate(meshes)]
    K, T = shapes.camera(size)
    leaves = [leaf.requires_grad_() for s in drawn for leaf in (s.vertices, s.texture)]
    starts = np.cumsum([0] + [len(V) for V, _ in meshes])
    V = np.concatenate([V for V, _ in meshes]) + T[:3, 3].numpy()
    F = np.concatenate([F + n for (_, F), n in zip(meshes, starts)]).astype(np.int32)
    camera, target = K.double().numpy(), torch.rand(3, size, size, generator=torch.Generator().manual_seed(0))

    def forward():
        return render(drawn, K, T, (size, size), layer_depth="layer depth" in scene)

    def both_ways():
        seen = forward()
        depth = torch.where(seen.depth.isfinite(), seen.depth, 0.0)
        loss = (seen.image - target).abs().mean() + (seen.mask - target[0]).abs().mean() + depth.mean()
        torch.autograd.grad(loss, leaves)

    raster = lambda: kernels.raster(V, F, camera, (size, size))
    return {"raster": raster, "forward": forward, "forward + backward": both_ways}


def race(functions, repeats):
    """Medians [s], and the medians of the ratios to the raster of the same round."""
    seconds = {name: [] for name in functions}
    for function in functions.values():
        function()
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - start)
    ratios = {name: np.median(np.divide(s, seconds["raster"])) for name, s in seconds.items()}
    return {name: (float(np.median(s)), float(ratios[name])) for name, s in seconds.items()}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("size", SIZES)
def bench_renderer(benchmark, size, scene):
    pytest.importorskip("torch")
    functions = problem(size, scene)
    result = race(functions, 9)
    benchmark.extra_info.update({name: ratio for name, (_, ratio) in result.items() if name != "raster"})
    benchmark.pedantic(functions["forward + backward"], rounds=5)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    kernels.set_threads(arguments.threads)
    for size in SIZES:
        for scene in SCENES:
            result = race(problem(size, scene), arguments.repeats)
            figures = (f"{name} {1e3 * s:6.1f} ms ({ratio:4.1f} x)" for name, (s, ratio) in result.items())
            print(f"{size} px, {scene:28s}" + "   ".join(figures), flush=True)
