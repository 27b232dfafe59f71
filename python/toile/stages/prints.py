"""Printed garments slid along their surfaces until the print on them lies as in a reference: which of a surface's points a
vertex is, scans and openings leave free. Reads the tracked surface, which is all that hides a garment before the layers are parted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ..kernels.arrays import Floats
from ..prints.colours import Places, unwrapped
from ..prints.matching import Matched, Matcher
from ..prints.reference import Reference, print_of_texture, pyramid_of, reference_of
from ..prints.sliding import SlidingSurface
from ..scene import BodyModel, Camera, Dressed, Frame, GarmentTemplate, Person, Segmented, Tracked
from ..vision.unwrapping import Unwrapped, Unwrapper

Views = Mapping[str, Sequence[Unwrapped]]  # of a garment's lattice, an Unwrapped a camera


@dataclass(frozen=True)
class _Drawn:
    """What an Unwrapper asks of a layer."""

    name: str
    label: int  # -1: the body's
    rest: Any  # (n,3)
    faces: Any  # (m,3)


@dataclass(frozen=True)
class Upon:
    """A reference, and what matches frames to it."""

    matcher: Matcher
    target: Any  # see `Matcher.target`
    reference: Reference


class PrintAligner:
    """Aligns the garments named in `lengths`, which gives each the vertices (g,3) whose edges' lengths its cloth keeps;
    `textures` (H,W,3) uint8 are those that templates show themselves. Matching keeps state: one frame at a time."""

    def __init__(
        self,
        model: BodyModel,
        person: Person,
        templates: Sequence[GarmentTemplate],
        lengths: Mapping[str, Floats],
        cameras: Mapping[str, Camera],
        settings: Any,
        textures: Mapping[str, Any] = MappingProxyType({}),
    ):
        self.faces, self.cameras, self.settings = model.f, cameras, settings
        self.templates, self.textures = {t.name: t for t in templates}, textures
        self.names, self.labels = [t.name for t in templates], [t.label for t in templates]
        self.matchers = {
            t.name: Matcher(
                SlidingSurface(t.rest, t.faces, t.loops, settings.lattice_spacing), lengths[t.name], settings
            )
            for t in templates
            if t.name in lengths
        }
        nothing = np.zeros(0, np.int64), np.zeros((0, 3))
        maps = [Places(_Drawn("", -1, person.rest, model.f), *nothing)]
        for t in templates:
            lattice = self.matchers[t.name].surface.lattice if t.name in lengths else None
            places = nothing if lattice is None else (lattice.face, lattice.bary)
            maps.append(Places(_Drawn(t.name, t.label, t.rest, t.faces), *places))
        self.unwrapper = Unwrapper(maps, self.labels)

    def views(self, frame: Frame, tracked: Tracked, segmented: Segmented, dressed: Mapping[str, Dressed]) -> Views:
        """What the pictures of a frame show of every printed garment, which the tracked surface hides but for its cloth."""
        layers = [tracked, *(dressed[name] for name in self.names)]
        cloth = np.isin(segmented.vertices, self.labels)[self.faces].any(1)
        self.unwrapper.frame(
            [layer.vertices for layer in layers], [layer.confidence for layer in layers], np.flatnonzero(cloth)
        )
        seen = dict(zip(self.names, unwrapped(self.unwrapper, frame, self.cameras)[1:]))
        return {name: seen[name] for name in self.matchers}

    def reference(
        self, numbers: Sequence[int], views: Sequence[Views], dressed: Sequence[Mapping[str, Dressed]], anchors: int
    ) -> dict[str, Reference]:
        """The references of the frames `numbers`, of which the first `anchors` follow one another; see `prints.reference`."""
        found = {}
        for name, matcher in self.matchers.items():
            posed = [d[name].vertices for d in dressed]
            found[name] = reference_of(matcher, numbers, [v[name] for v in views], posed, anchors, self._texture(name))
        return found

    def _texture(self, name):
        """The print (N,3) that a template shows itself, None without one."""
        if name not in self.textures:
            return None
        template, lattice = self.templates[name], self.matchers[name].surface.lattice
        return print_of_texture(lattice, template.uv, template.face_uv, self.textures[name])

    def upon(self, references: Mapping[str, Reference]) -> dict[str, Upon]:
        """What frames are matched with, from the references of all printed garments."""
        found = {}
        for name, r in references.items():
            matcher = self.matchers[name] if r.start is None else self.matchers[name].about(r.start)
            found[name] = Upon(matcher, matcher.target(r.values, r.weights), r)
        return found

    def match(
        self,
        number: int,
        views: Views,
        dressed: Mapping[str, Dressed],
        upon: Mapping[str, Upon],
        before: Mapping[str, Matched] | None = None,
    ) -> dict[str, Matched]:
        """The slides of the frame `number`, from those of the frame `before`."""
        found = {}
        for name, to in upon.items():
            pyramid = pyramid_of(to.matcher, views[name], to.reference.offsets)
            starts = to.reference.starts(number) if before is None else [before[name].d]
            found[name] = to.matcher.best(pyramid, to.target, dressed[name].vertices, starts)
        return found

    def slid(self, name: str, dressed: Dressed, d: Floats) -> Dressed:
        """The garment `name` slid by d (g,2) [m] on its rest shape; each vertex as sure as the one nearest to its new place."""
        surface = self.matchers[name].surface
        face, bary = surface.slid(d)
        V = surface.curved_points_at(dressed.vertices, face, bary)
        told = {"slide_mm": float(1e3 * np.linalg.norm(d, axis=1).mean())}
        sure = dressed.confidence[surface.faces[face, bary.argmax(1)]]
        return replace(dressed, vertices=V, confidence=sure, diagnostics=dressed.diagnostics | told)
