"""Loop subdivision (Loop 1987) as sparse matrices: one smooth surface that every template and target samples."""

import numpy as np
import scipy.sparse as sp


def edges_of(F):
    """Unique edges (e,2), the edge of each face side (m,3) with side i opposite corner i, and sides an edge (e,)."""
    sides = np.sort(F[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    E, edge, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    return E, edge.reshape(-1, 3), count


def neighbours(F, n):
    """Vertex adjacency (n,n) that a vertex takes its mean over: along the border only, for border vertices."""
    E, _, count = edges_of(F)
    border = count != 2
    on_border = np.zeros(n, bool)
    on_border[E[border]] = True
    A = sp.coo_matrix((np.ones(len(E)), E.T), shape=(n, n))
    B = sp.coo_matrix((np.ones(border.sum()), E[border].T), shape=(n, n))
    inner = sp.diags((~on_border).astype(float))
    return (inner @ (A + A.T) + B + B.T).tocsr(), on_border


def beta(valence):
    """Warren's weight of one neighbour."""
    return np.where(valence == 3, 3 / 16, 3 / (8 * np.maximum(valence, 1)))


def subdivide(F, n):
    """S (n+e, n) sparse with rows that sum to 1, and the faces (4m,3); the first n rows are the old vertices."""
    E, edge, count = edges_of(F)
    A, on_border = neighbours(F, n)
    valence = np.asarray(A.sum(1)).ravel()
    b = np.where(on_border, 1 / 8, beta(valence))
    old = sp.diags(1 - valence * b) + sp.diags(b) @ A
    inner = (count == 2).astype(float)
    ends = sp.coo_matrix((np.ones(2 * len(E)), (np.repeat(np.arange(len(E)), 2), E.ravel())), shape=(len(E), n))
    tips = sp.coo_matrix((np.ones(F.size), (edge.ravel(), F.ravel())), shape=(len(E), n))
    middle = sp.diags(0.5 - inner / 8) @ ends + sp.diags(inner / 8) @ tips
    e = edge + n
    F = np.concatenate([np.c_[F[:, 0], e[:, 2], e[:, 1]], np.c_[F[:, 1], e[:, 0], e[:, 2]],
                        np.c_[F[:, 2], e[:, 1], e[:, 0]], e])  # fmt: skip
    return sp.vstack([old, middle]).tocsr(), F


def limit(F, n):
    """(n,n) sparse: where the vertices lie on the limit surface."""
    A, on_border = neighbours(F, n)
    valence = np.asarray(A.sum(1)).ravel()
    chi = np.where(on_border, 1 / 6, 1 / (3 / (8 * beta(valence)) + valence))
    return (sp.diags(1 - valence * chi) + sp.diags(chi) @ A).tocsr()


def limit_surface(F, n, times):
    """Rows (N,n) that put a mesh, `times` subdivided, on the limit surface of its cage; faces; cage faces."""
    S, cage_face = sp.identity(n, format="csr"), np.arange(len(F))
    for _ in range(times):
        step, F = subdivide(F, S.shape[0])
        S, cage_face = step @ S, np.tile(cage_face, 4)
    return (limit(F, S.shape[0]) @ S).tocsr(), F, cage_face
