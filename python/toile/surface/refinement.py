"""Non-rigid refinement: the last millimetres of a surface that already lies along its scan."""

import numpy as np

from .. import kernels
from .operators import offset_to_polyline


class NonRigidRefinement:
    """Non-rigid fit of one template, started within centimetres.

    Each step solves min_d sum_i w_i |d_i - t_i|^2 + stiffness m d' L M^-1 L d, m the mean mass, t_i the offset along
    the scan's normal to its nearest point, w_i its gate, and loop vertices drawn to their curves. Offsets along the
    normal keep the three coordinates apart: one factor of n unknowns a step instead of one of 3n. `settings` are
    RefinementSettings; their `steps` of the schedule are taken, spread evenly, its last always.
    """

    def __init__(self, V, F, settings):
        from scipy.sparse import diags

        self.F, self.settings = F, settings
        L, M = kernels.cotangent_laplacian(V, F), kernels.voronoi_mass(V, F)
        M = np.maximum(M, 1e-6 * M.mean())
        self.bending = (L.T @ diags(M.mean() / M) @ L).tocsc()
        self.bending.sort_indices()
        column = np.repeat(np.arange(len(V)), np.diff(self.bending.indptr))
        self.diagonal = np.flatnonzero(self.bending.indices == column)
        self.factor = kernels.CholeskyFactor()
        schedule, steps = list(zip(settings.stiffness_factors, settings.reaches)), settings.steps
        chosen = [schedule[(k + 1) * len(schedule) // steps - 1] for k in range(steps)]
        self.steps = [(settings.stiffness * factor, reach) for factor, reach in chosen]

    def solve(self, scan, start, boundary, steps=None):
        """Fitted vertices (n,3) from `start` (n,3) to a Mesh; `boundary` [(vertex indices, closed polyline (k,3))]; only
        the last `steps` of the schedule for a start within millimetres."""
        border = kernels.border_vertices(scan.faces, len(scan.vertices))
        V, face = np.array(start, dtype=np.float64), ()
        for stiffness, reach in self.steps[-(steps or len(self.steps)) :]:
            face, point, bary, distance = scan.index.closest(V, guess=face)
            n = scan.face_normals[face]
            facing = np.einsum("ni,ni->n", n, kernels.vertex_normals(V, self.F))
            at_border = border[scan.faces[face]]  # a face at the scan's border may belong to what is under the cloth
            beyond = (at_border & (bary > 1e-6)).any(1) & (at_border.sum(1) > 1)
            w = ((facing > self.settings.min_cosine) & (distance < reach) & ~beyond).astype(np.float64)
            t = np.einsum("ni,ni->n", n, point - V)[:, None] * n
            for vertices, curve in boundary:
                w[vertices], t[vertices] = self.settings.loop_weight, offset_to_polyline(V[vertices], curve)
            V = V + self._factored(stiffness, w + 1e-6).solve(w[:, None] * t)
        return V

    def _factored(self, stiffness, weights):
        """The factor of stiffness * bending + diag(weights)."""
        A = stiffness * self.bending
        A.data[self.diagonal] += weights
        return self.factor.factorize(A)
