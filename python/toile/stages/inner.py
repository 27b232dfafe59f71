"""The body under the garments, and the garments moved out of it."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import kernels
from ..config import InnerSettings
from ..kernels.arrays import Anything, Floats
from ..kernels.inner import InnerGuess
from ..scene import (
    HIDDEN,
    INTERPOLATED,
    OBSERVED,
    BodyModel,
    Dressed,
    GarmentTemplate,
    Inner,
    InnerShape,
    Mesh,
    Person,
    Segmented,
    Tracked,
)
from ..surface.attachments import Attachments
from ..surface.layering import Layering


@dataclass(frozen=True)
class Gathered:
    """What the frames of a block say in one pass of the fusion, as a file keeps it; see `kernels.InnerSums`."""

    position: Floats
    weight: Floats
    skin: Floats
    room: Anything
    frames: int


class Fusion:
    """The fused rest shape of a whole sequence, in memory that does not grow with it: while not `done`, every block is
    gathered at `guess`, and the blocks are added in their order. Blocks may be gathered by other processes."""

    def __init__(self, model: BodyModel, person: Person, templates: Sequence[GarmentTemplate], settings: InnerSettings):
        self.model, self.settings, self.J = model, settings, person.J
        self.worn = _Worn(templates)
        self.skin = Mesh(model.rest(person.shape)[0], model.skin_faces)
        self.solver = kernels.InnerSolver(model, person.shape, person.J, **settings.solver.model_dump())
        self.fusion = self.solver.fusion()

    @property
    def done(self) -> bool:
        return self.fusion.done

    @property
    def guess(self) -> InnerGuess:
        """What the frames of this pass are asked; it pickles."""
        return self.fusion.guess

    def gather(self, guess: InnerGuess, frames: Iterable[tuple[Tracked, Segmented, Mapping[str, Dressed]]]) -> Gathered:
        """What frames say, taken one at a time."""
        worn = self.worn
        sums = self.solver.gather(
            ((t.rotations, t.translation, t.vertices, worn.visible(s), worn.meshes(d)) for t, s, d in frames), guess
        )
        return Gathered(sums.position, sums.weight, sums.skin, sums.room, sums.frames)

    def step(self, blocks: Iterable[Gathered]) -> None:
        """Ends a pass, with the Gathered of every block in the blocks' order."""
        total = self.solver.gather((), self.guess)
        for block in blocks:
            total += kernels.InnerSums(block.position, block.weight, block.skin, block.room, int(block.frames))
        self.fusion.step(total)

    def shape(self) -> InnerShape:
        """The fused shape, once done; it warns of a spike."""
        fused = self.fusion.fused
        steepest, vertex = steepest_edge(self.skin, np.asarray(fused.rest), self.settings.spike_length)
        if steepest > self.settings.spike:
            near = np.argmin(np.linalg.norm(self.J - self.skin.vertices[vertex], axis=1))
            warnings.warn(
                f"the body fused under the garments has a spike near {self.model.joint_names[near]}: ends of an edge part "
                f"by {steepest:.1f} of its length; look at the labels there",
                stacklevel=2,
            )
        return InnerShape(np.asarray(fused.rest), {"iterations": float(fused.iterations), "steepest_edge": steepest})


def steepest_edge(skin: Mesh, moved: Floats, shortest: float) -> tuple[float, int]:
    """(steepness, vertex) of the edge of the Mesh `skin` whose ends part most on the way to `moved` (n,3): by how much [m],
    over its length, or over `shortest` [m] where that is more. A smooth displacement parts them by a fraction of it."""
    ends = skin.edges
    length = np.linalg.norm(np.diff(skin.vertices[ends], axis=1)[:, 0], axis=1)
    parted = np.linalg.norm(np.diff((moved - skin.vertices)[ends], axis=1)[:, 0], axis=1)
    steep = parted / np.maximum(length, shortest)
    worst = int(np.argmax(steep))
    return float(steep[worst]), int(ends[worst, 0])


class InnerLayer:
    """Solves frames against one fused shape; the solvers' factors are kept between frames."""

    def __init__(
        self,
        model: BodyModel,
        person: Person,
        inner_shape: InnerShape,
        templates: Sequence[GarmentTemplate],
        settings: InnerSettings,
    ):
        self.model, self.shape, self.worn = model, inner_shape, _Worn(templates)
        options = settings.solver.model_dump() | {"tolerance": settings.tolerance}
        self.solver = kernels.InnerSolver(model, person.shape, person.J, **options)
        garments = [(t.name, t.faces, len(t.rest)) for t in templates]
        self.layering = Layering(
            model.skin_faces,
            len(model.v_template),
            garments,
            rounds=settings.layering_rounds,
            **settings.untangle.model_dump(),
        )

    def solve(self, tracked: Tracked, segmented: Segmented, dressed: Mapping[str, Dressed]) -> Inner:
        """The inner body of one frame, then every garment out of the body and of the garments under it."""
        return self.layered(self.body(tracked, segmented, dressed), tracked, segmented, dressed)

    def body(self, tracked: Tracked, segmented: Segmented, dressed: Mapping[str, Dressed]) -> Floats:
        """The vertices (n,3) of the inner body of one frame."""
        pose, visible = (tracked.rotations, tracked.translation), self.worn.visible(segmented)
        fit = self.solver.solve(self.shape.rest, *pose, tracked.vertices, visible, self.worn.meshes(dressed))
        return np.asarray(fit.V)

    def layered(self, V: Floats, tracked: Tracked, segmented: Segmented, dressed: Mapping[str, Dressed]) -> Inner:
        """The Inner of one frame from its inner body (n,3): every garment out of it and of the garments under it."""
        visible = self.worn.visible(segmented)
        hidden = {name: d.confidence < OBSERVED for name, d in dressed.items()}
        layers = self.layering.solve(
            V, self.layering.move_inside({name: d.vertices for name, d in dressed.items()}, hidden)
        )
        confidence = np.where(visible > 0, np.maximum(tracked.confidence, INTERPOLATED), HIDDEN).astype(np.uint8)
        confidence[(visible > 0) & (tracked.confidence == OBSERVED)] = OBSERVED
        diagnostics = {f"{name}_depth_before_m": depth for name, depth in layers.depth_before.items()}
        left = layers.intersections_left
        return Inner(V, confidence, layers.vertices, left, diagnostics | {"intersections_left": float(left)})


class _Worn:
    """The garments of a run, of whose cloth the body is made."""

    def __init__(self, templates):
        self.labels = [t.label for t in templates]
        self.cloth = [(t.name, Attachments(t.faces, len(t.rest))) for t in templates]

    def visible(self, segmented):
        """(n,) 1 where the tracked surface is the inner layer, 0 on cloth."""
        return np.where(np.isin(segmented.vertices, self.labels), 0.0, 1.0)

    def meshes(self, dressed):
        """(vertices, faces) of each garment's cloth."""
        return [(dressed[name].vertices[a.cloth], a.faces) for name, a in self.cloth]
