"""What each method does with ugly variants of an easy problem: right, degraded, silently wrong, refused or crashed.

    python -m bench.extremes [--kernel nricp ...] [--out FILE]      # minutes; prints tables in Markdown

Each case runs in a process of its own. The rows are those of tests/extremes; `good` variants have an answer (that of the
clean problem), `bad` ones have none: to refuse is right, and to return numbers is silently wrong.
"""

import argparse
import json
import os
import subprocess
import sys

import numpy as np

from tests.extremes import ugly

TIMEOUT = 120  # s
RIGHT, DEGRADED = 1.25, 4.0  # of the same method's error on the clean problem


# --- problems: a clean one, and the error of an answer, less is better -------------------------------------------------
def egg(subdivisions):
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    d = np.array(sphere.vertices)
    return d * [0.3, 0.4, 0.6] * (1 + 0.15 * np.sin(4 * d[:, :1] + 1) * np.cos(3 * d[:, 1:2])), np.array(
        sphere.faces, np.int32
    )


def bend(V):
    return V + 0.04 * np.c_[V[:, 2] ** 2, 0.5 * np.sin(2 * V[:, 2]), -V[:, 0] * V[:, 2]]


def register():
    (V, F), (scan_V, scan_F) = egg(3), egg(4)
    return dict(src_v=V, src_f=F, tgt_v=bend(scan_V), tgt_f=scan_F)


def register_error(x):
    """Mean distance to the truth [mm]; the start's is 20."""
    truth = bend(egg(3)[0])
    return 1e3 * np.linalg.norm(x[: len(truth)] - truth, axis=1).mean()


def tube():
    a, z = np.meshgrid(2 * np.pi * np.arange(24) / 24, np.linspace(0, 1, 20))
    r = 0.3 + 0.05 * np.sin(3 * a + 4 * z)
    V = np.stack([r * np.cos(a), 0.7 * r * np.sin(a), z], -1).reshape(-1, 3)
    at = np.arange(480).reshape(20, 24)
    right = np.roll(at, -1, 1)
    F = np.concatenate([np.stack([at[:-1], right[:-1], right[1:]], -1), np.stack([at[:-1], right[1:], at[1:]], -1)])
    known = np.r_[at[:2].ravel(), at[-2:].ravel()]
    return dict(V=V, F=F.reshape(-1, 3), known=known, D_known=0.05 * np.sin(3 * V[known] + V[known][:, [1, 2, 0]]))


def tube_error(x):
    """Largest difference to the clean answer over the largest displacement; 1e-2 is the least that counts."""
    from .kernel_problems import harmonic_reference

    clean = harmonic_reference(tube())
    return max(1e-2, np.abs(x[: len(clean)] - clean).max() / 0.05)


