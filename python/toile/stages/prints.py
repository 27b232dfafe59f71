"""Printed garments slid along their surfaces, within a registration: reads the tracked surface, which is all that hides a garment
before the layers are parted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ..config import PrintSettings
from ..kernels.arrays import Anything, Floats
from ..prints.aligner import PrintAligner, PrintedLayer, Texture
from ..prints.views import Views
from ..scene import BodyModel, Camera, Dressed, Frame, GarmentTemplate, Person, Segmented, Tracked


def prepare(
    model: BodyModel,
    person: Person,
    templates: Sequence[GarmentTemplate],
    lengths: Mapping[str, Floats],
    cameras: Mapping[str, Camera],
    settings: PrintSettings,
    textures: Mapping[str, Anything] = MappingProxyType({}),
) -> PrintAligner:
    """What aligns the garments named in `lengths`, which gives each the vertices (g,3) whose edges' lengths its cloth keeps;
    `textures` (H,W,3) uint8 are those that templates show themselves."""
    layers = [PrintedLayer("body", -1, person.rest, model.f)]
    for t in templates:
        texture = Texture(textures[t.name], t.uv, t.face_uv) if t.name in textures else None
        layers.append(PrintedLayer(t.name, t.label, t.rest, t.faces, t.loops, lengths.get(t.name), texture))
    return PrintAligner(layers, cameras, settings)


def views(
    aligner: PrintAligner, frame: Frame, tracked: Tracked, segmented: Segmented, dressed: Mapping[str, Dressed]
) -> Views:
    """What the pictures of a frame show of every printed garment, which the tracked surface hides but for its cloth."""
    body, *garments = aligner.layers.values()
    cloth = np.isin(segmented.vertices, [garment.label for garment in garments])[body.faces].any(1)
    surfaces: list[Tracked | Dressed] = [tracked, *(dressed[garment.name] for garment in garments)]
    return aligner.views(frame, [s.vertices for s in surfaces], [s.confidence for s in surfaces], np.flatnonzero(cloth))


def slid(aligner: PrintAligner, name: str, dressed: Dressed, d: Floats) -> Dressed:
    """The garment `name` slid by d (g,2) [m] on its rest shape."""
    V, confidence = aligner.slid(name, dressed.vertices, dressed.confidence, d)
    mean = {"slide_mm": float(1e3 * np.linalg.norm(d, axis=1).mean())}
    return replace(dressed, vertices=V, confidence=confidence, diagnostics=dressed.diagnostics | mean)
