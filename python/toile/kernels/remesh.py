"""Isotropic remeshing: the same surface in triangles of nearly equal sides."""

from typing import Any

from .. import _core
from .arrays import Array, Floats, Ints, as_faces, as_vertices


def remesh(V: Array, F: Array, edge: float, **options: Any) -> tuple[Floats, Ints]:
    """-> V (k,3) float64 [m], F (l,3) int32 with sides of about `edge` [m]: 0.93 of it on average, spread 13 %.

    V (n,3) float64 [m]; F (m,3) int, a surface with or without borders. Sides longer than 4/3 edge are split, those
    shorter than 4/5 collapsed, others flipped towards six neighbours a vertex; vertices are relaxed within the surface
    and projected back to it. Those on the border stay on the border's own polyline. Faces keep their orientation;
    vertices that no face uses are left out; a face listed twice counts once.

    Options: iterations=8 (1 to 100 rounds); crease_angle=1.05 (edges between faces whose normals differ by more stay [rad]). An
    unknown name is a TypeError.

    InputError: bad mesh or option; faces that form no surface (an edge of three faces, neighbours that run opposite
    ways, parts that share one vertex only) or whose corners lie on a line; an edge that makes more than 10 million faces.
    SolveError where CGAL gives up.
    Source: Botsch, Kobbelt, A remeshing approach to multiresolution modeling, 2004; CGAL's isotropic_remeshing.
    """
    return _core.remesh(as_vertices("remesh", "V", V), as_faces("remesh", "F", F), float(edge), **options)
