"""Pose and shape of a body model from a scan, 3D keypoints and earlier frames."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from .. import _core
from .._core import InputError
from .._core import SkeletonResult as SkeletonResult
from .arrays import Array, Floats, Ints, as_faces, as_floats, as_vertices
from .body import BodyArrays
from .geometry import SurfaceIndex
from .rebuilt import Rebuilt

Pose = Any  # (rotations, translation, shape), or an object with these names
Table = Iterable[tuple[str, float]]  # values by the beginnings of names
ByJoint = Mapping[str, float] | Array

# Spread about rest [rad] of the joints whose roles (`BodyModel.joint_roles`) begin so; the first that fits counts. Twist
# bones, toes and metacarpals hardly move by themselves, the spine and neck share a bend, eyes are not seen.
JOINT_SIGMA = (
    ("root", np.inf),
    ("eye", 0.0),
    ("jaw", 0.1),
    ("toe", 0.05),
    ("metacarpal", 0.05),
    ("pelvis", 0.03),
    ("upperarm02", 0.1),
    ("lowerarm02", 0.3),
    ("upperleg02", 0.1),
    ("lowerleg02", 0.1),
    ("spine", 0.15),
    ("neck", 0.2),
    ("head", 0.3),
    ("clavicle", 0.2),
    ("shoulder01", 0.1),
    ("foot", 0.4),
    ("wrist", 0.4),
    ("finger", 0.5),
)
OTHER_SIGMA = 0.8
JOINT_LIMIT = (
    ("root", np.inf),
    ("finger", 1.9),
    ("lowerleg01", 2.6),
    ("lowerarm01", 2.6),
    ("upperarm01", 2.8),
    ("upperleg01", 2.4),
)
OTHER_LIMIT = 1.2
# Spread of turns about the joint's own bone [rad]: a knee is a hinge, and a straight leg's scan hardly tells how far its
# thigh turns against its shank. Arms turn there freely.
JOINT_TWIST = (("upperleg01", 0.3), ("lowerleg01", 0.1), ("foot", 0.2))
KEYPOINT_SIGMA = 0.005  # m, where keypoints bring none of their own


class SkeletonSolver(Rebuilt):
    """Fits `body_model` (`toile.scene.BodyModel`) to frames: argmin over local rotations, translation and shape of

        surface_weight mean_v c_v rho(n.(y_v - q_v) / surface_sigma)^2 + sum_i rho(|k_i - p_i| / sigma_i)^2
        + sum_k |log L_k|^2 / joint_sigma_k^2 + (a_k . log L_k)^2 / joint_twist_k^2
        + joint limits + shape_weight |beta|^2 + temporal terms

    rho is Geman-McClure, q_v the closest scan point within `reach` whose normal agrees, c_v its confidence. Levenberg-Marquardt on dense
    normal equations with analytic derivatives; the same bits for any number of threads. `joint_sigma` [rad],
    (K,) or {beginning of a joint's name: value}, replaces the spreads about rest (0 locks a joint at its start, infinity
    frees it), `joint_limit` [rad] the largest angles; joints that a table does not name get `other_joint_sigma` and
    `other_joint_limit`, the root is free. `joint_twist` [rad] is the spread of a joint's turns about the bone a_k that begins
    there; it is free where a table names none. `vertex_weights` (n,) is the mask of what scans show.

    Kept: the model, the vertices that look for the scan and their shares of area. No factor is kept: the normal
    equations are dense, of some hundred unknowns, and change with every step. Threads may share a solver.

    Other options; an unknown name is a TypeError. Lengths [m]: surface_sigma=0.005, surface_robust=0.015 (scale of rho
    in the last rounds), reach_start=0.10 and reach=0.04 (closest points farther away do not count, cold and in the last
    rounds), temporal_translation=0.05 (departure from the translation that earlier frames predict), tolerance=2e-4
    (stop when a step moves the vertices by less, root mean square). Angles [rad]: limit_sigma=0.05 (softness of the
    joints' limits), temporal_sigma=0.15 (departure of a joint from its prediction). keypoint_robust_sigmas=4 (scale of
    rho for keypoints, in multiples of their sigma). Weights: surface_weight=200 (independent observations that the whole
    surface counts as), cloth_fit=0.1 (of a clothed vertex whose scan lies outside it), pose_weight=1, shape_weight=1.
    min_cosine=0.5 (between normals of model and scan), surface_samples=5000 (vertices that look for the scan),
    solve_shape=True (False keeps the start's), max_iterations=40. It also stops, as matches come and go, after idle=3 steps
    in a row that lowered the least energy by less than relative_decrease=5e-4 of it.
    """

    def __init__(
        self,
        body_model: BodyArrays,
        joint_sigma: ByJoint | None = None,
        joint_limit: ByJoint | None = None,
        vertex_weights: Array | None = None,
        other_joint_sigma: float = OTHER_SIGMA,
        other_joint_limit: float = OTHER_LIMIT,
        joint_twist: ByJoint | None = None,
        **options: Any,
    ) -> None:
        roles, n = body_model.joint_roles, len(body_model.v_template)
        self.body_model = body_model
        sigma = _by_joint(roles, joint_sigma, JOINT_SIGMA, other_joint_sigma)
        limit = _by_joint(roles, joint_limit, JOINT_LIMIT, other_joint_limit)
        twist = _by_joint(roles, joint_twist, JOINT_TWIST, np.inf)
        if vertex_weights is None:
            vertex_weights = np.where(body_model.inside, 0.0, 1.0)
        given = (
            as_floats("skeleton", "joint_sigma", sigma, (len(roles),)),
            as_floats("skeleton", "joint_limit", limit, (len(roles),)),
            as_floats("skeleton", "vertex_weights", vertex_weights, (n,)),
        )
        options["joint_twist"] = as_floats("skeleton", "joint_twist", twist, (len(roles),))
        self._solver = _core.SkeletonSolver(body_model.core, *given, **options)
        self._keep(body_model, *given, **options)

    def solve(
        self,
        scan_V: Array | None = None,
        scan_F: Any = None,
        keypoints: Any = None,
        start: Pose | None = None,
        previous: Iterable[Pose] = (),
        clothed: Array | None = None,
        scan_confidence: Array | None = None,
        scan_index: SurfaceIndex | None = None,
    ) -> SkeletonResult:
        """Pose and shape of one frame.

        scan_V (m,3) [m], scan_F (t,3): None or empty for keypoints alone. keypoints: an object with `names`, `points`
        (k,3) [m], NaN where unseen, and `sigma` (k,) [m] (or None), as `toile.scene.Points3D`; names that the model
        does not know are left out. start: a result, or (rotations (K,3), translation (3,), shape (s,)); without one the
        solve begins at the keypoints, or, with none either, at rest in the middle of the scan. previous: up to two
        earlier frames like `start`, newest first, for the temporal term. clothed (n,) in [0,1]: vertices under cloth;
        where the scan lies outside them it pulls with `cloth_fit` only. scan_confidence (m,) >= 0: the scan pulls by its
        confidence there, 1 without; faces with a corner at 0 are as though they were not there. scan_index: that of
        scan_V and scan_F, where there is one: it saves time and changes nothing.

        -> .rotations (K,3) [rad], .translation (3,) [m], .shape (S,), .V (n,3) [m], .joints (K,3) [m], .stop
        (`Stop`: "converged", "max_iterations", "unmatched": no scan within reach), .iterations, .energy (per iteration),
        .rms [m] and .matched of the surface, .keypoint_rms [m]. Raises InputError (argument, index) and SolveError.
        """
        frame = self._frame(scan_V, scan_F, keypoints, start, previous, clothed, scan_confidence, scan_index)
        return self._solver.solve(frame)

    def solve_shared(self, frames: Sequence[Mapping[str, Any]], rounds: int = 4) -> list[SkeletonResult]:
        """One shape for several frames; `frames` are dicts of `solve`'s arguments. -> [SkeletonResult], equal `.shape`.

        Each round eliminates every frame's pose from its normal equations and steps the shape by their sum.
        """
        return self._solver.solve_shared([self._frame(**frame) for frame in frames], operator.index(rounds))

    def _frame(
        self,
        scan_V: Array | None = None,
        scan_F: Any = None,
        keypoints: Any = None,
        start: Pose | None = None,
        previous: Iterable[Pose] = (),
        clothed: Array | None = None,
        scan_confidence: Array | None = None,
        scan_index: SurfaceIndex | None = None,
    ) -> Any:
        has_scan = scan_F is not None and len(scan_F)
        V = np.zeros((0, 3)) if scan_V is None else as_vertices("skeleton", "scan_V", scan_V)
        F = as_faces("skeleton", "scan_F", scan_F) if has_scan else np.zeros((0, 3), np.int32)
        index, points, sigma = self._keypoints(keypoints)
        clothed = (
            np.zeros(0)
            if clothed is None
            else as_floats("skeleton", "clothed", clothed, (len(self.body_model.v_template),))
        )
        return _core.SkeletonFrame(
            V,
            F,
            index,
            points,
            sigma,
            [] if start is None else [as_pose("start", start)],
            [as_pose("previous", p) for p in previous],
            clothed,
            np.zeros(0)
            if scan_confidence is None
            else as_floats("skeleton", "scan_confidence", scan_confidence, (len(V),)),
            None if scan_index is None else scan_index._index,
        )

    def _keypoints(self, keypoints: Any) -> tuple[Ints, Floats, Floats]:
        """Indices into the model's table, points and sigmas of the keypoints that are seen and known."""
        if keypoints is None:
            return np.zeros(0, np.int32), np.zeros((0, 3)), np.zeros(0)
        points = as_vertices("skeleton", "keypoints.points", keypoints.points)
        k = len(points)
        if len(keypoints.names) != k:
            raise InputError(f"skeleton: keypoints.names has {len(keypoints.names)} entries, keypoints.points {k} rows")
        sigma = (
            np.full(k, KEYPOINT_SIGMA)
            if keypoints.sigma is None
            else as_floats("skeleton", "keypoints.sigma", keypoints.sigma, (k,))
        )
        table = {name: i for i, name in enumerate(self.body_model.keypoint_names)}
        known = np.array([table.get(name, -1) for name in keypoints.names], dtype=np.int32)
        if k and (known < 0).all():
            raise InputError(f"skeleton: the model knows none of keypoints.names ({keypoints.names[0]!r}, ...)")
        use = (known >= 0) & ~np.isnan(points).all(1)
        return known[use], points[use], sigma[use]


def skeleton(
    body_model: BodyArrays,
    scan_V: Array | None,
    scan_F: Any,
    keypoints: Any = None,
    start: Pose | None = None,
    **options: Any,
) -> SkeletonResult:
    """`SkeletonSolver(body_model, **options).solve(scan_V, scan_F, keypoints, start)`."""
    return SkeletonSolver(body_model, **options).solve(scan_V, scan_F, keypoints, start)


def _by_joint(roles: Iterable[str], given: ByJoint | None, table: Table, other: float) -> Array:
    """Values (K,): those given, by joint or by the beginnings of roles; else those of the table."""
    if given is not None and not isinstance(given, Mapping):
        return given
    return by_prefix(roles, table if given is None else [("root", np.inf), *given.items()], other)


def by_prefix(names: Iterable[str], table: Table, other: float) -> Floats:
    """A value per name: that of the first prefix in the table which fits."""
    return np.array([next((value for prefix, value in table if name.startswith(prefix)), other) for name in names])


def as_pose(name: str, pose: Pose) -> Any:
    rotations, translation, shape = pose if isinstance(pose, tuple) else (pose.rotations, pose.translation, pose.shape)
    return _core.SkeletonPose(
        as_vertices("skeleton", f"{name}.rotations", rotations),
        as_floats("skeleton", f"{name}.translation", translation, (3,)),
        as_floats("skeleton", f"{name}.shape", shape, (None,)),
    )
