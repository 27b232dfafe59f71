"""Decoded garments moved out of the body and of one another (METHOD, Animation): no loss forbids intersections."""

from __future__ import annotations

from dataclasses import replace

import torch

from .. import kernels

MARGIN = 0.002  # of cloth off what lies under it [m]


class Untangler:
    """Garments out of the layers under them, inner to outer. `skin_faces`: those of the body that cloth can meet."""

    def __init__(self, layers, skin_faces):
        self.layers, self.skin_faces, self.solvers = list(layers), skin_faces, {}

    def __call__(self, decoded):
        """({layer: Decoded} of one sample, pairs of triangles that intersected, pairs left)."""
        before = left = 0
        under, moved = [], dict(decoded)
        for layer in self.layers:
            vertices = decoded[layer.name].vertices
            V = vertices[0].double().cpu().numpy()
            if layer.kind == "garment":
                for other, lower in under:
                    found = self._solver(layer, other).solve(V, lower)
                    V, before, left = found.V, before + found.intersections_before, left + found.intersections_left
                posed = torch.tensor(V, dtype=torch.float32, device=vertices.device)[None]
                moved[layer.name] = replace(decoded[layer.name], vertices=posed)
            under.append((layer, V))
        return moved, before, left

    def _solver(self, layer, under):
        key = layer.name, under.name
        if key not in self.solvers:
            faces = under.faces if under.kind == "garment" else self.skin_faces
            self.solvers[key] = kernels.UntangleSolver(layer.faces, len(layer.rest), faces, len(under.rest), margin=MARGIN)
        return self.solvers[key]
