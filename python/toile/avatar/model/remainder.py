"""What a code leaves of an encoded frame's shape, in manifold harmonics (Vallet and Levy 2008).

Principal modes hold what the training frames did, and nothing else: shapes of other frames lie centimetres beside all that they
can say. Eigenvectors of a surface's Laplacian are as smooth as any as many functions can be, and favour no shape.
"""

from __future__ import annotations

import numpy as np

from ... import kernels
from ...surface.operators import compact

LEAST = 1e-12  # of the surface, of a vertex without area
SHIFT = 1e-2  # keeps the shifted matrix regular: constants have eigenvalue 0 [m^-2]


def manifold_harmonics(V, F, count):
    """(n,k) eigenvectors of the cotangent Laplacian of vertices V (n,3) [m] and faces F, of the least eigenvalues, and their
    masses (n,) [m^2]: H^T (mass H) = 1. Zero where no face is; k = `count`, fewer of a mesh with hardly more vertices."""
    from scipy.sparse import csc_matrix, diags
    from scipy.sparse.linalg import eigsh

    used = np.unique(F)
    rest, faces = compact(V, F)
    mass = kernels.voronoi_mass(rest, faces)
    mass = np.maximum(mass, LEAST * mass.sum())
    L = -csc_matrix(kernels.cotangent_laplacian(rest, faces))
    count = min(count, len(used) - 2)
    found = np.zeros((len(used), 0))
    if count > 0:
        found = eigsh(L, count, diags(mass), sigma=-SHIFT, v0=np.ones(len(used)))[1]
    H, masses = np.zeros((len(V), found.shape[1])), np.zeros(len(V))
    H[used], masses[used] = found, mass
    return H, masses
