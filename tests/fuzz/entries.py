"""Every function of toile.kernels that takes arrays: how to draw its arguments, and what its result must be.

An entry is (draw, run): `draw(d)` makes keyword arguments, `run(**arguments)` calls and asserts the law: finite results
of the right shape. Whether an exception is a lawful one is for the caller to judge.
"""

import numpy as np
import scipy.sparse as sp

from toile import kernels

from .bodies import draw_inner, draw_skeleton, run_inner, run_skeleton
from .laws import finite, rows, within
from .queries import (
    draw_cholesky,
    draw_closest,
    draw_inside,
    draw_mesh,
    draw_pairs,
    draw_sight,
    draw_topology,
    run_cholesky,
    run_closest,
    run_inside,
    run_operators,
    run_pairs,
    run_sight,
    run_topology,
)

NRICP_OPTIONS = dict(
    large_motion=[True, False], rebase=[True, False], passes=range(1, 3), fine_iterations=range(0, 4), fine_sweeps=range(1, 6),
    relative_fine_length=(1e-4, 1e2), fine_noise=(1e-3, 1e3), relative_fine_robust=(1e-5, 1e3), phong=(1e-3, 2), point_weight=(1e-6, 1),
    boundary_weight=(1e-6, 1e6), border_weight=(1e-6, 1e6), rotation_weight=(1e-8, 1e8), min_overlap=(1e-6, 1), exposure=(1e-3, 1),
)  # fmt: skip
NRICP_LEVELS = dict(
    relative_radii=(5e-3, 10), stiffness_start=(1e-8, 1e12), stiffness_end=(1e-8, 1e12), relative_robust_start=(1e-4, 1e2), relative_robust_end=(1e-4, 1e2),
    reverse=(1e-4, 1e4), relative_spread=(1e-4, 1e2), relative_detail=(5e-3, 10),
)  # fmt: skip


def draw_nricp(d):
    plain_V, plain_F = d.mesh()
    V, F = d.dressed(plain_V, plain_F)
    if d.chance(0.7):  # a scan that fits
        size = np.abs(plain_V[np.isfinite(plain_V).all(1)]).max() if len(plain_V) else 1.0
        scan_V, scan_F = plain_V + 0.03 * size * np.sin(3 * plain_V[:, ::-1] / (size or 1)), plain_F
        scan_V, scan_F = d.pick(SPOIL_SCAN)(d, scan_V, scan_F)
    else:
        scan_V, scan_F = d.mesh()
    n, k = len(plain_V), int(d.rng.integers(1, 5))
    out = {"V": V, "F": F, "preset": d.pick(["draft", "standard", "fine"]), "options": d.options(**NRICP_OPTIONS)}
    if d.chance(0.2):
        levels = int(d.rng.integers(1, 4))
        for name, bounds in NRICP_LEVELS.items():
            out["options"][name] = [d.number(*bounds) for _ in range(levels + int(d.spoil(0.02)))]
        out["options"]["iterations"] = [d.whole(0, 4) for _ in range(levels)]
    frame = {}
    if d.chance(0.2):
        frame["start"] = d.layout(d.values(plain_V + 0.01 * d.rng.normal(size=3)))
    if d.chance(0.3) and n:
        W = sp.csr_matrix((np.ones(k), (np.arange(k), d.rng.integers(0, n, k))), shape=(k, n + int(d.spoil(0.05))))
        if d.spoil(0.1):
            W.data[0] = d.pick(UGLY_WEIGHTS)
        if d.spoil(0.05):
            W.indices = d.indices(W.indices).clip(-(2**31), 2**31 - 1).astype(np.int32)
            W.indices[0] = d.pick([-1, n, 2**31 - 1])
        sigma = d.number(1e-4, 1) if d.chance(0.5) else d.layout(d.values(np.full(k, 0.01)))
        frame["landmarks"] = (W, d.layout(d.values(plain_V[d.rng.integers(0, n, k)] + 0.01)), sigma)
    if d.chance(0.2) and n:
        loop = d.layout(d.indices(d.rng.integers(0, n, 6)))
        frame["boundary"] = [(loop, d.points(int(d.rng.integers(2, 6)), 0.3))] * int(d.rng.integers(1, 3))
    if d.chance(0.2):
        frame["scan_labels"] = d.layout(d.indices(d.rng.integers(0, 3, len(scan_F))))
        out["options"]["labels"] = d.pick([[1], [0, 2], [], [7]])
    scan_V, scan_F = d.dressed(scan_V, scan_F)
    return {**out, "scan_V": scan_V, "scan_F": scan_F, "frame": frame}


