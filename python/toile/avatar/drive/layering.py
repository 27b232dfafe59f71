"""Decoded garments moved out of the body and of one another (docs/method/animation.md): no loss forbids intersections."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import torch

from ...surface.layering import Layering

MARGIN = 0.002  # of cloth off what lies under it [m]
# options of kernels.UntangleSolver: parts of a limb's width are crossed
PATIENT = {"max_depth": 0.2, "max_iterations": 300}


class GarmentLayering:
    """Garments out of the layers under them, inner to outer. `skin_faces`: those of the body that cloth can meet."""

    def __init__(self, layers, skin_faces):
        self.body = next(layer for layer in layers if layer.kind != "garment")
        self.garments = [layer for layer in layers if layer.kind == "garment"]
        self.skin_faces = skin_faces
        self.layering = self._layering()

    def _layering(self, **options):
        sizes = [(layer.name, layer.faces, len(layer.rest)) for layer in self.garments]
        return Layering(self.skin_faces, len(self.body.rest), sizes, MARGIN, **options)

    @cached_property
    def patient(self):
        """Made where a frame keeps pairs: few animations have one."""
        return self._layering(**PATIENT)

    def __call__(self, decoded):
        """({layer: Decoded} of one sample, pairs of triangles that intersected, pairs left). What keeps pairs, as where the body
        runs through itself, is tried once more with patience; the fewer pairs count."""
        body, cloth = _points(decoded[self.body.name]), {g.name: _points(decoded[g.name]) for g in self.garments}
        found = self.layering.solve(body, cloth)
        if found.intersections_left:
            again = self.patient.solve(body, cloth)
            found = min(found, again, key=lambda f: f.intersections_left)
        moved = dict(decoded)
        for name, V in found.vertices.items():
            posed = torch.tensor(V, dtype=torch.float32, device=decoded[name].vertices.device)[None]
            moved[name] = replace(decoded[name], vertices=posed)
        return moved, found.intersections_before, found.intersections_left


def _points(decoded):
    return decoded.vertices[0].double().cpu().numpy()
