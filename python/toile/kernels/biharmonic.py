"""Smooth displacement of a mesh from the displacement of some of its vertices."""

from typing import Any

from .. import _core
from .arrays import Array, Floats, as_faces, as_indices, as_vertices
from .rebuilt import Rebuilt


class BiharmonicSolver(Rebuilt):
    """D = argmin tr(D' L M^-1 L D) with D[known] given, factored once for any number of solves.

    Kept: the symbolic analysis and the numeric factor of (L M^-1 L) on the vertices that are not known; a solve only
    substitutes. Threads may share a solver.

    V: (n,3) float64 [m]; F: (m,3) int; known: (k,) int, distinct vertices. L is the cotangent Laplacian, M the mixed
    Voronoi areas; the boundary is natural. Fix a loop and its one-ring for a C1 join, a loop alone for a hinge.

    Options: accuracy=1e-8 (relative error at which a factor, and a solve, is refused); refinements=6 (most steps a
    solve). An unknown name is a TypeError.

    .factorisations: numeric factorisations done so far. .mollified: what was added to every edge [m] because needles
    or faces of no area spoilt the factor (Sharp and Crane 2020), 0 when nothing was. .factor_error: relative error on
    the constant field.

    InputError: bad mesh, index out of range, a repeated known vertex, a component without one (the message names it).
    SolveError: no sound factor even with mollified edges.
    Source: Jacobson, Tosun, Sorkine, Zorin, Mixed Finite Elements for Variational Surface Modeling, 2010.
    """

    def __init__(self, V: Array, F: Array, known: Array, **options: Any) -> None:
        V, F = as_vertices("biharmonic", "V", V), as_faces("biharmonic", "F", F)
        known = as_indices("biharmonic", "known", known)
        self._solver = _core.BiharmonicSolver(V, F, known, **options)
        self._keep(V, F, known, **options)

    def solve(self, D_known: Array) -> Floats:
        """D_known (k,3) in the order of `known` -> D (n,3), in the same unit.

        Translations come back exactly. A vertex that no face uses gets zero unless it is known.
        InputError: wrong number of rows, NaN or infinity. SolveError: the answer is less accurate than `accuracy`.
        """
        return self._solver.solve(as_vertices("biharmonic", "D_known", D_known))

    @property
    def factorisations(self) -> int:
        return self._solver.factorisations

    @property
    def mollified(self) -> float:
        return self._solver.mollified

    @property
    def factor_error(self) -> float:
        return self._solver.factor_error


def biharmonic(V: Array, F: Array, known: Array, D_known: Array, **options: Any) -> Floats:
    """One solve of `BiharmonicSolver`: -> D (n,3)."""
    return BiharmonicSolver(V, F, known, **options).solve(D_known)
