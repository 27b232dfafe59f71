"""The body under the garments, and the garments moved out of it."""

import numpy as np

from . import kernels
from .scene import HIDDEN, INTERPOLATED, OBSERVED, Inner, InnerShape


def prepare(model, person, samples, templates, settings):
    """The fused rest shape from sampled frames [(Tracked, Segmented, {name: Dressed})]."""
    solver = kernels.InnerSolver(model, person.shape, person.J)
    frames = [
        (t.rotations, t.translation, t.vertices, _visible(t, s, templates), _meshes(templates, d)) for t, s, d in samples
    ]
    fused = solver.fuse(frames)
    return InnerShape(np.asarray(fused.rest), {"iterations": float(fused.iterations)})


class InnerLayer:
    """Solves frames against one fused shape; the solvers' factors are kept between frames."""

    def __init__(self, model, person, inner_shape, templates, settings):
        self.model, self.shape, self.templates = model, inner_shape, templates
        self.solver = kernels.InnerSolver(model, person.shape, person.J, tolerance=settings.tolerance)
        self.margin = settings.margin
        self.untanglers = {}

    def solve(self, tracked, segmented, dressed):
        """The inner body of one frame, then every garment out of the body and of the garments under it."""
        visible = _visible(tracked, segmented, self.templates)
        meshes = _meshes(self.templates, dressed)
        fit = self.solver.solve(
            self.shape.rest, tracked.rotations, tracked.translation, tracked.vertices, visible, meshes
        )
        V = np.asarray(fit.V)
        garments, diagnostics, left = self._untangle(V, dressed)
        confidence = np.where(visible > 0, np.maximum(tracked.confidence, INTERPOLATED), HIDDEN).astype(np.uint8)
        confidence[(visible > 0) & (tracked.confidence == OBSERVED)] = OBSERVED
        return Inner(V, confidence, garments, left, diagnostics | {"intersections_left": float(left)})

    def _untangle(self, V, dressed):
        obstacles, garments, diagnostics, left = [("", V, self.model.skin_faces)], {}, {}, 0
        for template in self.templates:
            cloth, pairs = dressed[template.name].vertices, 0
            for under, body_V, body_F in obstacles:
                moved = self._untangler(template, under, body_F, len(body_V)).solve(cloth, body_V)
                cloth = np.asarray(moved.V)
                pairs += int(moved.intersections_left)
                diagnostics[f"{template.name}_depth_before_m"] = float(np.max(moved.depth_before, initial=0))
            garments[template.name] = cloth
            left += pairs
            obstacles.append((template.name, cloth, template.faces))
        return garments, diagnostics, left

    def _untangler(self, template, under, body_F, body_n):
        """Of a garment from what lies under it; "" is the skin."""
        key = template.name, under
        if key not in self.untanglers:
            self.untanglers[key] = kernels.UntangleSolver(template.faces, len(template.rest), body_F, body_n, margin=self.margin)
        return self.untanglers[key]


def _visible(tracked, segmented, templates):
    """1 where the tracked surface is the inner layer, 0 on cloth."""
    cloth = np.isin(segmented.vertices, [t.label for t in templates])
    return np.where(cloth, 0.0, 1.0)


def _meshes(templates, dressed):
    return [(dressed[t.name].vertices, t.faces) for t in templates]