def labelling(labels=5):
    rng = np.random.default_rng(0)
    at = np.arange(1200).reshape(30, 40)
    edges = np.vstack([np.c_[at[:, :-1].ravel(), at[:, 1:].ravel()], np.c_[at[:-1].ravel(), at[1:].ravel()]])
    truth = rng.integers(0, labels, (3, 4))[at // 40 // 10, at % 40 // 10].ravel()
    unary = rng.uniform(0, 1, (1200, labels))
    unary[np.arange(1200), truth] -= 0.3
    return dict(unary=unary, edges=edges.astype(np.int32), weights=rng.uniform(0.1, 0.4, len(edges)))


def labelling_error(x):
    """Energy above the clean problem's, as 1 + 100 x its share: 1 % counts as twice the error."""
    from toile.kernels import mrf

    problem = labelling()
    i, j = problem["edges"].T
    least = mrf(**problem).energy
    energy = problem["unary"][np.arange(1200), x].sum() + problem["weights"][x[i] != x[j]].sum()
    return 1 + 100 * max(0.0, energy / least - 1)


def shell():
    import trimesh
    from scipy.spatial.transform import Rotation

    def ball(radius):
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
        return np.array(mesh.vertices), np.array(mesh.faces, np.int32)

    (V, F), (body_V, body_F) = ball(0.192), ball(0.2)
    return dict(
        cloth_v=V @ Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix().T, cloth_f=F, body_v=body_V, body_f=body_F
    )


def shell_error(x):
    """1 + vertices of the clean cloth nearer than 1.8 mm or inside + pairs of triangles that intersect."""
    from toile.kernels import intersecting_pairs, signed_distance

    p = shell()
    x = x[: len(p["cloth_v"])]
    short = (signed_distance(x, p["body_v"], p["body_f"]) < 0.0018).sum()
    return 1.0 + short + len(intersecting_pairs(x, p["cloth_f"], p["body_v"], p["body_f"]))


# --- variants: problem -> problem, and the answer back ------------------------------------------------------------------
MESHES = {
    "register": [("src_v", "src_f"), ("tgt_v", "tgt_f")],
    "biharmonic": [("V", "F")],
    "untangle": [("cloth_v", "cloth_f"), ("body_v", "body_f")],
}


def same(x):
    return x


def on_meshes(spoil, only=None):
    def change(kernel, problem):
        for V, F in MESHES[kernel][only] if only else MESHES[kernel]:
            problem[V], problem[F] = spoil(problem[V], problem[F])
        return problem, same

    return change


def scaled(s):
    def change(kernel, problem):
        for V, _ in MESHES[kernel]:
            problem[V] = s * problem[V]
        problem["unit"] = s
        return problem, (lambda x: x / s) if kernel != "biharmonic" else same

    return change


def moved(offset):
    def change(kernel, problem):
        for V, _ in MESHES[kernel]:
            problem[V] = problem[V] + offset
        return problem, (lambda x: x - offset) if kernel != "biharmonic" else same

    return change


def edit(key, spoil):
    def change(kernel, problem):
        problem[key] = spoil(problem[key])
        return problem, same

    return change


def put(where, value):
    def spoil(array):
        array = np.array(array)
        array[where] = value
        return array

    return spoil


TARGET = slice(1, 2)
MESH_ROWS = {
    "kilometres": scaled(1e-3), "micrometres": scaled(1e6), "1 km from the origin": moved(1e3), "1000 km from the origin": moved(1e6),
    "zero-area faces": on_meshes(ugly.zero_area), "needles": on_meshes(ugly.needles), "a third of the faces twice": on_meshes(ugly.some_faces_twice),
    "each face and its reverse": on_meshes(ugly.both_sides), "isolated vertices": on_meshes(ugly.isolated),
    "non-manifold edges": on_meshes(ugly.non_manifold),
}  # fmt: skip
GOOD = {
    "register": {
        **MESH_ROWS, "duplicate vertices: a seam": on_meshes(ugly.seam), "duplicate vertices: a soup": on_meshes(ugly.soup, TARGET),
        "several components": on_meshes(ugly.inner_component), "flipped target": on_meshes(ugly.flipped, TARGET),
        "target full of holes": on_meshes(ugly.round_holes, TARGET),
    },
    "biharmonic": {
        **MESH_ROWS, "all faces twice": on_meshes(ugly.all_faces_twice), "caps of no area": on_meshes(ugly.caps),
        "flipped faces": on_meshes(ugly.tenth_flipped),
    },
    "mrf": {
        "costs x 1e-12": lambda k, p: (p | dict(unary=1e-12 * p["unary"], weights=1e-12 * p["weights"]), same),
        "costs x 1e12": lambda k, p: (p | dict(unary=1e12 * p["unary"], weights=1e12 * p["weights"]), same),
        "1e9 added to each node": edit("unary", lambda u: u + 1e9),
        "a label that costs 1e15": edit("unary", lambda u: np.c_[u, np.full(len(u), 1e15)]),
        "a label that costs 1e300": edit("unary", lambda u: np.c_[u, np.full(len(u), 1e300)]),
        "59 labels more": edit("unary", lambda u: np.c_[u, np.full((len(u), 59), 5.0)]),
        "edges in two halves": lambda k, p: (p | dict(edges=np.vstack([p["edges"]] * 2), weights=np.tile(p["weights"] / 2, 2)), same),
        "edges of weight zero": lambda k, p: (p | dict(edges=np.vstack([p["edges"], [[0, 999]]]), weights=np.r_[p["weights"], 0]), same),
        "an isolated node": lambda k, p: (p | dict(unary=np.vstack([p["unary"], np.zeros(5)])), lambda x: x[:1200]),
    },
    "untangle": {
        **MESH_ROWS, "several components": on_meshes(ugly.far_component), "flipped body": on_meshes(ugly.flipped, TARGET),
        "a tenth of the body flipped": on_meshes(ugly.tenth_flipped, TARGET),
    },
}  # fmt: skip
BAD = {
    "register": {
        "NaN in the target": edit("tgt_v", put((7, 1), np.nan)), "infinity in the template": edit("src_v", put((7, 1), np.inf)),
        "empty target": edit("tgt_f", lambda F: F[:0]), "target 100 m away": edit("tgt_v", lambda V: V + 100),
        "index out of range": edit("tgt_f", put((5, 1), 10**6)),
    },
    "biharmonic": {
        "NaN in the mesh": edit("V", put((7, 1), np.nan)), "NaN in the displacement": edit("D_known", put((7, 1), np.nan)),
        "nothing known": lambda k, p: (p | dict(known=p["known"][:0], D_known=p["D_known"][:0]), same),
        "a part with nothing known": on_meshes(ugly.far_component), "index out of range": edit("F", put((5, 1), 10**6)),
    },
    "mrf": {
        "NaN cost": edit("unary", put((7, 1), np.nan)), "infinite weight": edit("weights", put(7, np.inf)),
        "negative weight": edit("weights", put(7, -1.0)), "index out of range": edit("edges", put((5, 1), 10**6)),
        "edge from a node to itself": edit("edges", put(5, 3)),
    },
    "untangle": {
        "NaN in the cloth": edit("cloth_v", put((7, 1), np.nan)), "NaN in the body": edit("body_v", put((7, 1), np.nan)),
        "empty body": edit("body_f", lambda F: F[:0]), "index out of range": edit("body_f", put((5, 1), 10**6)),
    },
}  # fmt: skip
PROBLEMS = {
    "register": (register, register_error), "biharmonic": (tube, tube_error), "mrf": (labelling, labelling_error), "untangle": (shell, shell_error),
}  # fmt: skip


# --- methods ----------------------------------------------------------------------------------------------------------
def toile_register(p):
    from toile.kernels import nricp

    result = nricp(p["src_v"], p["src_f"], p["tgt_v"], p["tgt_f"])
    if result.stop == "no_overlap":
        raise ValueError("stop = no_overlap")
    return result.V


def toile_tracker(p):
    from toile.kernels import NricpTracker

    tracker = NricpTracker(p["src_v"], p["src_f"])
    tracker.next(p["src_v"], p["src_f"])  # where it is, then where it went
    result = tracker.next(p["tgt_v"], p["tgt_f"])
    if result.stop == "no_overlap":
        raise ValueError("stop = no_overlap")
    return result.V


def toile_untangle(p):
    from toile.kernels import untangle

    unit = p.get("unit", 1.0)
    lengths = dict(margin=0.002 * unit, spread=0.03 * unit, max_depth=0.05 * unit)
    result = untangle(p["cloth_v"], p["cloth_f"], p["body_v"], p["body_f"], **lengths)
    if result.stop != "clear":
        raise ValueError(f"stop = {result.stop}: {result.reason}")
    return result.V


def toile_biharmonic(p):
    from toile.kernels import biharmonic

    return biharmonic(p["V"], p["F"], p["known"], p["D_known"])


def toile_mrf(p):
    from toile.kernels import mrf

    return mrf(p["unary"], p["edges"], p["weights"]).labels


def open3d_push(p):
    from . import peers

    peers.MARGIN = 0.002 * p.get("unit", 1.0)
    return peers.open3d_push(p)


def peer(name):
    def run(p):
        from . import peers

        return getattr(peers, name)(p)

    return run


METHODS = {
    "register": {"toile": toile_register, "NricpTracker": toile_tracker, "trimesh": peer("trimesh_amberg")},
    "biharmonic": {"toile": toile_biharmonic, "igl": peer("igl_harmonic")},
    "mrf": {"toile": toile_mrf, "gco": peer("gco_expansion"), "PyMaxflow": peer("pymaxflow_expansion")},
    "untangle": {"toile": toile_untangle, "open3d": open3d_push},
}


# --- one case, and all ------------------------------------------------------------------------------------------------
def one(kernel, variant, method):
    """{"error"} or {"exception"}; NaN answers have infinite error."""
    make, score = PROBLEMS[kernel]
    problem, back = make(), same
    if variant != "clean":
        problem, back = (GOOD[kernel] | BAD[kernel])[variant](kernel, problem)
    try:
        x = np.asarray(METHODS[kernel][method](problem))
    except Exception as e:
        return dict(exception=type(e).__name__, message=str(e))
    x = back(x)
    shared = x[: len(make().get("src_v", x))]
    return dict(error=float(score(x)) if np.isfinite(shared).all() else float("inf"))


def in_process(kernel, variant, method):
    command = [sys.executable, "-m", "bench.extremes", "--one", kernel, variant, method]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, env=os.environ | {"OMP_NUM_THREADS": "2"}
        )
    except subprocess.TimeoutExpired:
        return dict(crash=f"more than {TIMEOUT} s")
    lines = [line for line in done.stdout.splitlines() if line.startswith('{"')]
    return (
        json.loads(lines[-1])
        if lines
        else dict(crash=f"signal {-done.returncode}" if done.returncode < 0 else f"exit {done.returncode}")
    )


