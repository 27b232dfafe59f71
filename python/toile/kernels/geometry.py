"""Operators, topology and closest points that the stages share with the kernels."""

import operator
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from .. import _core
from .arrays import Array, Bools, Floats, Ints, as_faces, as_floats, as_indices, as_sparse, as_vertices


def vertex_normals(V: Array, F: Array) -> Floats:
    """Area-weighted unit normals (n,3); zero where no face has area, or where a face and its reverse cancel."""
    return _core.vertex_normals(as_vertices("vertex_normals", "V", V), as_faces("vertex_normals", "F", F))


def face_normals(V: Array, F: Array) -> Floats:
    """Unit normals (m,3); zero for a face of no area."""
    return _core.face_normals(as_vertices("face_normals", "V", V), as_faces("face_normals", "F", F))


def face_areas(V: Array, F: Array) -> Floats:
    """Areas (m,) [m^2]."""
    return _core.face_areas(as_vertices("face_areas", "V", V), as_faces("face_areas", "F", F))


def cotangent_laplacian(V: Array, F: Array) -> Any:
    """Sparse (n,n), negative semi-definite, rows sum to zero."""
    return _core.cotangent_laplacian(
        as_vertices("cotangent_laplacian", "V", V), as_faces("cotangent_laplacian", "F", F)
    )


def voronoi_mass(V: Array, F: Array) -> Floats:
    """Mixed Voronoi area per vertex (n,) [m^2]; the sum is the mesh's area."""
    return _core.voronoi_mass(as_vertices("voronoi_mass", "V", V), as_faces("voronoi_mass", "F", F))


def boundary_loops(F: Array) -> list[Ints]:
    """Boundary loops as int32 vertex cycles, most vertices first, each from its smallest vertex, along its faces' half-edges.

    No loop passes a vertex twice: where loops touch, each is one by itself. Sides on no cycle, as beside edges of three faces,
    are left out."""
    return [np.array(loop, dtype=np.int32) for loop in _core.boundary_loops(as_faces("boundary_loops", "F", F))]


def face_neighbours(F: Array) -> Ints:
    """(m,3): the face beyond the edge opposite each corner, -1 where that edge has not exactly two faces."""
    return _core.face_neighbours(as_faces("face_neighbours", "F", F))


def border_vertices(F: Array, n: int) -> Bools:
    """bool (n,): does the vertex lie on an edge that has one face only? F (m,3) int, indices below `n`, else InputError.

    An edge's faces are counted whichever way they run; an edge of three faces is no border. Sides from a vertex to itself
    do not count."""
    return _core.border_vertices(as_faces("border_vertices", "F", F), operator.index(n))


def unique_edges(F: Array) -> Ints:
    """Undirected edges (e,2), sorted, each once."""
    return _core.unique_edges(as_faces("unique_edges", "F", F))


def vertex_components(F: Array, n: int) -> Ints:
    """Connected component per vertex (n,), numbered by first vertex."""
    return _core.vertex_components(as_faces("vertex_components", "F", F), operator.index(n))


def cheapest_path(cost: Array, step: Array) -> Ints:
    """argmin over paths j (k,) of sum_i cost[i, j_i] + sum_i step[j_i, j_i+1], cost (k,m), step (m,m) (Viterbi 1967)."""
    matrix = (None, None)
    return _core.cheapest_path(
        as_floats("cheapest_path", "cost", cost, matrix), as_floats("cheapest_path", "step", step, matrix)
    )


class CholeskyFactor:
    """LL' of sparse symmetric positive definite matrices of one pattern (CHOLMOD): the fill-reducing order is found at
    the first `factorize` and kept for as long as the pattern stays the same. Threads may solve side by side; InputError where one
    factorizes while another is at work."""

    def __init__(self) -> None:
        self._factor = _core.CholeskyFactor()

    def factorize(self, A: Any) -> "CholeskyFactor":
        """A (n,n) sparse (csc spares a copy), symmetric; the lower triangle is read. SolveError when it is not positive definite."""
        self._factor.factorize(as_sparse("cholesky", "A", A, csc_matrix))
        return self

    def solve(self, B: Array) -> Floats:
        """B (n,k) -> A^-1 B (n,k)."""
        return self._factor.solve(as_floats("cholesky", "B", B, (None, None)))

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("CholeskyFactor does not pickle: send the matrix and factorize it where it is needed")

    @property
    def factorisations(self) -> int:
        return self._factor.factorisations

    @property
    def analyses(self) -> int:
        return self._factor.analyses


class SurfaceIndex:
    """Closest points and rays on one mesh (Embree), built once for any number of queries."""

    def __init__(self, V: Array, F: Array) -> None:
        self._index = _core.SurfaceIndex(as_vertices("SurfaceIndex", "V", V), as_faces("SurfaceIndex", "F", F))

    def closest(self, points: Array, radius: float = np.inf, guess: Array = ()) -> tuple[Ints, Floats, Floats, Floats]:
        """-> face (k,) int32, -1 beyond `radius` [m]; point (k,3); barycentric (k,3); distance (k,) [m]. A face near each
        point may be guessed (k,): it saves time and changes nothing."""
        return self._index.closest(
            as_vertices("closest", "points", points), float(radius), as_indices("closest", "guess", guess)
        )

    def reached(self, points: Array, start: Array) -> tuple[Ints, Floats, Floats, Floats]:
        """As `closest`, of what is reached from the faces `start` (k,) over whatever side or corner comes nearer, until none
        does: places on the same sheet, however near another one lies. Nearest there, and no farther than on `start`."""
        return self._index.reached(as_vertices("reached", "points", points), as_indices("reached", "start", start))

    def occluded(self, origins: Array, directions: Array, near: float = 0.0, far: float = np.inf) -> Bools:
        """-> bool (k,): does the ray meet the mesh between `near` and `far` [m] along the unit direction?"""
        rays = as_vertices("occluded", "origins", origins), as_vertices("occluded", "directions", directions)
        return self._index.occluded(*rays, float(near), min(float(far), 1e30))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickles and copies as its mesh."""
        return SurfaceIndex, (self._index.V, self._index.F)
