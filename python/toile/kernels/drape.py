"""Cloth that hangs on a body which moves, by extended position-based dynamics."""

from typing import Any

import numpy as np

from .. import _core
from .._core import DrapeResult
from .arrays import Array, Floats, as_faces, as_floats, as_indices, as_vertices
from .rebuilt import Rebuilt


class DrapeSolver(Rebuilt):
    """One garment over one body that moves.

    cloth_F (m,3), body_F (k,3); `cloth_n`, `body_n` numbers of vertices; `lengths` (e,) of the edges at rest [m], in the
    order of `unique_edges(cloth_F)`; `held` (h,) vertices of the cloth that go where each step tells them.

    Each substep of h seconds predicts x + h v + h^2 g, then solves constraints C with compliance a in turn:
    x_i -= w_i grad_i C  C / (sum_j w_j |grad_j C|^2 + a / h^2), w = 1 / mass (XPBD: Macklin et al. 2016, equation 18; small
    steps: Macklin et al. 2019). Edges keep their lengths, a = length^2 / (stretch area of the edge's faces); hinges of two
    faces are flat at rest (Bergou et al. 2006), a = area / (3 bending). Then each vertex is kept outside of the moving body,
    with Coulomb friction; what pushes a vertex out gives it no velocity. Faces of the cloth do not meet one another: count
    them by `self_intersections`.

    Options: gravity=(0, 0, -9.81) [m/s^2]; density=0.2 [kg/m^2]; stretch=500 [N/m]; bending=1e-5 [N m]; friction=0.6, Coulomb's
    coefficient; margin=0.002 [m] between cloth and body; drag=0 [1/s], the share of its velocity that cloth loses;
    dry_drag=0 [m/s^2], the deceleration of all that moves, however slowly, as by friction inside the cloth; substep=1/1500 [s],
    the longest; max_depth=0.05 [m], an open body has no inside deeper than this. An unknown name is a TypeError.

    The same bits for any number of threads. A copy has to be started anew. InputError where two threads are in `start` or `step` at once.
    """

    def __init__(
        self, cloth_F: Array, cloth_n: int, lengths: Array, body_F: Array, body_n: int, held: Array = (), **options: Any
    ) -> None:
        name = "drape"
        cloth = as_faces(name, "cloth_F", cloth_F), int(cloth_n), as_floats(name, "lengths", lengths, (None,))
        fixed = as_indices(name, "held", np.zeros(0, np.int32) if len(np.asarray(held)) == 0 else held)
        parts = *cloth, as_faces(name, "body_F", body_F), int(body_n), fixed
        self._solver = _core.DrapeSolver(*parts, **options)
        self._keep(*parts, **options)

    def start(self, V: Array, body_V: Array, settle: float = 0.5) -> DrapeResult:
        """Puts the cloth at V (n,3), at rest, and lets it settle for `settle` seconds of heavy drag on the still body (b,3).

        -> DrapeResult: .V (n,3); .contacts, vertices that the body carries; .inside, vertices inside the body; .strain of the
        most stretched edge, its elongation over its rest length, or a tenth of the mean one. InputError for NaN, wrong
        sizes, and a closed body around no volume.
        """
        return self._solver.start(as_vertices("drape", "V", V), as_vertices("drape", "body_V", body_V), float(settle))

    def step(self, body_V: Array, dt: float, held_V: Array | None = None) -> DrapeResult:
        """The body goes linearly to body_V (b,3) in `dt` seconds, held vertices to held_V (h,3); without it they stay."""
        held = np.zeros((0, 3)) if held_V is None else held_V
        return self._solver.step(
            as_vertices("drape", "body_V", body_V), float(dt), as_vertices("drape", "held_V", held)
        )


def drape(
    V: Array,
    cloth_F: Array,
    lengths: Array,
    body_V: Array,
    body_F: Array,
    dt: float,
    settle: float = 0.5,
    **options: Any,
) -> Floats:
    """Cloth (T,n,3) over a body that moves, body_V (T,b,3), frames `dt` seconds apart: settled from V (n,3) on the first
    frame, then carried along. One line over `DrapeSolver`, which see."""
    V, bodies = as_vertices("drape", "V", V), as_floats("drape", "body_V", body_V, (None, None, 3))
    if not len(bodies):
        raise _core.InputError("drape: body_V holds no frame")
    solver = DrapeSolver(cloth_F, len(V), lengths, body_F, bodies.shape[1], **options)
    return np.stack([solver.start(V, bodies[0], settle).V, *(solver.step(body, dt).V for body in bodies[1:])])
