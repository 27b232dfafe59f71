"""Non-rigid registration of a template mesh to a scan."""

from collections.abc import Iterable
from numbers import Number
from typing import Any

import numpy as np
import scipy.sparse as sp

from .. import _core
from .._core import NricpResult
from .arrays import Array, Floats, as_faces, as_floats, as_indices, as_sparse, as_vertices
from .rebuilt import Rebuilt

Landmarks = tuple[Any, Array, Array]  # W sparse (k,n), P (k,3) [m], sigma [m]
Boundary = Iterable[tuple[Array, Array]]  # loop vertices (l,), closed polyline (k,3) [m]


class NricpSolver(Rebuilt):
    """Fits one template V (n,3) [m], F (m,3) to scans, frame after frame:

        argmin_x sum_v a_v w_v (n_v . (x_v - q_v))^2 + scan-to-template + borders + loops + landmarks + stiffness rigidity(x)

    q_v: the closest scan point in place and normal, lifted off its face to the smooth surface (Phong tessellation); n_v
    between both normals (symmetric objective, Rusinkiewicz 2019); w_v = Geman-McClure(distance / mu) (n_v . m_v)^2 with
    mu annealed; a_v shares of area. Matches on the scan's border or beyond 3 mu do not count, nor do vertices in
    cavities. Where V has a border it is pulled, across, to a border of the scan that faces the same way and is no hole's
    (too short, or facing all ways): a template ends where its scan ends; `border_weight=0` leaves it free. x is
    carried by rigid nodes, coarse to fine (embedded deformation, Sumner et al. 2007, geodesic weights), then by a
    smooth displacement of its own, the smoother the noisier the scan. The same bits for any number of threads.

    Kept from frame to frame: the nodes and weights of each level, the symbolic analyses of the levels and of the fine
    steps (`analyses` counts them), the vertices that can be seen, and the numeric factor of the fine steps, one for each
    length of waves that came up. The factors of the levels change with every step. A scan's tree is made for each frame.
    Threads may share a solver; they solve one after the other.

    preset: "draft" (two levels of nodes, about 1.7 x the error of standard in a third of its time), "standard" or
    "fine" (four times the time, for large shape changes).

    Options; a length named `relative_...` is a share of the template's size, the square root of its area (1.4 m for an
    adult), so that the same options serve every scale; an unknown name is a TypeError:
      passes=1: solves, each but the first from the last answer as start and rest shape; 3 for large poses with landmarks;
      large_motion=True: rigid steps and the first level too; False where `start` is closer than 0.03 of the size;
      rebase=False: True makes `start` the rest shape; labels=[]: the scan labels that are targets.
    Of the levels of nodes, a list each, coarse to fine:
      relative_radii: spacing of the nodes; iterations: steps at most; stiffness_start, stiffness_end: weight of rigidity
      from the first step to the last; relative_robust_start, relative_robust_end: scale mu; reverse: weight of
      scan-to-template; relative_spread: distance that opposite normals are worth in a match; relative_detail: spacing of
      the vertices that are matched, 0: all; settled: after a move of this share of the radius only the last step is left.
    Of the fine steps: fine_iterations, fine_sweeps (of conjugate gradients each), relative_fine_length (shorter waves are
      not followed), fine_noise (nor those shorter than this many times the scan's noise), relative_fine_robust (mu).
    Of all: phong=1 (share by which scan points are lifted off their faces), point_weight=0.003 (share of point-to-point),
      boundary_weight=3 (of loops), border_weight=3 (of borders; 0 leaves them free), rotation_weight=1 (on differences of neighbouring
      nodes' rotations), min_overlap=0.01 (matched share below which there is no overlap), exposure=0.04 (share of rays
      that must leave the template from a vertex that can be seen; 0: all can).
    """

    def __init__(self, V: Array, F: Array, preset: str = "standard", **options: Any) -> None:
        V, F = as_vertices("nricp", "V", V), as_faces("nricp", "F", F)
        self._n = len(V)
        self._solver = _core.NricpSolver(V, F, preset, **options)
        self._keep(V, F, preset, **options)

    def solve(
        self,
        scan_V: Array,
        scan_F: Array,
        start: Array | None = None,
        landmarks: Landmarks | None = None,
        boundary: Boundary | None = None,
        scan_labels: Array | None = None,
        scan_confidence: Array | None = None,
    ) -> NricpResult:
        """One scan: scan_V (p,3) [m], scan_F (t,3).

        start (n,3) [m]: first positions, V without it. landmarks: (W sparse (k,n) with convex rows, P (k,3) [m], sigma
        scalar or (k,) [m]), pulls W x to P. boundary: [(loop vertices (l,), closed polyline (k,3) [m])], each vertex is
        pulled to the closest point of its polyline. scan_labels (t,): only faces with a label in the option `labels`
        are targets. scan_confidence (p,) >= 0: every pull of the scan counts by its confidence there, 1 without; faces
        with a corner at 0 are as though they were not there.

        -> .V (n,3) [m]; .stop (`Stop`) "converged", "max_iterations", or "no_overlap" (then V is NaN: no answer); .iterations;
        .energy [m^2] per step; .rms [m] of matched vertices to their planes; .matched (n,) in [0,1] weight of the last match,
        confidence included, without fine steps that of a vertex nearby.
        InputError names the argument and index.
        """
        none = np.zeros((0, 3))
        W, P, sigma = (sp.csr_matrix((0, self._n)), none, np.zeros(0)) if landmarks is None else _landmarks(landmarks)
        loops = [
            (as_indices("nricp", f"boundary[{i}] vertices", v), as_vertices("nricp", f"boundary[{i}] polyline", line))
            for i, (v, line) in enumerate(boundary or ())
        ]
        scan_V = as_vertices("nricp", "scan_V", scan_V)
        frame = _core.NricpFrame(
            scan_V,
            as_faces("nricp", "scan_F", scan_F),
            none if start is None else as_vertices("nricp", "start", start),
            W,
            P,
            sigma,
            loops,
            np.zeros(0, np.int32) if scan_labels is None else as_indices("nricp", "scan_labels", scan_labels),
            np.zeros(0)
            if scan_confidence is None
            else as_floats("nricp", "scan_confidence", scan_confidence, (len(scan_V),)),
        )
        return self._solver.solve(frame)

    @property
    def analyses(self) -> int:
        """Symbolic analyses so far: those of the template, none per frame."""
        return self._solver.analyses

    @property
    def factorisations(self) -> int:
        """Numeric factorisations so far."""
        return self._solver.factorisations


def nricp(
    V: Array,
    F: Array,
    scan_V: Array,
    scan_F: Array,
    preset: str = "standard",
    start: Array | None = None,
    landmarks: Landmarks | None = None,
    **options: Any,
) -> NricpResult:
    """`NricpSolver(V, F, preset, **options).solve(scan_V, scan_F, start, landmarks)`."""
    return NricpSolver(V, F, preset, **options).solve(scan_V, scan_F, start, landmarks)


def _landmarks(landmarks: Landmarks) -> tuple[Any, Floats, Floats]:
    W, P, sigma = landmarks
    if isinstance(sigma, (Number, np.ndarray)) and np.ndim(sigma) == 0:
        sigma = [sigma]
    return (
        as_sparse("nricp", "landmarks W", W),
        as_vertices("nricp", "landmarks P", P),
        as_floats("nricp", "landmarks sigma", sigma, (None,)),
    )
