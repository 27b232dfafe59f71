"""Plain operators on triangle meshes and curves, by numpy and scipy alone: averages over neighbours, values between vertices,
the mesh's border, the way along edges and to a closed polyline."""

import numpy as np


def sides(F):
    """The three sides (3m,2) of faces (m,3), from corner 0 to 1 of all, then 1 to 2, then 2 to 0, as the faces run."""
    return np.concatenate([F[:, [0, 1]], F[:, [1, 2]], F[:, [2, 0]]])


def adjacency(edges, n):
    """Sparse (n,n) of ones where `edges` (e,2) join two vertices, given either way and any number of times."""
    from scipy.sparse import coo_matrix

    i, j = np.concatenate([edges, edges[:, ::-1]]).T
    A = coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)).tocsr()
    A.data[:] = 1.0
    return A


def neighbour_mean(A):
    """Sparse (n,n): the mean over each vertex's neighbours by an adjacency, which may be one-sided; zero of none."""
    from scipy.sparse import diags

    return diags(1 / np.maximum(np.asarray(A.sum(1)).ravel(), 1)) @ A


def with_neighbours(values, edges, rounds=1):
    """Sums of values (n, ...) over each vertex and its neighbours along edges (e,2), `rounds` times."""
    A = adjacency(edges, len(values))
    for _ in range(rounds):
        values = values + A @ values
    return values


def interpolate(values, corners, bary):
    """Vertex values (n,c) at k points of faces with these corners (k,3), by barycentrics (k,3)."""
    return np.einsum("nc,ncl->nl", bary, values[corners])


def at_closest(mesh, values, points):
    """Vertex values (n,c) of a Mesh at its points closest to `points` (k,3)."""
    face, _, bary, _ = mesh.index.closest(points)
    return interpolate(values, mesh.faces[face], bary)


def umbrella(mean, values, steps):
    """Smooths values (n, ...) by `steps` moves half-way to the `neighbour_mean`."""
    shape = values.shape
    values = values.reshape(len(values), -1)
    for _ in range(steps):
        values = 0.5 * (values + mean @ values)
    return values.reshape(shape)


def smooth_on(F, values, steps):
    """`umbrella` smoothing of values (n, ...) on the vertices of a mesh."""
    return umbrella(neighbour_mean(adjacency(sides(F), len(values))), values, steps)


def umbrella_laplacian(F, n):
    """Sparse (n,n): (L v)_i = sum over the neighbours j of v_i - v_j."""
    from scipy.sparse import diags

    A = adjacency(sides(F), n)
    return diags(np.asarray(A.sum(1)).ravel()) - A


def border_sides(F):
    """bool (3m,): which of the `sides` belong to one face only."""
    a, b = sides(F).astype(np.int64).T
    key = np.minimum(a, b) * (int(F.max(initial=0)) + 1) + np.maximum(a, b)
    _, edge, count = np.unique(key, return_inverse=True, return_counts=True)
    return count[edge.ravel()] == 1


def compact(V, F):
    """The vertices (k,...) that faces use, in their order, and the faces into those."""
    used, F = np.unique(F, return_inverse=True)
    return V[used], F.reshape(-1, 3).astype(np.int32)


def distance_along_edges(V, edges, sources):
    """(n,) [m] from each of V (n,3) to the nearest of the vertices `sources` (k,) along `edges` (e,2), each given once."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    i, j = edges.T
    graph = coo_matrix((np.linalg.norm(V[i] - V[j], axis=1), (i, j)), (len(V), len(V))).tocsr()
    return dijkstra(graph, directed=False, indices=sources, min_only=True)


def distance_to_polyline(points, closed):
    """Distances (k,) of points (k,3) to a closed polyline (m,3) [m]."""
    return np.linalg.norm(offset_to_polyline(points, closed), axis=1)


def offset_to_polyline(points, closed):
    """Offsets (k,3) from points (k,3) to the nearest points of a closed polyline (m,3) [m]."""
    return nearest_on_polyline(points, closed)[2]


def nearest_on_polyline(points, closed):
    """Of the point of a closed polyline (m,3) [m] nearest to each of points (k,3): its segment (k,), its place on that
    (k,), 0 to 1, and the offset (k,3) to it."""
    a, d = closed, np.roll(closed, -1, 0) - closed
    r = points[:, None] - a
    s = np.clip(np.einsum("kmi,mi->km", r, d) / np.maximum(np.einsum("mi,mi->m", d, d), 1e-18), 0, 1)
    offset = s[..., None] * d - r
    best = np.einsum("kmi,kmi->km", offset, offset).argmin(1)
    k = np.arange(len(points))
    return best, s[k, best], offset[k, best]
