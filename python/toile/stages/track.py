"""Single-layer tracking: one rest surface for the person, a pose a frame, then a free-form fit of the surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import attrgetter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from .. import kernels
from ..config import TrackSettings
from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..kernels.arrays import Anything, Floats
from ..kernels.skeleton import SkeletonResult
from ..scene import HIDDEN, INTERPOLATED, OBSERVED, BodyModel, Frame, Person, Points3D, Tracked
from ..surface.keypoint_side import KeypointSide
from ..surface.keypoints import facial_places, learnt_offsets, with_offsets
from ..surface.operators import smooth_on
from ..surface.pose_search import PoseSearch, quick_solver
from ..surface.starts import Starts
from ..surface.two_sided import FAR, TwoSided
from ..vision.threads import parallel_map, parallel_map_with

HALVES = ("upperarm01", "lowerarm01", "upperleg01", "lowerleg01")  # roles of the joints where halves of limbs begin
HELD_STEP = 5  # of their vertices every fifth holds them
NO_OVERLAP = "scan.ply: the scan and the posed body do not overlap"
Sample = tuple[Frame, Points3D | None]
Surface = tuple[Floats, Anything]  # vertices (n,3) [m], confidence (n,) uint8
FACE = 5  # facial keypoints: of fewer no share is told that lies off the face


class Unmatched(UserError):
    """The body model does not reach the scans or keypoints of the frames `numbers`."""

    numbers: tuple[int, ...] = ()

    @classmethod
    def of(cls, numbers: Sequence[int], said: str) -> Unmatched:
        many = f"frame{'s' if len(numbers) > 1 else ''} {frame_ranges(numbers)}"
        error = cls(f"{many}: {said}")
        error.numbers = tuple(numbers)
        return error


def prepare(model: BodyModel, frames: Sequence[Sample], settings: TrackSettings) -> tuple[Person, list[Tracked]]:
    """The Person from sampled frames, and their Tracked. Unmatched: some of them fit no body.

    One shape is fitted to all of them with a pose each; each frame's free-form surface is then unposed, and where
    most frames saw it the mean of the offsets is added, smoothed, to the shape. Where the detector's keypoints lie beside
    the model's is learnt from the same frames.
    """
    fits = _shared_fit(model, frames, settings)
    _refuse_unmatched([frame.number for frame, _ in frames], fits)
    shape = np.asarray(fits[0].shape)
    rest, J = model.rest(shape)

    def fitted(surface, sample):
        (frame, _), fit = sample
        V = model.skin(rest, J, fit.rotations, fit.translation)
        return surface.found(frame.scan, V) if frame.scan is not None else _unseen(V)

    surfaces = parallel_map_with(lambda: _Surface(model, rest, settings), fitted, zip(frames, fits))
    if beyond := [frame.number for (frame, _), surface in zip(frames, surfaces) if surface is None]:
        raise Unmatched.of(beyond, NO_OVERLAP)
    offsets, weight = np.zeros_like(rest), np.zeros((len(rest), 1))
    for fit, (V, confidence) in zip(fits, surfaces):
        seen = (confidence == OBSERVED)[:, None]
        offsets += np.where(seen, model.unskin(V, J, fit.rotations, fit.translation) - rest, 0)
        weight += seen
    mean = offsets / np.maximum(weight, 1) * (weight >= max(len(frames) // 2, 1))
    poses = [(fit.rotations, fit.translation, fit.V) for fit, (_, points) in zip(fits, frames) if points is not None]
    found = [points for _, points in frames if points is not None]
    beside = learnt_offsets(model, J, poses, found, settings.keypoint_few_frames)
    person = Person(shape, rest + smooth_on(model.f, mean, settings.rest_smoothing), J, beside)
    tracker = Tracker(model, person, settings)
    return person, parallel_map(lambda one: tracker.tracked(*one[0], *one[1:]), zip(frames, fits, surfaces))


def _unseen(V):
    """A surface (n,3) that no scan shows, and its confidence."""
    return V, np.full(len(V), INTERPOLATED, np.uint8)


def _shared_fit(model, frames, settings):
    """One shape and a pose each. Where there are no keypoints the poses are searched first; where the fit lost a frame,
    after it, and all are fitted again."""
    solver, search = kernels.SkeletonSolver(model, **_options(settings)), _search(model, settings)
    evidence, starts, near = [_evidence(frame, points) for frame, points in frames], [], None
    for frame, points in frames:
        near = search.pose(frame.scan, near) if points is None and frame.scan is not None else None
        starts.append(near and near[0])
    fits = solver.solve_shared([_started(*pair) for pair in zip(evidence, starts)])
    astray = settings.search.astray
    lost = [f.scan is not None and search.measure(f.scan, fit)[1] > astray for (f, _), fit in zip(frames, fits)]
    if not any(lost) or not settings.headings:
        return fits
    starts = [search.pose(f.scan)[0] if gone else start for (f, _), start, gone in zip(frames, starts, lost)]
    again = solver.solve_shared([_started(*pair) for pair in zip(evidence, starts)])
    total = [
        sum(search.measure(f.scan, fit)[0] for (f, _), fit in zip(frames, made) if f.scan) for made in (fits, again)
    ]
    return again if total[1] < total[0] else fits


def _started(evidence, start):
    return evidence if start is None else evidence | {"start": start}


def _search(model, settings, person=None):
    return PoseSearch(model, settings.headings, settings.search, _options(settings), person)


class _Attempt(NamedTuple):
    """A pose that was fitted, and how far it lies from the scan, see TwoSided, and from the keypoints, see KeypointSide."""

    fit: SkeletonResult
    surface: np.ndarray | None  # (n,3) that gave the start
    distance: float
    astray: float
    keypoints: float
    contradicted: bool

    @property
    def cost(self):
        return self.distance + self.keypoints


class Tracker:
    """Tracks frames of one person; the template's part of the solvers is made once."""

    def __init__(self, model: BodyModel, person: Person, settings: TrackSettings):
        self.model, self.person, self.settings = model, person, settings
        beside = with_offsets(model, person.keypoint_offsets)
        self.skeleton = kernels.SkeletonSolver(
            beside, **_options(settings) | {"solve_shape": False, "surface_samples": settings.surface_samples}
        )
        self.keypoints = KeypointSide(model, person)
        self.surface, self.search = _Surface(model, person.rest, settings), _search(model, settings, person)
        self.poser = _Poser(model, person, settings) if settings.pose_vertices else None
        quick = quick_solver(model, settings.starts, _options(settings) | {"solve_shape": False})
        self.starts = Starts(model, person, settings.starts, quick, self.poser)

    def track(self, frame: Frame, points: Points3D | None, previous: Tracked | None = None) -> Tracked:
        """One frame; `previous` starts the pose and gives the temporal term. Where nothing gives a start, and where
        the frame was lost from it, the pose is searched."""
        person, model = self.person, self.model
        fit, V, measures = self._fit(frame, points, previous)
        _refuse_unmatched([frame.number], [fit])
        previous = None if measures.get("searched") else previous  # a pose of its own
        rest = person.rest if previous is None else self._start(previous)
        posed = model.skin(rest, person.J, fit.rotations, fit.translation)
        if frame.scan is None:
            surface = _unseen(posed)
        else:  # a surface that has followed a scan without a limb has drawn it elsewhere; keypoints tell where it is
            vouched = self.keypoints(fit.rotations, fit.translation, points).vouched
            held = np.flatnonzero(self.surface.lacking(frame.scan, posed))[::HELD_STEP] if vouched else ()
            surface = self.surface.fit(frame.scan, posed if V is None or len(held) else V, held)
        return self.tracked(frame, points, fit, surface, previous, measures)

    def tracked(
        self,
        frame: Frame,
        points: Points3D | None,
        fit: SkeletonResult,
        surface: Surface,
        previous: Tracked | None = None,
        measures: Mapping[str, float] = MappingProxyType({}),
    ) -> Tracked:
        """The Tracked of a frame whose pose was fitted; `measures` go to its diagnostics."""
        person, model, (V, confidence) = self.person, self.model, surface
        pose = np.asarray(fit.rotations), np.asarray(fit.translation)
        posed = model.skin(person.rest, person.J, *pose)
        if frame.scan is not None and self.poser is not None:
            pose = self.poser.pose(V, confidence, points, pose, previous)
        if not np.isfinite(V).all():
            raise UserError(f"frame {frame.number}: tracking left vertices that are not finite")
        moved = np.linalg.norm(V - posed, axis=1)[self.search.looks]
        diagnostics = {"skeleton_rms_m": float(fit.rms), "skeleton_iterations": float(fit.iterations), **measures}
        if points is not None and len(points.points):
            diagnostics["keypoints_kept"] = float(np.isfinite(points.points).all(1).mean())
            if points.gate:
                diagnostics["keypoint_gate_px"] = points.gate
        diagnostics["moved_mm"] = float(1e3 * moved.mean())
        diagnostics["moved_p95_mm"] = float(1e3 * np.percentile(moved, 95))
        face, left_out = self._face(*pose, points, V, confidence)
        facial = (
            0 if points is None else np.isfinite(points.points[np.isin(points.names, model.face_names)]).all(1).sum()
        )
        if facial >= FACE:
            diagnostics["face_off"] = left_out / int(facial)
        return Tracked(V, *pose, face, confidence, diagnostics)

    def _start(self, previous):
        """The person's rest surface (n,3), with a share of the frame's before that its surface was off the pose: a limb
        that turned about its axis without a bone's turning stays turned, and an error dies away."""
        person, share = self.person, self.settings.carried_share
        before = self.model.unskin(previous.vertices, person.J, previous.rotations, previous.translation)
        off = before - person.rest
        off *= np.minimum(1, self.settings.carried_reach / np.maximum(np.linalg.norm(off, axis=1), 1e-12))[:, None]
        return person.rest + share * off

    def _fit(self, frame, points, previous):
        """The pose of a frame, the surface (n,3) that gave its start, or None, and what the diagnostics say of it.

        It is the pose nearest to the scan from both sides and to the keypoints, of those from the frame before; where that lies
        farther from the scan than is usual, from other starts; where keypoints put a limb elsewhere, from these, with the scan and
        alone; and where nothing gives a start, or all have lost the scan, from a search."""
        evidence, scan, s = _evidence(frame, points), frame.scan, self.settings
        measure = None if scan is None else TwoSided(scan, self.search.looks)
        attempt = partial(self._attempt, points, measure)
        best, usual, others = None, np.inf, iter(())
        if previous is not None:
            before = (previous.rotations, previous.translation, self.person.shape)
            best = attempt(evidence, start=before, previous=[before])
            usual = previous.diagnostics.get("usual_mm", np.inf) / 1e3
        elif points is not None:
            best = attempt(evidence, start=self._cold_start(points))
        elif scan is None or not s.headings:
            best = attempt(evidence)
        if scan is None:
            return best.fit, None, {}
        if previous is not None and np.isfinite(usual):
            others = self.starts.of(scan, previous, points, measure)
        while best is not None and best.distance > s.starts.doubtful * usual:
            other = next(others, None)
            if other is None:
                break
            best = min(best, attempt(evidence, other[1], start=other[0]), key=attrgetter("cost"))
        if best is not None and best.contradicted:
            start = self._cold_start(points)
            again = attempt(evidence, start=start), attempt({"keypoints": points}, start=start)
            best = min(best, *again, key=attrgetter("cost"))
        searched = False
        if best is None or best.astray > s.search.astray or best.distance > s.search.farther * usual:
            start = self.search.pose(scan)[0]
            found = None if start is None else attempt(evidence, start=start)
            searched = found is not None and (best is None or s.search.as_close * found.cost < best.cost)
            best = found if searched else best
        pose_mm = 1e3 * best.distance
        usual_mm = (1e3 * usual + pose_mm) / 2 if np.isfinite(usual) and not searched else pose_mm
        told = {"pose_mm": pose_mm, "usual_mm": usual_mm, "astray": best.astray, "searched": float(searched)}
        return best.fit, best.surface, told

    def _attempt(self, points, measure, evidence, surface=None, **start):
        """The _Attempt of a pose fitted to this evidence from `start`, by a TwoSided `measure` of the scan, None without one;
        `surface` (n,3) gave the start."""
        fit = self.skeleton.solve(**evidence, **start)
        beside = self.keypoints(fit.rotations, fit.translation, points)
        if measure is None or fit.stop == "unmatched":
            return _Attempt(fit, surface, np.inf, 1.0, beside.distance, beside.contradicted)
        lacking = self.surface.lacking(measure.scan, fit.V) if beside.vouched else None
        return _Attempt(fit, surface, *measure(fit.V, lacking), beside.distance, beside.contradicted)

    def _cold_start(self, points):
        """Keypoints alone, with the person's shape, give the first pose."""
        K = len(self.model.parents)
        seen = points.points[~np.isnan(points.points).any(1)]
        middle = np.median(seen, axis=0) - np.median(self.person.J, axis=0) if len(seen) else np.zeros(3)
        start = kernels.SkeletonSolver(self.model, **_options(self.settings)).solve(keypoints=points)
        if start.stop == "unmatched":
            return np.zeros((K, 3)), middle, self.person.shape
        return np.asarray(start.rotations), np.asarray(start.translation), self.person.shape

    def _face(self, rotations, translation, points, V, confidence):
        """Facial keypoints in the head joint's frame (q,3), NaN where unseen, and how many were left out."""
        head = self.model.joint("head")
        if points is None or head is None:
            return np.full((len(self.model.face_names), 3), np.nan), 0
        transforms = R, x = self.model.joint_transforms(self.person.J, rotations, translation)
        offsets = self.person.keypoint_offsets
        places, left_out = facial_places(self.model, points, V, transforms, offsets, confidence, self.settings)
        return (places - x[head]) @ R[head], left_out


