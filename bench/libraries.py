"""Where a library could stand in for code of ours: remeshing, boundary loops, the skeleton's least squares.

    python -m bench.libraries

Prints what docs/measurements/libraries.md records. Needs the built core (`make setup`) and, for the last two, a compiler,
libopenmesh-dev and libceres-dev: their programs lie in bench/cpp.
"""

import importlib.util
import subprocess
import sys
import sysconfig
import time
from pathlib import Path

import numpy as np
import pybind11

from toile import kernels
from toile.io.body import load_body_model
from toile.kernels.skeleton import JOINT_LIMIT, JOINT_SIGMA, OTHER_LIMIT, OTHER_SIGMA, by_prefix
from toile.stages.template import cut
from toile.studio.remeshing import remesh as by_pymeshlab

ROOT = Path(__file__).parents[1]
FLAGS = "-std=c++20 -O3 -march=x86-64-v3 -ffp-contract=off -DNDEBUG -fPIC -shared -fvisibility=hidden -fopenmp".split()


def built(name, *libraries):
    """The module bench/cpp/NAME.cpp, compiled against the core in build/."""
    target = ROOT / "build" / f"{name}{sysconfig.get_config_var('EXT_SUFFIX')}"
    source, core = ROOT / "bench/cpp" / f"{name}.cpp", ROOT / "build/libtoile_core.a"
    if not target.exists() or target.stat().st_mtime < max(source.stat().st_mtime, core.stat().st_mtime):
        include = [ROOT / "cpp", "/usr/include/eigen3", pybind11.get_include(), sysconfig.get_path("include")]
        link = [*libraries, "-lgmp", "-lmpfr", "-lembree3", "-lcholmod", "-ldl"]
        subprocess.run(["c++", *FLAGS, *(f"-I{i}" for i in include), source, core, *link, "-o", target], check=True)
    spec = importlib.util.spec_from_file_location(name, target)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def garment_of(body):
    """A shirt's worth of the packaged body, cut open: uneven triangles and five loops."""
    V, F = body.v_template, body.f
    height = (V[:, 2] - V[:, 2].min()) / np.ptp(V[:, 2])
    V, F = cut(V, F, np.minimum(np.minimum(height - 0.45, 0.82 - height), 0.45 - np.abs(V[:, 0])), 0.0)
    part = kernels.vertex_components(F, len(V))[F[:, 0]]
    used, F = np.unique(F[part == np.bincount(part).argmax()], return_inverse=True)
    return V[used], F.reshape(-1, 3).astype(np.int32)


def to_polylines(points, V, loops):
    """Distances (k,) [m] of points to closed polylines."""
    best = np.full(len(points), np.inf)
    for loop in loops:
        a, d = V[loop], np.roll(V[loop], -1, 0) - V[loop]
        r = points[:, None] - a
        s = np.clip(np.einsum("kmi,mi->km", r, d) / np.einsum("mi,mi->m", d, d), 0, 1)
        best = np.minimum(best, np.linalg.norm(s[..., None] * d - r, axis=2).min(1))
    return best


def measure_remeshing(V, F):
    print(f"remeshing of {len(V)} vertices, {len(F)} faces")
    for edge in (0.02, 0.012, 0.006):
        for name, remesh in (("pymeshlab", by_pymeshlab), ("CGAL", kernels.remesh)):
            remesh(V, F, edge)
            begin = time.perf_counter()
            X, G = remesh(V, F, edge)
            seconds = time.perf_counter() - begin
            E = kernels.unique_edges(G)
            side = np.linalg.norm(X[E[:, 0]] - X[E[:, 1]], axis=1)
            border = to_polylines(X[kernels.border_vertices(G, len(X))], V, kernels.boundary_loops(F))
            back = to_polylines(V[kernels.border_vertices(F, len(V))], X, kernels.boundary_loops(G))
            surface = kernels.SurfaceIndex(X, G).closest(V)[3]
            print(
                f"  edge {edge * 1e3:4.0f} mm {name:9s} {seconds:6.2f} s, {len(X):6d} vertices, side / edge {side.mean() / edge:.3f}"
                f" spread {side.std() / side.mean():.3f}, border off the old one {border.max() * 1e3:.3f} mm at most, old"
                f" border off the new {back.mean() * 1e3:.3f} mm, old vertices off the new surface {surface.mean() * 1e3:.3f} mm"
            )


def measure_loops(V, F):
    module = built("boundary_loops", "-lOpenMeshCore")
    rng = np.random.default_rng(0)
    large = kernels.remesh(V, F, 0.003)[1]
    wrong = large.copy()
    wrong[rng.permutation(len(large))[:20]] = wrong[rng.permutation(len(large))[:20]][:, ::-1]  # listed twice, turned
    for what, faces in (("sound", large), ("20 faces turned or repeated", wrong)):
        print(f"boundary loops of {len(faces)} faces, {what}")
        n = int(faces.max()) + 1
        for name in ("own", "openmesh", "cgal"):
            runs = [getattr(module, name)(faces, n) for _ in range(5)]
            _, loops, refused = runs[0]
            print(
                f"  {name:9s} {1e3 * np.median([r[0] for r in runs]):7.1f} ms, {len(loops)} loops, {refused} faces refused"
            )


def measure_skeleton(body):
    module = built("skeleton_ceres", "-lceres", "-lglog")
    sigma = by_prefix(body.joint_roles, JOINT_SIGMA, OTHER_SIGMA)
    limit = by_prefix(body.joint_roles, JOINT_LIMIT, OTHER_LIMIT)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        free = (sigma > 0.09) & np.isfinite(sigma)
        true = np.where(free[:, None], rng.normal(0, 0.1, (len(sigma), 3)), 0)
        shape = rng.normal(0, 0.5, body.shapedirs.shape[-1])
        rest, J = body.rest(shape)
        scan = body.skin(rest, J, true, np.zeros(3))
        for what, tolerance, most in (
            ("to the optimum", 1e-9, 100),
            ("one step, as after each renewal of the matches", 0, 1),
        ):
            for threads in (1, 2):
                kernels.set_threads(threads)
                pose = np.zeros_like(true), np.zeros(3), np.zeros(len(shape))
                rows = module.compare(body.core, sigma, limit, scan, body.f, *pose, 0.1, tolerance, most)
                print(
                    f"skeleton, seed {seed}, {rows[0][4]} matches, {rows[0][5]} unknowns, {what}, {threads} threads of ours"
                )
                for name, seconds, energy, steps, *_ in rows:
                    print(
                        f"  {name:30s} {seconds:7.3f} s ({seconds / rows[0][1]:5.2f} x own), energy {energy:.6f}, {steps} steps"
                    )


if __name__ == "__main__":
    kernels.set_threads(1)
    body = load_body_model()
    V, F = garment_of(body)
    chosen = sys.argv[1:] or ["remeshing", "loops", "skeleton"]
    if "remeshing" in chosen:
        measure_remeshing(V, F)
    if "loops" in chosen:
        measure_loops(V, F)
    if "skeleton" in chosen:
        measure_skeleton(body)