NAMES = ("nan", "finite", "empty", "range", "index", "no_overlap", "known", "negative", "itself", "hold", "beyond")


def verdict(found, clean, good):
    if "crash" in found:
        return "**crashed** (" + found["crash"] + ")"
    if "exception" in found:
        kind, message = found["exception"], " ".join(found["message"].split())[:60].replace("|", "/")
        if message.startswith("stop = "):
            return f"said (`{message}`)"
        clear = kind == "InputError" or any(name in (kind + message).lower() for name in NAMES)
        return ("refused" if clear else "unrelated exception") + f" (`{kind}: {message}`)"
    if not np.isfinite(found["error"]):
        return "NaN without a word"
    if not good:
        return "**silently wrong**: an answer"
    factor = found["error"] / clean["error"]
    if factor <= RIGHT:
        return "right"
    return f"degraded {factor:.1f} x" if factor <= DEGRADED else f"**silently wrong** {factor:.3g} x"


def table(kernel):
    methods = METHODS[kernel]
    clean = {m: in_process(kernel, "clean", m) for m in methods}
    yield (
        f"| {kernel} | " + " | ".join(f"{m} (clean: {clean[m].get('error', float('nan')):.3g})" for m in methods) + " |"
    )
    yield "|---" * (len(methods) + 1) + "|"
    for rows, good in ((GOOD[kernel], True), (BAD[kernel], False)):
        for variant in rows:
            yield (
                f"| {variant} | "
                + " | ".join(verdict(in_process(kernel, variant, m), clean[m], good) for m in methods)
                + " |"
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--one", nargs=3, metavar=("KERNEL", "VARIANT", "METHOD"))
    parser.add_argument("--kernel", nargs="*", default=list(PROBLEMS), choices=list(PROBLEMS))
    parser.add_argument("--out", default="-")
    args = parser.parse_args()
    if args.one:
        print(json.dumps(one(*args.one)))
        return
    with open(args.out, "w") if args.out != "-" else sys.stdout as out:
        for kernel in args.kernel:
            for line in table(kernel):
                print(line, file=out, flush=True)
            print(file=out)


if __name__ == "__main__":
    main()