UGLY_WEIGHTS = (np.nan, np.inf, 2.0, -1.0)
SPOIL_SCAN = (
    lambda d, V, F: (V, F),
    lambda d, V, F: (V, F),
    lambda d, V, F: (V, F[d.rng.random(len(F)) < 0.5]),
    lambda d, V, F: (V, F[:, ::-1]),
    lambda d, V, F: (V + 0.002 * d.rng.normal(size=V.shape), F),
)


def run_nricp(V, F, scan_V, scan_F, preset, options, frame):
    solver = kernels.NricpSolver(V, F, preset, **options)
    for _ in range(2):  # the second frame meets what the first one left
        result = solver.solve(scan_V, scan_F, **frame)
        assert result.stop in ("converged", "max_iterations", "no_overlap")
        assert result.V.shape == (rows(V), 3)
        within("matched", result.matched, 0, 1 + 1e-9)
        if result.stop == "no_overlap":
            assert np.isnan(result.V).all()
        else:
            finite("V", result.V)
            finite("rms", result.rms)
            finite("energy", result.energy)


def draw_biharmonic(d):
    V, F = d.mesh()
    n = len(V)
    known = d.rng.permutation(n)[: max(1, int(d.rng.integers(1, max(n // 2, 2))))]
    if d.spoil(0.05):
        known = d.rng.integers(0, max(n, 1), 5)
    D = d.layout(d.values(d.rng.normal(0, d.size(), (len(known), 3))))
    V, F = d.dressed(V, F)
    known = d.layout(d.indices(known))
    return {"V": V, "F": F, "known": known, "D": D, "options": d.options(accuracy=(1e-16, 1), refinements=range(0, 10))}


def run_biharmonic(V, F, known, D, options):
    solver = kernels.BiharmonicSolver(V, F, known, **options)
    finite("D", solver.solve(D), (rows(V), 3))
    finite("mollified", solver.mollified)


def draw_mrf(d):
    n, labels, e = int(d.rng.integers(0, 60)) if d.wild else 40, int(d.rng.integers(1, 6)), int(d.rng.integers(0, 150))
    edges = d.rng.integers(0, max(n, 1), (e, 2))
    if not d.spoil(0.1):
        edges = edges[edges[:, 0] != edges[:, 1]]
    size = d.size()
    out = {
        "unary": d.layout(d.values(size * d.rng.normal(size=(n, labels)))),
        "edges": d.layout(d.indices(edges)),
        "weights": d.layout(d.values(d.pick([size, d.size()]) * d.rng.random(len(edges)))),
        "options": d.options(max_sweeps=range(0, 20), vote_cost=(1e-9, 1e9)),
    }
    if d.chance(0.4):
        x = d.rng.normal(size=(labels, 2))
        out["pairwise"] = d.layout(d.values(np.linalg.norm(x[:, None] - x[None], axis=2) * d.size()))
    if d.chance(0.3):
        out["start"] = d.layout(d.indices(d.rng.integers(0, labels, n)))
    for name in ("prefer", "forbid"):
        if d.chance(0.3) and n:
            out[name] = d.layout(d.indices(np.c_[d.rng.integers(0, n, 3), d.rng.integers(0, labels, 3)]))
    return out


def run_mrf(unary, edges, weights, options, **more):
    result = kernels.mrf(unary, edges, weights, **more, **options)
    n, labels = np.shape(unary)
    within("labels", result.labels, 0, labels - 1)
    finite("labels", result.labels, (n,))
    finite("energy", [result.energy, result.unary_energy, result.pairwise_energy, *result.sweep_energy])
    assert result.stop in ("converged", "max_iterations")
    slack = 1e-9 * (np.abs(result.sweep_energy).max() + np.abs(np.asarray(unary, float)).sum())
    assert (np.diff(result.sweep_energy) <= slack).all(), "a sweep raised the energy"


UNTANGLE_OPTIONS = dict(
    margin=(1e-5, 0.1),
    spread=(1e-4, 10),
    relative_tolerance=(1e-3, 0.9),
    max_depth=(1e-3, 1),
    max_iterations=range(0, 30),
)


def draw_untangle(d):
    body_V, body_F = d.mesh(closed=True if d.chance(0.7) else None)
    if d.chance(0.4):  # cloth around, or in, the body
        cloth_V, cloth_F = (
            body_V * d.pick([0.97, 1.0, 1.03]) + 0.02 * d.rng.normal(size=3),
            body_F[d.rng.random(len(body_F)) < 0.8],
        )
    else:
        cloth_V, cloth_F = d.mesh(closed=False)
        if d.chance(0.5) and len(body_V) and len(cloth_V):
            cloth_V = cloth_V + body_V[d.rng.integers(len(body_V))]
    (cloth_V, cloth_F), (body_V, body_F) = d.dressed(cloth_V, cloth_F), d.dressed(body_V, body_F)
    return {
        "cloth_V": cloth_V,
        "cloth_F": cloth_F,
        "body_V": body_V,
        "body_F": body_F,
        "options": d.options(**UNTANGLE_OPTIONS),
    }


def run_untangle(cloth_V, cloth_F, body_V, body_F, options):
    n = rows(cloth_V)
    result = kernels.untangle(cloth_V, cloth_F, body_V, body_F, **options)
    for name, shape in (
        ("V", (n, 3)),
        ("displacement", (n, 3)),
        ("depth_before", (n,)),
        ("depth_after", (n,)),
        ("margin", (n,)),
    ):
        finite(name, getattr(result, name), shape)
    assert result.stop in ("clear", "stalled", "max_iterations")
    assert len(result.pairs_left) == result.intersections_left
    if result.stop == "clear":
        assert result.intersections_left == 0
        pairs = kernels.intersecting_pairs(result.V, cloth_F, body_V, body_F)
        assert len(pairs) == 0, f"clear, and {len(pairs)} pairs intersect"


def draw_raster(d):
    V, F = d.mesh()
    side = lambda: d.whole(1, 60) if d.chance(0.95) else d.pick([0, -1, 32769, 2**31, 2**40])
    f = d.number(1, 1e3)
    K = d.layout(d.values([[f, 0, 30], [0, f, 20], [0, 0, 1]]))
    V = V + [0, 0, d.pick([0, 1, 1, 1, -1, 1e6])]
    V, F = d.dressed(V, F)
    return {
        "V": V,
        "F": F,
        "K": K,
        "size": (side(), side()),
        "options": d.options(barycentric=[True, False], near_plane=(1e-12, 1)),
    }


def run_raster(V, F, K, size, options):
    result = kernels.raster(V, F, K, size, **options)
    assert result.face.shape == size == result.depth.shape
    within("face", result.face, -1, rows(F) - 1)
    finite("depth", result.depth[result.face >= 0])
    assert np.isinf(result.depth[result.face < 0]).all()
    if result.barycentric is not None:
        finite("barycentric", result.barycentric, (*size, 3))


def draw_paint(d):
    V, F = d.mesh()
    uv, size, layers = d.rng.random((len(V), 2)), d.rng.integers(1, 20, 2), int(d.rng.integers(1, 3))
    face = d.rng.integers(-1, max(len(F), 1), size)
    channels = int(d.rng.integers(1, 5))
    textures = [d.rng.random((side, side, channels)) for side in d.rng.integers(0 if d.spoil(0.1) else 1, 7, layers)]
    K = d.layout(d.values([[d.number(1, 1e3), 0, 8], [0, d.number(1, 1e3), 8], [0, 0, 1]]))
    first_face = d.pick([[1], [], [0, 5, 2]]) if d.spoil(0.1) else [0, 1][:layers]
    V, F = d.dressed(V + [0, 0, d.pick([0, 1, -1, 1e6])], F)
    return {
        "face": d.layout(d.indices(face)),
        "V": V,
        "F": F,
        "uv": d.layout(d.values(uv)),
        "face_uv": F,
        "K": K,
        "textures": textures,
        "first_face": first_face,
    }


def run_paint(face, V, F, uv, face_uv, K, textures, first_face):
    picture = kernels.paint(face, V, F, uv, face_uv, K, textures, first_face)
    finite("picture", picture, (textures[0].shape[2], *np.shape(face)))
    within("picture", picture, 0, 1 + 1e-5)
    assert (picture[:, np.asarray(face) < 0] == 0).all()


def draw_contours(d):
    V, F = d.mesh()
    V = V + [0, 0, d.pick([0, 1, 1, -1, 1e6])]
    K = d.layout(d.values([[d.number(1, 1e3), 0, 8], [0, d.number(1, 1e3), 8], [0, 0, 1]]))
    size, channels = tuple(d.rng.integers(1, 20, 2).tolist()), int(d.rng.integers(1, 4))
    face = d.rng.integers(-1, max(len(F), 1), size)
    V, F = d.dressed(V, F)
    picture, g = d.rng.standard_normal((2, channels, *size))
    depth = np.where(face < 0, np.inf, d.rng.random(size))
    return {
        "face": d.layout(d.indices(face)), "depth": depth, "V": V, "F": F, "K": K, "near": d.number(1e-9, 1),
        "picture": picture, "g": g,
    }  # fmt: skip


def run_contours(face, depth, V, F, K, near, picture, g):
    contours = kernels.Contours(face, depth, V, F, kernels.face_neighbours(F), K, near)
    within("share", contours.share, 0, 1)
    within("edge", contours.edge, 0, rows(V) - 1)
    within("b", contours.b - contours.a, 1, max(np.shape(face)[1], 1))
    finite("gradient", contours.gradient(picture, g), (rows(V), 3))


def draw_occlusion(d):
    V, F = d.dressed(*d.mesh())
    rays = d.whole(1, 40) if d.chance(0.95) else d.pick([0, -1, 65537, 2**40])
    return {
        "V": V,
        "F": F,
        "rays": rays,
        "seed": d.whole(0, 1000),
        "options": d.options(relative_offset=(1e-7, 1), reach=(1e-9, 1e9)),
    }


def run_occlusion(V, F, rays, seed, options):
    openness = kernels.ambient_occlusion(V, F, rays, seed, **options)
    finite("openness", openness, (rows(V),))
    within("openness", openness, 0, 1)


def draw_remesh(d):
    V, F = d.dressed(*d.mesh())
    return {
        "V": V,
        "F": F,
        "edge": d.number(0.05, 10),
        "options": d.options(iterations=range(1, 4), crease_angle=(1e-3, 3)),
    }


def run_remesh(V, F, edge, options):
    V, F = kernels.remesh(V, F, edge, **options)
    finite("V", V, (len(V), 3))
    within("F", F, 0, len(V) - 1)


ENTRIES = {
    "nricp": (draw_nricp, run_nricp),
    "untangle": (draw_untangle, run_untangle),
    "mrf": (draw_mrf, run_mrf),
    "biharmonic": (draw_biharmonic, run_biharmonic),
    "skeleton": (draw_skeleton, run_skeleton),
    "inner": (draw_inner, run_inner),
    "raster": (draw_raster, run_raster),
    "paint": (draw_paint, run_paint),
    "contours": (draw_contours, run_contours),
    "occlusion": (draw_occlusion, run_occlusion),
    "remesh": (draw_remesh, run_remesh),
    "operators": (draw_mesh, run_operators),
    "topology": (draw_topology, run_topology),
    "closest": (draw_closest, run_closest),
    "pairs": (draw_pairs, run_pairs),
    "inside": (draw_inside, run_inside),
    "cholesky": (draw_cholesky, run_cholesky),
    "sight": (draw_sight, run_sight),
}
