"""Options of the kernels that stages pass on, with the defaults of the C++ structs."""

from __future__ import annotations

import math

from ..kernels.skeleton import JOINT_LIMIT, JOINT_SIGMA, JOINT_TWIST, OTHER_LIMIT, OTHER_SIGMA
from .settings import Settings, setting


class SkeletonSettings(Settings):
    """Pose and shape of the body model, see kernels.SkeletonSolver."""

    surface_weight: float = setting(200.0, "1", "independent observations that the whole surface counts as", ge=0)
    surface_sigma: float = setting(0.005, "m", "noise of the surface against the scan", gt=0)
    surface_robust: float = setting(0.015, "m", "Geman-McClure scale of the last rounds", gt=0)
    cloth_fit: float = setting(0.1, "1", "weight of a clothed vertex whose scan lies outside it, as cloth should", ge=0)
    reach_start: float = setting(0.10, "m", "closest points farther than this do not count at a cold start", gt=0)
    reach: float = setting(0.04, "m", "the same in the last rounds, and from a warm start", gt=0)
    min_cosine: float = setting(0.5, "1", "least agreement of the normals of model and scan", ge=-1, le=1)
    surface_samples: int = setting(
        5000, "count", "vertices of the body that look for the scan in the preparation", ge=1
    )
    keypoint_robust_sigmas: float = setting(
        4.0, "sigma", "Geman-McClure scale of keypoints, in multiples of their sigma: some are of the other hand", gt=0
    )
    pose_weight: float = setting(1.0, "1", "scales the prior on joint angles", ge=0)
    shape_weight: float = setting(1.0, "1", "scales the prior on the shape's coefficients", ge=0)
    limit_sigma: float = setting(0.05, "rad", "softness of the joints' limits", gt=0)
    temporal_sigma: float = setting(0.15, "rad", "departure of a joint from its prediction by earlier frames", gt=0)
    temporal_translation: float = setting(0.05, "m", "the same for the translation", gt=0)
    max_iterations: int = setting(40, "count", "Levenberg-Marquardt steps in the surface stage, at most", ge=1)
    tolerance: float = setting(2e-4, "m", "stop when a step moves the vertices by less, root mean square", gt=0)
    relative_decrease: float = setting(
        5e-4, "1", "a step that lowers the least energy by less than this share of it is idle", ge=0, lt=1
    )
    idle: int = setting(3, "count", "stop after so many idle steps in a row: matches come and go", ge=1)
    joint_sigma: dict[str, float] = setting(
        {name: value for name, value in JOINT_SIGMA if math.isfinite(value)},
        "rad",
        "spread about rest of the joints whose roles (BodyModel.joint_roles) begin so, the first that fits: twist bones, toes and metacarpals "
        "hardly move by themselves, the spine and neck share a bend, eyes are not seen; 0 locks a joint",
    )
    other_joint_sigma: float = setting(
        OTHER_SIGMA, "rad", "the same of all other joints but the root, which is free", ge=0
    )
    joint_limit: dict[str, float] = setting(
        {name: value for name, value in JOINT_LIMIT if math.isfinite(value)},
        "rad",
        "largest angles of the joints whose roles (BodyModel.joint_roles) begin so: knees, elbows and fingers fold far, others do not",
    )
    other_joint_limit: float = setting(OTHER_LIMIT, "rad", "the same of all other joints but the root", gt=0)
    joint_twist: dict[str, float] = setting(
        dict(JOINT_TWIST),
        "rad",
        "spread of turns of the joints whose roles (BodyModel.joint_roles) begin so about their own bones: a knee is a hinge; others are free",
    )


class NricpSettings(Settings):
    """A surface onto the scan, see kernels.NricpSolver; relative lengths are shares of the root of the template's area,
    1.4 m for an adult, 1 m for a shirt. Lists hold a value a level of nodes, coarse to fine."""

    iterations: tuple[int, int, int] = setting(
        (8, 8, 3), "count", "steps of each level, at most; 0 leaves it out, the first is not used from a posed start"
    )
    stiffness_end: tuple[float, float, float] = setting(
        (0.02, 0.02, 0.02), "1", "weight of rigidity at each level's last step: less follows folds, and clutter too"
    )
    fine_iterations: int = setting(2, "count", "steps of the vertices' own displacement, at most", ge=0)
    fine_sweeps: int = setting(8, "count", "conjugate gradient steps of each of those", ge=1)
    relative_fine_length: float = setting(0.016, "1", "shorter waves of that displacement are not followed", gt=0)
    fine_noise: float = setting(10.0, "1", "nor those shorter than so many times the scan's noise beside", ge=0)
    relative_fine_robust: float = setting(0.004, "1", "Geman-McClure scale of those steps", gt=0)
    boundary_weight: float = setting(3.0, "1", "of a loop vertex against a surface vertex", ge=0)
    border_weight: float = setting(
        3.0, "1", "pull of the scan's borders on the surface's own; those of labelled faces are no openings", ge=0
    )


