"""The body under the garments: one fused rest shape for a sequence, then the body of each frame."""

from collections.abc import Iterable, Sequence
from typing import Any

from .. import _core
from .._core import InnerFused, InnerFusion, InnerResult, InnerSums, InputError
from .._core import InnerGuess as InnerGuess
from .arrays import Array, as_faces, as_floats, as_vertices
from .body import BodyArrays
from .rebuilt import Rebuilt

Garments = Iterable[tuple[Array, Array]]  # (V, F)
Frame = tuple[Array, Array, Array, Array, Garments]


class InnerSolver(Rebuilt):
    """Body under cloth for `body_model` (`toile.scene.BodyModel`); n vertices, K joints. `fuse` and `solve` minimise

        E(d) = length^4 |L d|^2_{M^-1} + sum_v m_v ( skin g_v |d_v - o_v|^2 + prior |d_v|^2
                                                   + out [n.d_v - b_v]_+^2 + f_v rho(t_v - n.d_v) )

    over displacements d: o is the tracked surface where it shows skin (g, falling to 0 within `taper` of the cloth),
    b the tightest room to the cloth along the normal less `gap`; t = mean room - gap - swing s, with s the room's standard
    deviation over the frames (a pull of the fusion alone), f = fit max(0, r^2 - misfit^2) / (swing_error + s)^2, r the
    root mean square of seen skin off the model along the normals. shape (s,): coefficients from tracking, where the
    refit starts; J (K,3): rest joints of the poses [m], by default those of `shape`.

    Kept: the rest shape, its areas and smoothness operator, and the symbolic analysis of the one pattern that all solves
    have. What is seen in a frame changes the values, so each solve makes its own numeric factors. Threads may share a
    solver and solve side by side.

    Options; an unknown name is a TypeError. Lengths [m]: length=0.08 (features shorter than this are smoothed away),
    fit_scale=0.02 (Geman-McClure scale of rho), still=0.004 (s is at least so large on average), swing_error=0.004,
    misfit=0.0035, gap=0.002 (cloth stays this far off the skin), taper=0.02 (skin counts fully only this far from the
    cloth, along the surface), reach=0.06 (cloth farther away says nothing),
    shape_sigma=0.01 (spread of the skin about the model's span), tolerance=2e-4 (stop when no vertex moves by more).
    Weights: skin=1e4, out=1e3, fit=400, swing=3.2, prior=0.5 as above; shape_observations=200 (independent observations
    that the skin counts as when the shape is refitted). seldom=0.1, often=0.25 (shares of the frames: skin that no more
    than `seldom` of them show is a wrong label; from `often` on it is skin; a smooth step between). tightness=0.1 (the
    bound of a hidden vertex is this quantile of its room over the frames), inward=0.4 (but cloth draws it inwards by at most this
    share of the body's thickness, along a ray: deeper, a limb would fold through itself), rounds=3 (cloth is looked for anew), max_iterations=8 (reweightings a round).

    After Zhang et al. 2017 (arXiv 1703.04454), own form.
    """

    def __init__(self, body_model: BodyArrays, shape: Array = (), J: Array | None = None, **options: Any) -> None:
        self.body_model = body_model
        core, shape = body_model.core, as_floats("inner", "shape", shape, (None,))
        if J is None:
            if len(shape) > body_model.J_shapedirs.shape[-1]:
                raise InputError(f"inner: shape has {len(shape)} entries, the model {body_model.J_shapedirs.shape[-1]}")
            J = body_model.J + body_model.J_shapedirs[..., : len(shape)] @ shape
        J = as_vertices("inner", "J", J)
        self._solver = _core.InnerSolver(core, shape, J, **options)
        self._keep(body_model, shape, J, **options)

    def fuse(self, frames: Sequence[Frame]) -> InnerFused:
        """One rest shape (n,3) for all frames.

        A frame is (rotations (K,3), translation (3,), tracked (n,3), visible (n,), garments): visible in [0,1], 1 where
        the tracked surface is the inner layer; garments [(V, F), ...] registered and posed. A vertex is skin where more
        than a stray frame shows it (`seldom`, `often`); a hidden one lies inside the tightest cloth (a low quantile over frames).
        -> .rest [m], .shape (S,) refitted, .bound (n,) room left to the cloth [m], .observed, .bounded, .stop (`Stop`),
        .iterations, .energy, .factorisations (numeric), .analyses (symbolic, beside the solver's own: 0).
        """
        return self._solver.fuse([_frame(f"frames[{i}]", *frame) for i, frame in enumerate(frames)])

    def fusion(self) -> InnerFusion:
        """The same for a sequence of any length in memory that does not grow with it:

            fusion = solver.fusion()
            while not fusion.done:
                fusion.step(solver.gather(frames, fusion.guess))  # all frames again, by an iterator
            fused = fusion.fused

        Sums of blocks add up (`+=`), so that blocks may be gathered by several processes: the same bits as long as the blocks
        are the same and are added in one order. InputError for a thread that asks while another is in `step`. Rooms are counted in steps of reach / 256, and read to within one.
        """
        return _core.InnerFusion(self._solver)

    def gather(self, frames: Iterable[Frame], guess: InnerGuess) -> InnerSums:
        """What frames, as in `fuse` and taken one at a time, say at a fusion's guess."""
        sums = self._solver.sums()
        for i, frame in enumerate(frames):
            name = f"frames[{i}]"
            self._solver.gather(_frame(name, *frame), guess, sums, name)
        return sums

    def solve(
        self,
        fused_rest: Array,
        rotations: Array,
        translation: Array,
        tracked: Array,
        visible: Array,
        garments: Garments,
    ) -> InnerResult:
        """The body of one frame: the fused rest shape posed, moved to the tracked skin and into the cloth, smoothly.

        -> .V (n,3) [m], .skin (n,) share of the tracked surface, .depth_before, .depth_after [m] and .outside_before,
        .outside_after: hidden vertices outside the cloth; .stop, .iterations, .energy, .factorisations as in `fuse`; .analyses:
        1 where what is solved, cloth and the skin beside it, is less than half of the body.
        """
        fused_rest = as_vertices("inner", "fused_rest", fused_rest)
        return self._solver.solve(fused_rest, _frame("frame", rotations, translation, tracked, visible, garments))


def _frame(name: str, rotations: Array, translation: Array, tracked: Array, visible: Array, garments: Garments) -> Any:
    return _core.InnerFrame(
        as_vertices("inner", f"{name}.rotations", rotations),
        as_floats("inner", f"{name}.translation", translation, (3,)),
        as_vertices("inner", f"{name}.tracked", tracked),
        as_floats("inner", f"{name}.visible", visible, (None,)),
        [
            _core.InnerGarment(
                as_vertices("inner", f"{name}.garments[{i}].V", V), as_faces("inner", f"{name}.garments[{i}].F", F)
            )
            for i, (V, F) in enumerate(garments)
        ],
    )
