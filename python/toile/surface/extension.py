"""The end of a surface that evidence shows only in part, continued from the part that it shows."""

import numpy as np

from .. import kernels
from .operators import adjacency, sides


def continued(rest, F, V, free):
    """V (n,3) of a mesh whose `free` (n,) vertices are put where the others, that stay, lead: the thin plate through these,

        argmin tr(X' L M^-1 L X),  L and M the cotangent Laplacian and the areas of `rest` (n,3).

    It goes on with little bend, but steps shorten towards a border. Parts of the surface that are free as a whole stay."""
    from scipy.sparse.csgraph import connected_components

    A = adjacency(sides(F), len(V))
    part = connected_components(A, directed=False)[1]
    free = free & np.isin(part, part[~free])
    if not free.any():
        return V
    near = free.astype(float)
    for _ in range(3):  # the Laplacian of the Laplacian reaches two rings
        near = near + A @ near
    used, faces = np.unique(F[(near[F] > 0).all(1)], return_inverse=True)
    known = np.flatnonzero(~free[used]).astype(np.int32)
    solver = kernels.BiharmonicSolver(rest[used], faces.reshape(-1, 3).astype(np.int32), known)
    out = V.copy()
    out[used[free[used]]] = solver.solve(V[used[known]])[free[used]]
    return out
