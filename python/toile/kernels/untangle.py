"""Cloth out of a body, or out of the garment under it."""

from typing import Any

from .. import _core
from .._core import UntangleResult
from .arrays import Array, as_faces, as_vertices
from .rebuilt import Rebuilt


class UntangleSolver(Rebuilt):
    """Moves one garment out of one body, frame after frame.

    Kept: topology, the order in which the membrane's vertices are updated, trees of boxes, which are refitted, and the
    faces under the last frame's cloth, where the next one's search begins. There is no matrix and no factor. Of threads that
    share a solver one solves while the others wait.

    cloth_F (m,3), body_F (k,3); `cloth_n`, `body_n` numbers of vertices. A closed body tells its inside by winding
    numbers; a pocket turned inside out (-1) is inside as well. An open one (another garment) tells it by its normals: keep its faces oriented outwards.

    The displacement d minimises  sum over edges |d_i - d_j|^2 + 1.5 (h / spread)^2 sum_i |d_i|^2  subject to
    outward_i . (x_i + d_i - b_i) >= margin_i, with h the mean edge length and b_i the closest point of the body: a membrane
    whose pushes die away by a factor of e over `spread`. Planes are renewed until no cloth vertex is inside and no
    triangle pair intersects (exact predicates); limbs that pass right through the cloth are led to its border.

    Options: margin=0.002 [m], less where two parts of the body leave less room than twice as much; spread=0.03 [m];
    relative_tolerance=0.1, clear is (1 - relative_tolerance) margin; max_depth=0.05 [m], an open body has no inside deeper than this, and no
    vertex is pushed further through parts that overlap; max_iterations=60 solves of the membrane. An unknown name is a TypeError.
    """

    def __init__(self, cloth_F: Array, cloth_n: int, body_F: Array, body_n: int, **options: Any) -> None:
        name = "untangle"
        meshes = as_faces(name, "cloth_F", cloth_F), int(cloth_n), as_faces(name, "body_F", body_F), int(body_n)
        self._solver = _core.UntangleSolver(*meshes, **options)
        self._keep(*meshes, **options)

    def solve(self, cloth_V: Array, body_V: Array) -> UntangleResult:
        """-> UntangleResult: .V (n,3); .displacement (n,3); .depth_before, .depth_after (n,) how far inside, 0 outside;
        .margin (n,) asked for at each vertex; .pairs_left (k,2) faces (cloth, body); .intersections_before,
        .intersections_left, .vertices_left (inside), .vertices_short (nearer than their margin) counts; .iterations;
        .stop (`Stop`) "clear" (none of these left), "stalled" or "max_iterations"; .reason in words when not clear.
        Lengths in metres. InputError for NaN, wrong sizes, and a closed body around no volume.
        """
        return self._solver.solve(
            as_vertices("untangle", "cloth_V", cloth_V), as_vertices("untangle", "body_V", body_V)
        )


def untangle(
    cloth_V: Array, cloth_F: Array, body_V: Array, body_F: Array, margin: float = 0.002, **options: Any
) -> UntangleResult:
    """Moves cloth (n,3) out of a body to `margin` [m]: one line over `UntangleSolver`, which see."""
    cloth_V, body_V = as_vertices("untangle", "cloth_V", cloth_V), as_vertices("untangle", "body_V", body_V)
    return UntangleSolver(cloth_F, len(cloth_V), body_F, len(body_V), margin=margin, **options).solve(cloth_V, body_V)
