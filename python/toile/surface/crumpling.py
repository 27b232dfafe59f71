"""How far a registered garment is from cloth that was bent: stretched faces, and such as are turned over."""

import numpy as np

from .. import kernels


def crumpling(rest, posed, V, F):
    """How far a garment V (g,3) is from cloth that was bent: stretch_p95, the largest stretch of a face against its shape at
    `rest`, what 95 % of the area stay below; flipped_share, of the area whose faces look against those of the template as the
    body's pose bends it, `posed`."""
    a, b = (X[F[:, 1:]] - X[F[:, :1]] for X in (rest, V))  # (m,2,3) two sides of each face
    A, B = (_metric(sides) for sides in (a, b))  # stretch^2 are the eigenvalues of A^-1 B
    area = kernels.face_areas(rest, F)
    size = A[0] * A[2] - A[1] ** 2
    sound = size > 1e-16 * area.mean() ** 2
    A, B, size = A[:, sound], B[:, sound], size[sound]
    half = (A[2] * B[0] - 2 * A[1] * B[1] + A[0] * B[2]) / (2 * size)
    det = (B[0] * B[2] - B[1] ** 2) / size
    stretch = np.sqrt(half + np.sqrt(np.maximum(half**2 - det, 0)))
    order = np.argsort(stretch)
    share = np.cumsum(area[sound][order]) / area[sound].sum()
    against = np.einsum("mi,mi->m", kernels.face_normals(posed, F), kernels.face_normals(V, F)) < 0
    return {
        "stretch_p95": float(stretch[order][np.searchsorted(share, 0.95)]),
        "flipped_share": float(area[against].sum() / area.sum()),
    }


def _metric(sides):
    """The metrics of faces by two sides each (m,2,3): their entries (3,m), first, mixed and second."""
    a, b = sides[:, 0], sides[:, 1]
    return np.stack([np.einsum("mi,mi->m", x, y) for x, y in ((a, a), (a, b), (b, b))])
