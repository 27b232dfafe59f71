"""Every function of toile.kernels that takes arrays: how to draw its arguments, and what its result must be.

An entry is (draw, run): `draw(d)` makes keyword arguments, `run(**arguments)` calls and asserts the law: finite results
of the right shape. Whether an exception is a lawful one is for the caller to judge.
"""

from types import SimpleNamespace

import numpy as np
import scipy.sparse as sp

from toile import kernels
from toile.scene import BodyModel

from .draw import Draw


def finite(name, values, shape=None):
    values = np.asarray(values)
    assert shape is None or values.shape == shape, f"{name} has shape {values.shape}, expected {shape}"
    assert np.isfinite(values).all(), f"{name} is not finite"


def within(name, values, low, high):
    values = np.asarray(values)
    assert ((values >= low) & (values <= high)).all(), f"{name} lies beyond {low} to {high}"


def rows(F):
    return len(F) if np.iterable(F) else 0


# --- operators and queries -----------------------------------------------------------------------------------------


def draw_mesh(d):
    V, F = d.dressed(*d.mesh())
    return {"V": V, "F": F}


def run_operators(V, F):
    n, m = rows(V), rows(F)
    results = []
    for name, shape in (("vertex_normals", (n, 3)), ("face_normals", (m, 3)), ("face_areas", (m,)), ("voronoi_mass", (n,))):
        try:
            results.append((name, getattr(kernels, name)(V, F), shape))
        except LAWFUL:
            continue
    try:
        L = kernels.cotangent_laplacian(V, F)
        assert L.shape == (n, n)
        results.append(("cotangent_laplacian", L.data, None))
    except LAWFUL:
        pass
    for result in results:
        finite(*result)


def draw_topology(d):
    V, F = d.mesh()
    return {"F": d.layout(d.indices(F)), "n": d.whole(len(V), len(V) + 3)}


def run_topology(F, n):
    try:
        for loop in kernels.boundary_loops(F):
            assert len(loop) >= 1
        edges = kernels.unique_edges(F)
        assert (edges[:, 0] <= edges[:, 1]).all()
    except LAWFUL:
        pass
    finite("vertex_components", kernels.vertex_components(F, n), (n,))


def draw_closest(d):
    V, F = d.dressed(*d.mesh())
    k = int(d.rng.integers(0, 30))
    return {"V": V, "F": F, "P": d.points(k, 0.4), "D": d.points(k), "radius": d.number(1e-3, 1e3), "far": d.number(1e-3, 1e3)}


def run_closest(V, F, P, D, radius, far):
    index = kernels.SurfaceIndex(V, F)
    try:
        face, point, barycentric, distance = index.closest(P, radius)
        hit = face >= 0
        within("face", face, -1, rows(F) - 1)
        finite("point", point[hit])
        finite("distance", distance[hit])
        within("barycentric", barycentric[hit], -1e-6, 1 + 1e-6)
        assert radius < 1e29 or hit.all(), "no face within an unbounded radius"
    except LAWFUL:
        pass
    assert index.occluded(P, D, 0.0, far).shape == (rows(P),)


def draw_pairs(d):
    V1, F1 = d.dressed(*d.mesh())
    V2, F2 = d.dressed(*d.mesh())
    return {"V1": V1, "F1": F1, "V2": V2, "F2": F2}


def run_pairs(V1, F1, V2, F2):
    for pairs, other in ((lambda: kernels.self_intersections(V1, F1), F1), (lambda: kernels.intersecting_pairs(V1, F1, V2, F2), F2)):
        try:
            found = pairs()
        except LAWFUL:
            continue
        within("pairs", found[:, 0], 0, rows(F1) - 1)
        within("pairs", found[:, 1], 0, rows(other) - 1)


def draw_inside(d):
    V, F = d.dressed(*d.mesh(closed=True if d.chance(0.7) else None))
    return {"P": d.points(int(d.rng.integers(0, 40)), 0.4), "V": V, "F": F}


def run_inside(P, V, F):
    for query in (kernels.winding_number, kernels.signed_distance):
        try:
            finite(query.__name__, query(P, V, F), (rows(P),))
        except LAWFUL:
            continue


def draw_cholesky(d):
    n = int(d.rng.integers(0, 30))
    A = sp.random(n, n, 0.2, random_state=d.rng.integers(2**31)) if n else sp.csc_matrix((0, 0))
    A = sp.csc_matrix(A @ A.T + sp.eye(n) * d.pick([1, 0, -1, 1e-300, 1e300])) if n else A
    if len(A.data) and d.spoil():
        A.data[d.rng.integers(len(A.data))] = d.pick((np.nan, np.inf, 1e300))
    if d.spoil():
        A = A[:, : n - 1] if d.chance(0.5) else sp.csc_matrix(A.astype(np.float32)) if d.chance(0.5) else A.tocoo()
    return {"A": A, "B": d.layout(d.values(d.rng.normal(size=(n + int(d.spoil(0.1)), int(d.rng.integers(0, 4))))))}


