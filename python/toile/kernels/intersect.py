"""Which triangles meet, and what lies inside: exact predicates and generalized winding numbers."""

from .. import _core
from .arrays import Array, Floats, Ints, as_faces, as_vertices


def intersecting_pairs(V1: Array, F1: Array, V2: Array, F2: Array) -> Ints:
    """Pairs of faces that intersect, (k,2) int32: (face of F1, face of F2), sorted.

    Decided by exact predicates: no tolerance. Closed triangles: touching counts; a face of no area is a segment or a
    point. V1 (n,3), V2 (m,3) [m]. InputError for empty meshes, NaN, or indices out of range.
    """
    name = "intersecting_pairs"
    first = as_vertices(name, "V1", V1), as_faces(name, "F1", F1)
    return _core.intersecting_pairs(*first, as_vertices(name, "V2", V2), as_faces(name, "F2", F2))


def self_intersections(V: Array, F: Array) -> Ints:
    """Pairs of faces of one mesh that intersect, (k,2) int32, first < second, sorted.

    Faces that share a vertex index are excluded. Exact, as `intersecting_pairs`.
    """
    return _core.self_intersections(as_vertices("self_intersections", "V", V), as_faces("self_intersections", "F", F))


def winding_number(points: Array, V: Array, F: Array) -> Floats:
    """Generalized winding number (k,) of points (k,3): 1 inside, 0 outside of a closed outward oriented mesh, 2 where two
    parts overlap, fractions near holes (Jacobson et al. 2013). Far faces are summed by moments (Barill et al. 2018):
    within 0.05 of the exact sum.
    """
    name = "winding_number"
    return _core.winding_number(as_vertices(name, "points", points), as_vertices(name, "V", V), as_faces(name, "F", F))


def signed_distance(points: Array, V: Array, F: Array) -> Floats:
    """Distance (k,) [m] of points (k,3) to the surface, negative inside.

    Inside is a winding number beyond 1/2 either way, so faces may all look inwards, and meshes that overlap themselves
    or have holes are no obstacle. There the
    distance is still to the nearest face, which may lie within the solid.
    """
    name = "signed_distance"
    return _core.signed_distance(as_vertices(name, "points", points), as_vertices(name, "V", V), as_faces(name, "F", F))
