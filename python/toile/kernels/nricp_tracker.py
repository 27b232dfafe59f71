"""A template followed through a sequence of scans by non-rigid registration alone."""

from collections.abc import Callable
from functools import cache
from threading import Lock
from typing import Any

import numpy as np

from .._core import InputError, NricpResult
from .arrays import Array, Floats, as_faces, as_vertices
from .geometry import SurfaceIndex, face_areas
from .nricp import NricpSolver
from .rebuilt import Rebuilt

Scan = tuple[Floats, Any]  # V (p,3) [m], F (t,3)
Surface = Callable[[], SurfaceIndex]
SAMPLES = 3000  # points of either side that are asked how far they lie off
REACH = 0.05  # of the template's size: distances count up to this, so that clutter does not decide
AGAIN = 3  # fits from the last answer, at most, while each
BETTER = 0.95  # comes this much nearer than the one before
DOUBTFUL, LOST = 1.1, 1.5  # times the usual distance: more is tried, and starts from afar too
USUAL = 15  # answers that say what is usual


class NricpTracker(Rebuilt):
    """Follows one template V (n,3) [m], F (m,3) from scan to scan; V lies where the first scan is, or near.

    Each scan is fitted twice by `NricpSolver`. First from the last answer, whose own bending costs nothing, by nodes
    alone, so that a limb that is bent far stays bent and moves on. Then from there with the rest shape V as anchor of
    rigidity, softly, so that lengths are V's in every frame and errors do not add up. What came out is judged by
    `distance` [m]: the mean from the scan to the template, plus that from the template's matched vertices to the scan.
    Where it is above the usual, the continuation at constant velocity is a second start, and the fit is repeated from the
    nearest answer while that comes nearer. Where it is far above, a limb is lost: large motions of the last answer and
    of V are tried too. A frame costs two solves where all goes well, up to twenty where it does not.

    preset and options are those of NricpSolver (`large_motion`, `rebase` and `passes` are the tracker's own).
    """

    def __init__(self, V: Array, F: Array, preset: str = "standard", **options: Any) -> None:
        V, F = as_vertices("nricp", "V", V), as_faces("nricp", "F", F)
        for name in ("large_motion", "rebase", "passes"):
            if name in options:
                raise TypeError(f"NricpTracker: {name} is the tracker's own")
        self._V, self._F = V, F
        nodes_alone = {"rebase": True, "fine_iterations": 0}
        soft = {"iterations": [0, 4, 3], "stiffness_start": [0.02] * 3, "stiffness_end": [0.01] * 3}
        self._follow = NricpSolver(V, F, preset, large_motion=False, **options | nodes_alone)
        self._search = NricpSolver(V, F, preset, **options | nodes_alone)
        self._anchor = NricpSolver(V, F, preset, large_motion=False, **soft | options)
        self._turn = Lock()
        self._reach = REACH * float(np.sqrt(face_areas(V, F).sum()))
        self.reset()
        self._keep(V, F, preset, **options)

    def reset(self) -> None:
        """Forgets the sequence: the next scan is the first."""
        self._last: list[Floats] = []  # the answers of the last two scans, newest first
        self._distances: list[float] = []
        self.distance = np.nan

    def next(self, scan_V: Array, scan_F: Array) -> NricpResult:
        """Fits the next scan (p,3) [m], (t,3). The result is that of `NricpSolver.solve`; its `stop` is "no_overlap" where
        no start found the scan, which leaves the state as it was. InputError where another thread is in `next`."""
        if not self._turn.acquire(blocking=False):
            raise InputError(
                "nricp: another thread is at work on this object, which follows one sequence: make one for each"
            )
        try:
            return self._next(scan_V, scan_F)
        finally:
            self._turn.release()

    def _next(self, scan_V: Array, scan_F: Array) -> NricpResult:
        scan = as_vertices("nricp", "scan_V", scan_V), as_faces("nricp", "scan_F", scan_F)
        surface = cache(lambda: SurfaceIndex(*scan))  # once a solver has taken the scan, or refused it by name
        if self._last:
            best = self._fit(self._follow, self._last[0], scan, surface)
        else:
            best = self._fit(self._search, self._V, scan, surface)
        if best[0] > DOUBTFUL * self._usual():
            if len(self._last) == 2:
                moved_on = 2 * self._last[0] - self._last[1]
                best = _nearest(best, self._fit(self._follow, moved_on, scan, surface))
            best = self._repeated(best, scan, surface)
        if self._last and best[0] > LOST * self._usual():
            for start in (self._last[0], self._V):
                best = _nearest(best, self._fit(self._search, start, scan, surface))
            best = self._repeated(best, scan, surface)
        distance, result = best
        if np.isfinite(distance):
            self._last = [result.V, *self._last[:1]]
            self._distances = [*self._distances[1 - USUAL :], distance]
        self.distance = distance
        return result

    def _usual(self) -> float:
        return float(np.median(self._distances)) if self._distances else 0.0

    def _fit(self, solver: NricpSolver, start: Floats, scan: Scan, surface: Surface) -> tuple[float, NricpResult]:
        """(distance, result) of one start; infinite where it does not overlap the scan."""
        result = solver.solve(scan[0], scan[1], start=start)
        if result.stop != "no_overlap":
            result = self._anchor.solve(scan[0], scan[1], start=result.V)
        if result.stop == "no_overlap":
            return np.inf, result
        return self._distance(result, scan, surface), result

    def _repeated(self, best: tuple[float, NricpResult], scan: Scan, surface: Surface) -> tuple[float, NricpResult]:
        for _ in range(AGAIN):
            if not np.isfinite(best[0]):
                break
            before, again = best[0], self._fit(self._follow, best[1].V, scan, surface)
            best = _nearest(best, again)
            if again[0] >= BETTER * before:
                break
        return best

    def _distance(self, result: NricpResult, scan: Scan, surface: Surface) -> float:
        points, seen = scan[0], result.V[result.matched > 0]
        there = SurfaceIndex(result.V, self._F).closest(points[:: -(-len(points) // SAMPLES)])[3]
        back = surface().closest(seen[:: -(-len(seen) // SAMPLES) or 1])[3] if len(seen) else np.full(1, np.inf)
        return float(np.minimum(there, self._reach).mean() + np.minimum(back, self._reach).mean())


def _nearest(*tried: tuple[float, NricpResult]) -> tuple[float, NricpResult]:
    return min(tried, key=lambda one: one[0])
