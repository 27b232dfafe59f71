"""A frame's pose, fitted from one start after another as long as the scan or the keypoints speak against it."""

from __future__ import annotations

from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from .. import kernels
from ..kernels.arrays import Floats
from ..kernels.skeleton import SkeletonResult
from ..scene import BodyModel, Mesh, Person, Points3D, Tracked
from .keypoint_side import KeypointSide
from .keypoints import with_offsets
from .pose_search import PoseSearch, quick_solver
from .starts import Starts
from .two_sided import TwoSided


def solver_evidence(scan: Mesh | None, points: Points3D | None) -> dict[str, Any]:
    """A frame's scan and keypoints as SkeletonSolver takes them."""
    return {
        "scan_V": None if scan is None else scan.vertices,
        "scan_F": None if scan is None else scan.faces,
        "scan_confidence": None if scan is None else scan.confidence,
        "scan_index": None if scan is None else scan.index,
        "keypoints": points,
    }


class Attempt(NamedTuple):
    """A pose that was fitted, and how far it lies from the scan, see TwoSided, and from the keypoints, see KeypointSide."""

    fit: SkeletonResult
    surface: Floats | None  # (n,3) [m] that gave the start
    distance: float  # [m], infinite without a scan
    astray: float
    keypoints: float  # [m]
    contradicted: bool

    @property
    def cost(self):
        return self.distance + self.keypoints


class _Seen(NamedTuple):
    """What a frame shows of the body."""

    scan: Mesh | None
    points: Points3D | None
    measure: TwoSided | None  # of the scan

    @property
    def evidence(self):
        return solver_evidence(self.scan, self.points)


class PoseCascade:
    """Fits the pose of one frame after another; the template's part of the solvers is made once. `search` is the person's,
    `poser` fits a pose to a surface, see Starts, `lacking(scan, V)` says which vertices (n,) of V (n,3) a scan lacks.
    `settings` are TrackSettings."""

    def __init__(self, model: BodyModel, person: Person, settings, search: PoseSearch, poser, lacking):
        self.model, self.person, self.settings, self.search, self.lacking = model, person, settings, search, lacking
        self.options = settings.skeleton.model_dump()
        kept_shape = self.options | {"solve_shape": False}
        beside = with_offsets(model, person.keypoint_offsets)
        self.skeleton = kernels.SkeletonSolver(beside, **kept_shape | {"surface_samples": settings.surface_samples})
        self.keypoints = KeypointSide(model, person)
        self.starts = Starts(model, person, settings.starts, quick_solver(model, settings.starts, kept_shape), poser)

    def fit(
        self, scan: Mesh | None, points: Points3D | None, previous: Tracked | None
    ) -> tuple[Attempt, dict[str, float]]:
        """The Attempt nearest to the scan from both sides and to the keypoints, and what the diagnostics say of it. It may be
        unmatched.

        The pose is fitted from the frame before; where it lies farther from the scan than is usual, from other starts;
        where keypoints put a limb elsewhere, from these; and where nothing gives a start, or all have lost the scan, from a
        search."""
        seen = _Seen(scan, points, None if scan is None else TwoSided(scan, self.search.looks))
        best = self._at_first(seen, previous)
        if scan is None:
            return best, {}
        usual = np.inf
        if previous is not None:
            usual = previous.diagnostics.get("usual_mm", np.inf) / 1e3
            best = self._from_other_starts(best, seen, previous, usual)
        if best is not None and best.contradicted:
            best = self._from_keypoints(best, seen)
        found = self._from_search(best, seen) if self._lost(best, usual) else None
        best, searched = (best, False) if found is None else (found, True)
        return best, _diagnostics(best, usual, searched)

    def _at_first(self, seen, previous):
        """The Attempt from the frame before, or from keypoints; None where neither is there and a search can give a start."""
        if previous is not None:
            before = (previous.rotations, previous.translation, self.person.shape)
            return self._attempt(seen, seen.evidence, start=before, previous=[before])
        if seen.points is not None:
            return self._attempt(seen, seen.evidence, start=self._pose_of_keypoints(seen.points))
        searchable = seen.scan is not None and self.settings.headings
        return None if searchable else self._attempt(seen, seen.evidence)

    def _from_other_starts(self, best, seen, previous, usual):
        """The best Attempt; further starts near the frame before are made and tried while it lies farther than `usual` [m]."""
        starts = self.starts.of(seen.scan, previous, seen.points, seen.measure)
        while best.distance > self.settings.starts.doubtful * usual:
            pose, surface = next(starts, (None, None))
            if pose is None:
                break
            best = min(best, self._attempt(seen, seen.evidence, surface, start=pose), key=attrgetter("cost"))
        return best

    def _from_keypoints(self, best, seen):
        """The best Attempt, of one that keypoints contradict and two that begin at these: closest points may draw a leg onto the
        other one, so one of the two knows no scan."""
        start = self._pose_of_keypoints(seen.points)
        both = self._attempt(seen, seen.evidence, start=start)
        alone = self._attempt(seen, {"keypoints": seen.points}, start=start)
        return min(best, both, alone, key=attrgetter("cost"))

    def _lost(self, best, usual):
        """Whether the best Attempt has lost the scan, off which poses have lain `usual` [m]; so it is where there is none."""
        s = self.settings.search
        return best is None or best.astray > s.astray or best.distance > s.farther * usual

    def _from_search(self, best, seen):
        """The Attempt from a search in the scan; None where it is no nearer than the best so far, or no search is asked for."""
        start = self.search.pose(seen.scan)[0]
        if start is None:
            return None
        found = self._attempt(seen, seen.evidence, start=start)
        return found if best is None or self.settings.search.as_close * found.cost < best.cost else None

    def _attempt(self, seen, evidence, surface=None, **start):
        """The Attempt of a pose fitted to this evidence from `start`, which `surface` (n,3) gave; measured by all that is seen."""
        fit = self.skeleton.solve(**evidence, **start)
        beside = self.keypoints(fit.rotations, fit.translation, seen.points)
        if seen.measure is None or fit.stop == "unmatched":
            return Attempt(fit, surface, np.inf, 1.0, beside.distance, beside.contradicted)
        lacking = self.lacking(seen.scan, fit.V) if beside.vouched else None
        return Attempt(fit, surface, *seen.measure(fit.V, lacking), beside.distance, beside.contradicted)

    @cached_property
    def _keypoint_solver(self):
        """Fits a pose to keypoints alone."""
        return kernels.SkeletonSolver(self.model, **self.options)

    def _pose_of_keypoints(self, points):
        """The pose that keypoints alone give, with the person's shape; at rest in their middle where they give none."""
        fit = self._keypoint_solver.solve(keypoints=points)
        if fit.stop != "unmatched":
            return np.asarray(fit.rotations), np.asarray(fit.translation), self.person.shape
        known = points.points[~np.isnan(points.points).any(1)]
        middle = np.median(known, axis=0) - np.median(self.person.J, axis=0) if len(known) else np.zeros(3)
        return np.zeros((len(self.model.parents), 3)), middle, self.person.shape


def _diagnostics(best, usual, searched):
    """Of an Attempt where poses lay `usual` [m] from their scans, infinite where there were none. What is usual then is half that,
    half its own distance; all its own where it was searched."""
    pose_mm = 1e3 * best.distance
    usual_mm = (1e3 * usual + pose_mm) / 2 if np.isfinite(usual) and not searched else pose_mm
    return {"pose_mm": pose_mm, "usual_mm": usual_mm, "astray": best.astray, "searched": float(searched)}