class InnerSolverSettings(Settings):
    """The body under cloth, see kernels.InnerSolver."""

    length: float = setting(0.08, "m", "features shorter than this are smoothed away where nothing is seen", gt=0)
    skin: float = setting(1e4, "1", "weight of observed skin", ge=0)
    out: float = setting(1e3, "1", "weight of a body that pokes out of the cloth", ge=0)
    fit: float = setting(400.0, "1", "pull to where the cloth's swing tells the body to be", ge=0)
    fit_scale: float = setting(0.02, "m", "Geman-McClure scale of that pull", gt=0)
    swing: float = setting(
        3.2, "1", "cloth is so many standard deviations of its room over the frames off the body", ge=0
    )
    still: float = setting(0.004, "m", "all cloth swings by so much at least: what shows less is scaled up", gt=0)
    swing_error: float = setting(0.004, "m", "of the body's place by cloth that does not swing", gt=0)
    misfit: float = setting(
        0.0035,
        "m",
        "seen skin that is nearer to the model, root mean square, says that the model holds under cloth too",
        ge=0,
    )
    prior: float = setting(0.5, "1", "coupling to the model, and of a frame to the fused shape", ge=0)
    gap: float = setting(0.002, "m", "cloth stays this far off the skin", ge=0)
    taper: float = setting(0.02, "m", "skin counts fully only this far from the cloth, along the surface", ge=0)
    seldom: float = setting(
        0.1, "1", "up to this share of the frames skin that was seen is taken for a wrong label", ge=0, lt=1
    )
    often: float = setting(0.25, "1", "from this share of the frames on it is skin", gt=0, le=1)
    reach: float = setting(0.06, "m", "cloth farther than this from the body says nothing", gt=0)
    tightness: float = setting(0.1, "1", "the bound of a hidden vertex is this quantile over the frames", ge=0, le=1)
    inward: float = setting(
        0.4, "1", "cloth draws a vertex inwards by at most this share of the body's thickness there", ge=0, le=1
    )
    shape_sigma: float = setting(0.01, "m", "spread of the skin about the model's span", gt=0)
    shape_observations: float = setting(
        200.0, "1", "independent observations that the skin counts as when the shape is refitted", ge=0
    )
    rounds: int = setting(3, "count", "times that the cloth is looked for anew", ge=1)
    max_iterations: int = setting(8, "count", "reweightings a round, at most", ge=1)
    tolerance: float = setting(2e-4, "m", "the fused shape is found when no vertex moves by more", gt=0)


class UntangleSettings(Settings):
    """Garments out of the body and of one another, see kernels.UntangleSolver."""

    margin: float = setting(0.002, "m", "kept between cloth and what lies under it, about a cloth's thickness", gt=0)
    spread: float = setting(0.03, "m", "length over which a push dies away in the cloth", gt=0)
    relative_tolerance: float = setting(
        0.1, "1", "share of the margin: a vertex is clear from (1 - relative_tolerance) margin on", gt=0, lt=1
    )
    max_depth: float = setting(
        0.05, "m", "an open body has no inside deeper than this, and overlaps are crossed no further", gt=0
    )
    max_iterations: int = setting(60, "count", "renewals of the planes, at most", ge=1)


class MrfSettings(Settings):
    """Labels on a graph, see kernels.mrf."""

    max_sweeps: int = setting(100, "count", "sweeps that expand every label once, at most", ge=1)


class BiharmonicSettings(Settings):
    """Smooth displacement from a garment's loops, see kernels.BiharmonicSolver."""

    accuracy: float = setting(1e-8, "1", "relative error at which a factor, and a solve, is refused", gt=0)
    refinements: int = setting(6, "count", "steps of iterative refinement a solve, at most", ge=0)
