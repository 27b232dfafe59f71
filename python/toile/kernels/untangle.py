"""Cloth out of a body, or out of the garment under it."""

from .. import _core
from .arrays import as_faces, as_vertices


class UntangleSolver:
    """Moves one garment out of one body, frame after frame; the topology and the spread's symbolic factor are kept.

    cloth_F (m,3), body_F (k,3); `cloth_n`, `body_n` numbers of vertices. A closed body tells its inside by winding
    numbers. An open one (another garment) tells it by its normals: keep its faces oriented outwards.

    The displacement d minimises |L d|^2 + (h / 2 spread)^4 |d|^2 subject to outward . (x + d - b) >= margin, with L the
    uniform graph Laplacian, h the mean edge length, b the closest point of the body; planes are renewed until no cloth
    vertex is inside and no triangle pair intersects (exact predicates).

    Options: margin=0.002 [m], less where two parts of the body leave less room than twice as much; spread=0.03 [m],
    the length over which a push dies away; tolerance=0.1, clear is (1 - tolerance) margin; max_depth=0.05 [m], an open
    body has no inside deeper than this; max_iterations=30. An unknown name is a TypeError.
    """

    def __init__(self, cloth_F, cloth_n, body_F, body_n, **options):
        name = "untangle"
        self._solver = _core.UntangleSolver(as_faces(name, "cloth_F", cloth_F), int(cloth_n), as_faces(name, "body_F", body_F), int(body_n), **options)

    def solve(self, cloth_V, body_V):
        """-> UntangleResult: .V (n,3); .displacement (n,3); .depth_before, .depth_after (n,) how far inside, 0 outside;
        .margin (n,) asked for at each vertex; .pairs_left (k,2) faces (cloth, body); .intersections_before,
        .intersections_left, .vertices_left counts; .iterations; .stop "clear", "stalled" or "iterations"; .reason in
        words when something is left. Lengths in metres. InputError for NaN and wrong sizes.
        """
        return self._solver.solve(as_vertices("untangle", "cloth_V", cloth_V), as_vertices("untangle", "body_V", body_V))


def untangle(cloth_V, cloth_F, body_V, body_F, margin=0.002, **options):
    """Moves cloth (n,3) out of a body to `margin` [m]: one line over `UntangleSolver`, which see."""
    cloth_V, body_V = as_vertices("untangle", "cloth_V", cloth_V), as_vertices("untangle", "body_V", body_V)
    return UntangleSolver(cloth_F, len(cloth_V), body_F, len(body_V), margin=margin, **options).solve(cloth_V, body_V)
