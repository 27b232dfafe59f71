"""Starts of a frame's pose beside the pose of the frame before: an arm may move farther from one frame to the next than
closest points are looked for, and its pose then stays behind, or goes to another part of the scan."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from .. import kernels
from ..scene import HIDDEN, OBSERVED


class Starts:
    """Further starts near the frame before, the surest first.

    `poser`: fits the pose to a surface: the last one, once that has followed the scan by rigid nodes alone, as an elastic
    sheet which knows no joints and so no limits of a step; None leaves that out. `quick`: a SkeletonSolver that looks far
    and gathers the limbs coarsely.
    """

    def __init__(self, model, person, settings, quick, poser):
        self.model, self.person, self.settings, self.quick, self.poser = model, person, settings, quick, poser

    @cached_property
    def follower(self):
        """Made when it is first asked for: few sequences need it."""
        return kernels.NricpSolver(self.person.rest, self.model.f, rebase=True, fine_iterations=0)

    def of(self, scan, previous, points, measure) -> Iterator[tuple]:
        """(pose, surface) for a scan after the Tracked `previous`: rotations, translation and shape, and the vertices (n,3)
        that have followed the scan, None where there are none. `measure` is a TwoSided of the scan."""
        before = (previous.rotations, previous.translation, self.person.shape)
        followed = None if self.poser is None else self._followed(scan, previous.vertices, measure)
        if followed is not None:
            V, matched = followed
            confidence = np.where(matched > self.settings.least_match, OBSERVED, HIDDEN)
            yield (*self.poser.pose(V, confidence, points, before[:2]), self.person.shape), V
        seen = {"scan_confidence": scan.confidence, "scan_index": scan.index}
        near = self.quick.solve(scan.vertices, scan.faces, start=before, **seen)
        yield (np.asarray(near.rotations), np.asarray(near.translation), self.person.shape), None

    def _followed(self, scan, V, measure):
        """Vertices (n,3) of the last surface moved to the scan, and the weights (n,) of their matches; None where it finds
        none. Repeated from its own answer, which becomes the shape at rest, while that comes nearer."""
        s, found, nearest = self.settings, None, np.inf
        for _ in range(s.follow_rounds):
            fit = self.follower.solve(scan.vertices, scan.faces, start=V, scan_confidence=scan.confidence)
            if fit.stop == "no_overlap":
                return found
            distance = measure(fit.V)[0]
            if distance < nearest:
                found = fit.V, fit.matched
            if distance > s.follow_nearer * nearest:
                return found
            V, nearest = fit.V, distance
        return found
