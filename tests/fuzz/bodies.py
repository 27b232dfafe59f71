"""Bodies and the kernels that fit them: how to draw their arguments, and what their results must be."""

from types import SimpleNamespace

import numpy as np

from toile import kernels
from toile.scene import BodyModel

from .draw import Draw
from .laws import LAWFUL, finite, within


def toy_body(d):
    """A tube of four joints with three shapes; its arrays sound unless spoilt."""
    j, i = np.meshgrid(np.arange(12), np.arange(9))
    around, along = 12, 9
    V = np.c_[0.1 * np.cos(j.ravel() / 12 * 2 * np.pi), 0.1 * np.sin(j.ravel() / 12 * 2 * np.pi), i.ravel() * 0.1]
    a, b = np.meshgrid(np.arange(along - 1), np.arange(around), indexing="ij")
    at = lambda p, q: (p * around + q % around).ravel()
    F = np.concatenate(
        [np.c_[at(a, b), at(a, b + 1), at(a + 1, b)], np.c_[at(a, b + 1), at(a + 1, b + 1), at(a + 1, b)]]
    )
    J = np.c_[np.zeros((4, 2)), [0.0, 0.2, 0.4, 0.6]]
    near = np.abs(V[:, 2:] - J[:, 2])
    order = np.argsort(near, axis=1)[:, :2]
    weights = np.exp(-30 * np.take_along_axis(near, order, 1))
    shapes = d.rng.normal(0, 0.01, (len(V), 3, 3))
    spoilt = {}
    if d.spoil(0.3):
        name = d.pick(
            [
                "v_template",
                "f",
                "J",
                "parents",
                "weights_idx",
                "weights_val",
                "shapedirs",
                "J_shapedirs",
                "joint",
                "vertices",
            ]
        )
        spoilt[name] = d.pick(MODEL_FLAWS)
    change = lambda name, a: spoilt[name](a) if name in spoilt else a
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
    reach=(1e-3, 10), min_cosine=(1e-3, 1), surface_samples=range(1, 200), keypoint_robust_sigmas=(1e-2, 1e3), pose_weight=(1e-8, 1e8),
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
    rounds=range(1, 4), tolerance=(1e-8, 1), max_iterations=range(1, 9), swing=(1e-3, 1e2), still=(1e-6, 1), swing_error=(1e-6, 1),
    misfit=(1e-6, 1), inward=(1e-3, 1),
)  # fmt: skip


def draw_inner(d):
    model, sound = toy_body(d), sound_body()
    frames = []
    for _ in range(int(d.rng.integers(0 if d.wild else 1, 3))):
        rotations, translation, _ = draw_pose(d) if d.spoil(0.4) else (np.zeros((4, 3)), np.zeros(3), ())
        garments = []
        for _ in range(int(d.rng.integers(0, 3))):
            V, F = (
                d.mesh()
                if d.spoil(0.3)
                else (sound.v_template * [1.1, 1.1, 1.0], sound.f[d.rng.random(len(sound.f)) < 0.7])
            )
            garments.append(d.dressed(V, F))
        frames.append(
            (
                rotations,
                translation,
                d.layout(d.values(sound.v_template)),
                d.layout(d.values(np.round(d.rng.random(108)))),
                garments,
            )
        )
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
