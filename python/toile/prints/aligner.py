"""Garments slid along their surfaces until the print on them lies as in a reference: which of a surface's points a vertex is,
scans and openings leave free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..kernels.arrays import Anything, Array, Floats, Ints
from ..scene import Camera, Frame
from .matching import Matched, Matcher
from .reference import Reference, print_of_texture, pyramid_of, reference_of
from .sliding import SlidingSurface
from .views import Places, PrintViews, Views


@dataclass(frozen=True)
class Texture:
    """What a template itself shows: `picture` (H,W,3) uint8 over `uv` (t,2), v up, with corners `face_uv` (m,3)."""

    picture: Anything
    uv: Floats
    face_uv: Ints


@dataclass(frozen=True)
class PrintedLayer:
    """A layer that pictures show; one with a `template` slides."""

    name: str
    label: int  # -1: the body's
    rest: Floats  # (n,3) on which slides are measured [m]
    faces: Ints  # (m,3)
    loops: Sequence[Ints] = ()  # open loops as vertex cycles
    template: Floats | None = None  # (n,3) whose edges' lengths the cloth keeps [m]
    texture: Texture | None = None


@dataclass(frozen=True)
class Target:
    """A reference, and what matches frames to it."""

    matcher: Matcher
    levels: list[Any]  # see `Matcher.target`
    reference: Reference


class PrintAligner:
    """Aligns the garments among the `layers`, inner to outer and body first, that have a template; `settings` are
    PrintSettings. Matching keeps state: one frame at a time."""

    def __init__(self, layers: Sequence[PrintedLayer], cameras: Mapping[str, Camera], settings: Any):
        self.settings, self.layers = settings, {layer.name: layer for layer in layers}
        self.matchers = {x.name: _matcher(x, settings) for x in layers if x.template is not None}
        lattices = {name: matcher.surface.lattice for name, matcher in self.matchers.items()}
        places = {name: Places(self.layers[name], x.face, x.bary) for name, x in lattices.items()}
        self._views = PrintViews(layers, places, cameras)

    def views(
        self, frame: Frame, vertices: Sequence[Floats], confidence: Sequence[Anything], covered: Array = ()
    ) -> Views:
        """What the pictures of a frame show of the garments that slide; arguments as for `PrintViews.of`."""
        return self._views.of(frame, vertices, confidence, covered)

    def references(
        self, numbers: Sequence[int], views: Sequence[Views], posed: Sequence[Mapping[str, Floats]], anchors: int
    ) -> dict[str, Reference]:
        """A reference a garment, of the frames `numbers` with surfaces `posed` (g,3), the first `anchors` of which follow one
        another; see `prints.reference`."""
        made = {}
        for name, matcher in self.matchers.items():
            seen, surfaces = [v[name] for v in views], [V[name] for V in posed]
            made[name] = reference_of(matcher, numbers, seen, surfaces, anchors, self._texture(name))
        return made

    def _texture(self, name):
        """The print (N,3) that a template shows itself, None without one."""
        texture, lattice = self.layers[name].texture, self.matchers[name].surface.lattice
        return None if texture is None else print_of_texture(lattice, texture.uv, texture.face_uv, texture.picture)

    def targets(self, references: Mapping[str, Reference]) -> dict[str, Target]:
        """What frames are matched to, from the references of all garments that slide."""
        made = {}
        for name, r in references.items():
            matcher = self.matchers[name] if r.start is None else self.matchers[name].about(r.start)
            made[name] = Target(matcher, matcher.target(r.values, r.weights), r)
        return made

    def match(
        self,
        number: int,
        views: Views,
        posed: Mapping[str, Floats],
        targets: Mapping[str, Target],
        previous: Mapping[str, Matched] | None = None,
    ) -> dict[str, Matched]:
        """The slides of the frame `number` with surfaces `posed` (g,3), from those of the `previous` frame if there is one."""
        matched = {}
        for name, target in targets.items():
            pyramid = pyramid_of(target.matcher, views[name], target.reference.offsets)
            starts = target.reference.starts(number) if previous is None else [previous[name].d]
            matched[name] = target.matcher.best(pyramid, target.levels, posed[name], starts)
        return matched

    def slid(self, name: str, V: Floats, confidence: Anything, d: Floats) -> tuple[Floats, Anything]:
        """Vertices (g,3) and confidence (g,) of a garment slid by d (g,2) [m] on its rest shape; each vertex is as sure as the
        one nearest to its new place."""
        surface = self.matchers[name].surface
        face, bary = surface.slid(d)
        return surface.curved_points_at(V, face, bary), confidence[surface.faces[face, bary.argmax(1)]]


def _matcher(layer, settings):
    surface = SlidingSurface(layer.rest, layer.faces, layer.loops, settings.lattice_spacing)
    return Matcher(surface, layer.template, settings)