class _Poser:
    """The pose that a registered surface shows. Its vertices keep their identity, so they tell how far a limb has turned
    about its axis, where a bare scan does not."""

    def __init__(self, model, person, settings):
        self.settings = settings
        outside = np.flatnonzero(~model.inside)
        self.chosen = outside[:: max(len(outside) // settings.pose_vertices, 1)]
        self.names = tuple(f"vertex.{v}" for v in self.chosen)
        own = replace(model, v_template=person.rest, J=person.J, shapedirs=np.zeros((len(person.rest), 3, 0)))
        own = replace(own, J_shapedirs=np.zeros((len(person.J), 3, 0)))
        beside = with_offsets(own, person.keypoint_offsets)
        alike = replace(
            beside,
            keypoint_names=(*model.keypoint_names, *self.names),
            keypoint_joint=np.concatenate([beside.keypoint_joint, np.full(len(self.chosen), -1)]).astype(np.int64),
            keypoint_vertices=(*beside.keypoint_vertices, *(np.array([v]) for v in self.chosen)),
        )
        self.skeleton = kernels.SkeletonSolver(alike, **_options(settings) | {"solve_shape": False})

    def pose(self, V, confidence, points, start, previous=None):
        """(rotations, translation) from vertices (n,3), and the frame's own keypoints, Points3D or None. `previous`
        (Tracked) gives the temporal term."""
        sigma, shape = self.settings.pose_vertex_sigma, np.zeros(0)
        sigmas = np.where(confidence[self.chosen] == OBSERVED, sigma, sigma * self.settings.pose_unseen_factor)
        marks = Points3D(self.names, V[self.chosen], sigmas, np.ones(len(sigmas)))
        before = [] if previous is None else [(previous.rotations, previous.translation, shape)]
        fit = self.skeleton.solve(keypoints=_joined(points, marks), start=(*start, shape), previous=before)
        return np.asarray(fit.rotations), np.asarray(fit.translation)


def _joined(points, more):
    """Points3D of both; the first may be None."""
    if points is None:
        return more
    pairs = ((np.asarray(getattr(points, name)), getattr(more, name)) for name in ("points", "sigma", "views"))
    return Points3D((*points.names, *more.names), *(np.concatenate(pair) for pair in pairs))


class _Surface:
    """Free-form registration of the body's surface from a skinned start."""

    def __init__(self, model, rest, settings):
        self.model, self.settings = model, settings
        self.halves = list(_halves_of_limbs(model))
        self.solver = kernels.NricpSolver(rest, model.f, large_motion=False, rebase=True, **settings.nricp.model_dump())

    def lacking(self, scan, start):
        """(n,) bool: forearms, shanks and the like at `start` (n,3) that the scan lacks: half of such a part lies farther from the scan
        than two surfaces of one person do."""
        out = np.zeros(len(self.model.v_template), bool)
        for half in self.halves:
            out[half] = np.median(scan.index.closest(start[half[::HELD_STEP]], 4 * FAR)[3]) > 2 * FAR
        return out

    def fit(self, scan, start, held=()):
        """-> vertices (n,3) and confidence (n,). The vertices `held` (k,) stay about where they start. UserError: the scan lies
        elsewhere."""
        found = self.found(scan, start, held)
        if found is None:
            raise UserError(NO_OVERLAP)
        return found

    def found(self, scan, start, held=()):
        """`fit`; None where the scan lies elsewhere."""
        from scipy.sparse import csr_matrix

        chosen = csr_matrix((np.ones(len(held)), (range(len(held)), held)), (len(held), len(start)))
        landmarks = (chosen, start[held], self.settings.pose_vertex_sigma) if len(held) else None
        seen = {"scan_confidence": scan.confidence, "landmarks": landmarks}
        fit = self.solver.solve(scan.vertices, scan.faces, start=start, **seen)
        confidence = None if fit.stop == "no_overlap" else self._confidence(fit.V, scan)
        if confidence is None or not (confidence == OBSERVED).any():
            return None
        return fit.V, confidence

    def _confidence(self, V, scan):
        """Observed where the scan is near and faces the same way; interpolated beside that; else hidden."""
        face, _, _, distance = scan.index.closest(V, self.settings.interpolated_distance)
        normals = kernels.vertex_normals(V, self.model.f)
        same_side = np.einsum("ni,ni->n", normals, scan.face_normals[face]) > self.settings.min_cosine
        near = (face >= 0) & same_side
        confidence = np.where(
            near & (distance < self.settings.observed_distance), OBSERVED, np.where(near, INTERPOLATED, HIDDEN)
        )
        confidence[self.model.inside] = HIDDEN
        return confidence.astype(np.uint8)


def _halves_of_limbs(model):
    """Vertices (k,) of each upper and each lower half of the limbs that the model has, as cameras see them."""
    ends = [k for role in HALVES for side in "LR" if (k := model.joint(f"{role}.{side}")) is not None]
    half = np.full(len(model.parents), -1)
    for joint, parent in enumerate(model.parents):
        half[joint] = joint if joint in ends else half[parent] if parent >= 0 else -1
    of_vertex = half[model.mover]
    for joint in ends:
        yield np.flatnonzero((of_vertex == joint) & ~model.inside)


def _options(settings):
    """TrackSettings as the SkeletonSolver takes them."""
    return settings.skeleton.model_dump()


def _evidence(frame, points):
    scan = frame.scan
    return {
        "scan_V": None if scan is None else scan.vertices,
        "scan_F": None if scan is None else scan.faces,
        "scan_confidence": None if scan is None else scan.confidence,
        "scan_index": None if scan is None else scan.index,
        "keypoints": points,
    }


def _refuse_unmatched(numbers, fits):
    if beyond := [number for number, fit in zip(numbers, fits) if fit.stop == "unmatched"]:
        raise Unmatched.of(beyond, "the body model finds neither scan nor keypoints within reach")