def run_cholesky(A, B):
    factor = kernels.CholeskyFactor()
    try:
        factor.solve(B)
        assert rows(B) == 0, "solved without a factor"
    except LAWFUL:
        pass
    factor.factorize(A)
    finite("solution", factor.solve(B), np.shape(B))


# --- kernels -------------------------------------------------------------------------------------------------------

NRICP_OPTIONS = dict(
    large_motion=[True, False], rebase=[True, False], passes=range(1, 3), fine_iterations=range(0, 4), fine_sweeps=range(1, 6),
    fine_length=(1e-4, 1e2), fine_noise=(1e-3, 1e3), fine_robust=(1e-5, 1e3), phong=(1e-3, 2), point_weight=(1e-6, 1),
    boundary_weight=(1e-6, 1e6), rotation_weight=(1e-8, 1e8), min_overlap=(1e-6, 1), exposure=(1e-3, 1),
)  # fmt: skip
NRICP_LEVELS = dict(
    radii=(5e-3, 10), stiffness_start=(1e-8, 1e12), stiffness_end=(1e-8, 1e12), robust_start=(1e-4, 1e2), robust_end=(1e-4, 1e2),
    reverse=(1e-4, 1e4), spread=(1e-4, 1e2), detail=(5e-3, 10),
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
    assert result.stop in ("converged", "max_sweeps")
    slack = 1e-9 * (np.abs(result.sweep_energy).max() + np.abs(np.asarray(unary, float)).sum())
    assert (np.diff(result.sweep_energy) <= slack).all(), "a sweep raised the energy"


UNTANGLE_OPTIONS = dict(margin=(1e-5, 0.1), spread=(1e-4, 10), tolerance=(1e-3, 0.9), max_depth=(1e-3, 1), max_iterations=range(0, 30))


def draw_untangle(d):
    body_V, body_F = d.mesh(closed=True if d.chance(0.7) else None)
    if d.chance(0.4):  # cloth around, or in, the body
        cloth_V, cloth_F = body_V * d.pick([0.97, 1.0, 1.03]) + 0.02 * d.rng.normal(size=3), body_F[d.rng.random(len(body_F)) < 0.8]
    else:
        cloth_V, cloth_F = d.mesh(closed=False)
        if d.chance(0.5) and len(body_V) and len(cloth_V):
            cloth_V = cloth_V + body_V[d.rng.integers(len(body_V))]
    (cloth_V, cloth_F), (body_V, body_F) = d.dressed(cloth_V, cloth_F), d.dressed(body_V, body_F)
    return {"cloth_V": cloth_V, "cloth_F": cloth_F, "body_V": body_V, "body_F": body_F, "options": d.options(**UNTANGLE_OPTIONS)}


def run_untangle(cloth_V, cloth_F, body_V, body_F, options):
    n = rows(cloth_V)
    result = kernels.untangle(cloth_V, cloth_F, body_V, body_F, **options)
    for name, shape in (("V", (n, 3)), ("displacement", (n, 3)), ("depth_before", (n,)), ("depth_after", (n,)), ("margin", (n,))):
        finite(name, getattr(result, name), shape)
    assert result.stop in ("clear", "stalled", "iterations")
    assert len(result.pairs_left) == result.intersections_left
    if result.stop == "clear":
        assert result.intersections_left == 0
        pairs = kernels.intersecting_pairs(result.V, cloth_F, body_V, body_F)
        assert len(pairs) == 0, f"clear, and {len(pairs)} pairs intersect"


def draw_raster(d):
    V, F = d.mesh()
    side = lambda: d.whole(1, 60) if d.chance(0.95) else d.pick([0, -1, 32769, 2**31, 2**40])  # noqa: E731
    f = d.number(1, 1e3)
    K = d.layout(d.values([[f, 0, 30], [0, f, 20], [0, 0, 1]]))
    V = V + [0, 0, d.pick([0, 1, 1, 1, -1, 1e6])]
    V, F = d.dressed(V, F)
    return {"V": V, "F": F, "K": K, "size": (side(), side()), "options": d.options(barycentric=[True, False], near_plane=(1e-12, 1))}


def run_raster(V, F, K, size, options):
    result = kernels.raster(V, F, K, size, **options)
    assert result.face.shape == size == result.depth.shape
    within("face", result.face, -1, rows(F) - 1)
    finite("depth", result.depth[result.face >= 0])
    assert np.isinf(result.depth[result.face < 0]).all()
    if result.barycentric is not None:
        finite("barycentric", result.barycentric, (*size, 3))


# --- body model ----------------------------------------------------------------------------------------------------


def toy_body(d):
    """A tube of four joints with three shapes; its arrays sound unless spoilt."""
    j, i = np.meshgrid(np.arange(12), np.arange(9))
    around, along = 12, 9
    V = np.c_[0.1 * np.cos(j.ravel() / 12 * 2 * np.pi), 0.1 * np.sin(j.ravel() / 12 * 2 * np.pi), i.ravel() * 0.1]
    a, b = np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij")
    at = lambda p, q: (p * around + q % around).ravel()  # noqa: E731
    F = np.concatenate([np.c_[at(a, b), at(a, b + 1), at(a + 1, b)], np.c_[at(a, b + 1), at(a + 1, b + 1), at(a + 1, b)]])
    J = np.c_[np.zeros((4, 2)), [0.0, 0.2, 0.4, 0.6]]
    near = np.abs(V[:, 2:] - J[:, 2])
    order = np.argsort(near, axis=1)[:, :2]
    weights = np.exp(-30 * np.take_along_axis(near, order, 1))
    shapes = d.rng.normal(0, 0.01, (len(V), 3, 3))
    spoilt = {}
    if d.spoil(0.3):
        name = d.pick(["v_template", "f", "J", "parents", "weights_idx", "weights_val", "shapedirs", "J_shapedirs", "joint", "vertices"])
        spoilt[name] = d.pick(MODEL_FLAWS)
    change = lambda name, a: spoilt[name](a) if name in spoilt else a  # noqa: E731
    return BodyModel(
        v_template=change("v_template", V),
        f=change("f", F),
        J=change("J", J),
        parents=change("parents", np.array([-1, 0, 1, 2])),
        weights_idx=change("weights_idx", order),
        weights_val=change("weights_val", weights / weights.sum(1, keepdims=True)),
        shapedirs=change("shapedirs", shapes),
        J_shapedirs=change("J_shapedirs", d.rng.normal(0, 0.01, (4, 3, 3))),
        joint_names=("root", "spine", "neck", "head"),
        keypoint_names=("a", "b", "c", "d"),
        keypoint_joint=change("joint", np.array([0, 2, -1, -1])),
        keypoint_vertices=(np.zeros(0, int), np.zeros(0, int), change("vertices", np.array([5, 6])), np.array([100])),
    )


def sound_body():
    return toy_body(Draw(0, wild=False))


def _first(value):
    def flaw(a):
        a = np.array(a)
        a.reshape(-1)[0] = value
        return a

    return flaw


MODEL_FLAWS = (_first(-7), _first(10**6), lambda a: a[:-1], lambda a: a[:0], lambda a: a * 1e300 if a.dtype == float else a * 2,
               lambda a: a * np.nan if a.dtype == float else a - 1)  # fmt: skip


def draw_pose(d, K=4, S=3):
    return (
        d.layout(d.values(d.rng.normal(0, 0.2 * d.pick([1, 1, 1, 100]), (K, 3)))),
        d.layout(d.values(d.rng.normal(0, 0.05, 3))),
        d.layout(d.values(d.rng.normal(0, 1, int(d.rng.integers(0, S + 1))))),
    )


SKELETON_OPTIONS = dict(
    surface_weight=(1e-3, 1e6), surface_sigma=(1e-5, 1), surface_robust=(1e-5, 1), cloth_fit=(1e-3, 1), reach_start=(1e-3, 10),
    reach=(1e-3, 10), min_cosine=(1e-3, 1), surface_samples=range(1, 200), keypoint_robust=(1e-2, 1e3), pose_weight=(1e-8, 1e8),
    shape_weight=(1e-8, 1e8), limit_sigma=(1e-5, 10), temporal_sigma=(1e-5, 10), temporal_translation=(1e-5, 10),
    solve_shape=[True, False], max_iterations=range(0, 15), tolerance=(1e-8, 1),
)  # fmt: skip


def draw_skeleton(d):
    model = toy_body(d)
    frames = []
    for _ in range(int(d.rng.integers(1, 3))):
        frame = {}
        if d.chance(0.8):
            sound = sound_body()
            V, F = d.mesh() if d.spoil(0.3) else (sound.v_template + 0.01 * d.rng.normal(size=3), sound.f)
            frame["scan_V"], frame["scan_F"] = d.dressed(V, F)
        if d.chance(0.6):
            points = d.values(np.c_[np.zeros((4, 2)), [0, 0.4, 0.05, 0.8]])
            names = d.pick([("a", "b", "c", "d")] * 5 + [("a", "b"), ("x",) * 4, ("a", "a", "a", "z")])
            sigma = d.pick([None, d.layout(d.values(np.full(4, d.number(1e-4, 1))))])
            frame["keypoints"] = SimpleNamespace(names=names, points=d.layout(points), sigma=sigma)
        if d.chance(0.3):
            frame["start"] = draw_pose(d)
        if d.chance(0.3):
            frame["previous"] = [draw_pose(d) for _ in range(int(d.rng.integers(0, 4)))]
        if d.chance(0.3):
            frame["clothed"] = d.layout(d.values(d.rng.random(108)))
        frames.append(frame)
    out = {"model": model, "frames": frames, "rounds": d.whole(1, 3), "options": d.options(**SKELETON_OPTIONS)}
    for name, count, top in (("joint_sigma", 4, 1), ("joint_limit", 4, 2), ("vertex_weights", 108, 1)):
        if d.chance(0.25):
            out["options"][name] = d.layout(d.values(d.rng.random(count) * top))
    return out


def run_skeleton(model, frames, rounds, options):
    solver = kernels.SkeletonSolver(model, **options)
    n, K, S = len(model.v_template), len(model.parents), model.shapedirs.shape[2]

    def law(r):
        for name, values, shape in (("V", r.V, (n, 3)), ("joints", r.joints, (K, 3)), ("rotations", r.rotations, (K, 3)),
                                    ("translation", r.translation, (3,)), ("shape", r.shape, (S,)), ("energy", r.energy, None),
                                    ("rms", [r.rms, r.keypoint_rms], None)):  # fmt: skip
            finite(name, values, shape)
        assert r.stop in ("converged", "max_iterations", "unmatched")

    try:
        law(solver.solve(**frames[0]))
    except LAWFUL:
        pass
    for result in solver.solve_shared(frames, rounds):
        law(result)


INNER_OPTIONS = dict(
    length=(1e-4, 1e2), skin=(1e-6, 1e8), out=(1e-6, 1e8), fit=(1e-6, 1e6), fit_scale=(1e-6, 1), prior=(1e-8, 1e6), gap=(1e-6, 0.1),
    taper=(1e-5, 1), reach=(1e-4, 10), tightness=(1e-3, 0.999), shape_sigma=(1e-5, 1), shape_observations=range(1, 1000),
    rounds=range(1, 4), tolerance=(1e-8, 1), max_iterations=range(1, 9),
)  # fmt: skip


def draw_inner(d):
    model, sound = toy_body(d), sound_body()
    frames = []
    for _ in range(int(d.rng.integers(0 if d.wild else 1, 3))):
        rotations, translation, _ = draw_pose(d) if d.spoil(0.4) else (np.zeros((4, 3)), np.zeros(3), ())
        garments = []
        for _ in range(int(d.rng.integers(0, 3))):
            V, F = d.mesh() if d.spoil(0.3) else (sound.v_template * [1.1, 1.1, 1.0], sound.f[d.rng.random(len(sound.f)) < 0.7])
            garments.append(d.dressed(V, F))
        frames.append((rotations, translation, d.layout(d.values(sound.v_template)), d.layout(d.values(np.round(d.rng.random(108)))), garments))
    out = {"model": model, "frames": frames, "options": d.options(**INNER_OPTIONS)}
    if d.chance(0.3):
        out["options"]["shape"] = d.layout(d.values(d.rng.normal(size=int(d.rng.integers(0, 4)))))
    if d.chance(0.2):
        out["options"]["J"] = d.layout(d.values(sound.J))
    return out


def run_inner(model, frames, options):
    solver = kernels.InnerSolver(model, **options)
    n = len(model.v_template)
    rest = model.v_template
    try:
        fused = solver.fuse(frames)
        finite("rest", fused.rest, (n, 3))
        finite("shape", fused.shape)
        finite("energy", fused.energy)
        assert not np.isnan(fused.bound).any() and fused.stop in ("converged", "max_iterations")
        rest = fused.rest
    except LAWFUL:
        pass
    for frame in frames:
        r = solver.solve(rest, *frame)
        finite("V", r.V, (n, 3))
        within("skin", r.skin, 0, 1)
        finite("evidence", [*r.energy, r.depth_before, r.depth_after])
        assert r.stop in ("converged", "max_iterations")


LAWFUL = (kernels.InputError, kernels.SolveError, TypeError)

ENTRIES = {
    "nricp": (draw_nricp, run_nricp),
    "untangle": (draw_untangle, run_untangle),
    "mrf": (draw_mrf, run_mrf),
    "biharmonic": (draw_biharmonic, run_biharmonic),
    "skeleton": (draw_skeleton, run_skeleton),
    "inner": (draw_inner, run_inner),
    "raster": (draw_raster, run_raster),
    "operators": (draw_mesh, run_operators),
    "topology": (draw_topology, run_topology),
    "closest": (draw_closest, run_closest),
    "pairs": (draw_pairs, run_pairs),
    "inside": (draw_inside, run_inside),
    "cholesky": (draw_cholesky, run_cholesky),
}
