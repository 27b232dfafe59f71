"""Single-layer tracking: one rest surface for the person, a pose a frame, then a free-form fit of the surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from .. import kernels
from ..config import TrackSettings
from ..errors import UserError
from ..frame_numbers import frame_ranges
from ..kernels.arrays import Anything, Floats
from ..kernels.skeleton import SkeletonResult
from ..scene import HIDDEN, INTERPOLATED, OBSERVED, BodyModel, Frame, Person, Points3D, Tracked
from ..surface.cascade import PoseCascade, solver_evidence
from ..surface.keypoints import facial_places, learnt_offsets, with_offsets
from ..surface.operators import smooth_on
from ..surface.pose_search import PoseSearch
from ..surface.two_sided import FAR
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

    def registered(surface, sample):
        (frame, _), fit = sample
        V = model.skin(rest, J, fit.rotations, fit.translation)
        return surface.fit_or_none(frame.scan, V) if frame.scan is not None else _unseen(V)

    surfaces = parallel_map_with(lambda: _Surface(model, rest, settings), registered, zip(frames, fits))
    if beyond := [frame.number for (frame, _), surface in zip(frames, surfaces) if surface is None]:
        raise Unmatched.of(beyond, NO_OVERLAP)
    offsets, weight = np.zeros_like(rest), np.zeros((len(rest), 1))
    for fit, (V, confidence) in zip(fits, surfaces):
        seen = (confidence == OBSERVED)[:, None]
        offsets += np.where(seen, model.unskin(V, J, fit.rotations, fit.translation) - rest, 0)
        weight += seen
    mean = offsets / np.maximum(weight, 1) * (weight >= max(len(frames) // 2, 1))
    poses = [(fit.rotations, fit.translation, fit.V) for fit, (_, points) in zip(fits, frames) if points is not None]
    keypoints = [points for _, points in frames if points is not None]
    beside = learnt_offsets(model, J, poses, keypoints, settings.keypoint_few_frames)
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
    evidence, starts, near = [solver_evidence(frame.scan, points) for frame, points in frames], [], None
    for frame, points in frames:
        near = search.pose(frame.scan, near) if points is None and frame.scan is not None else None
        starts.append(near and near[0])
    fits = solver.solve_shared([_started(*pair) for pair in zip(evidence, starts)])
    scans, astray = [frame.scan for frame, _ in frames], settings.search.astray
    lost = [scan is not None and search.measure(scan, fit)[1] > astray for scan, fit in zip(scans, fits)]
    if not any(lost) or not settings.headings:
        return fits
    starts = [search.pose(scan)[0] if gone else start for scan, start, gone in zip(scans, starts, lost)]
    again = solver.solve_shared([_started(*pair) for pair in zip(evidence, starts)])
    off = lambda fits: sum(search.measure(scan, fit)[0] for scan, fit in zip(scans, fits) if scan is not None)
    return again if off(again) < off(fits) else fits


def _started(evidence, start):
    return evidence if start is None else evidence | {"start": start}


def _search(model, settings, person=None):
    return PoseSearch(model, settings.headings, settings.search, _options(settings), person)


class Tracker:
    """Tracks frames of one person; the template's part of the solvers is made once."""

    def __init__(self, model: BodyModel, person: Person, settings: TrackSettings):
        self.model, self.person, self.settings = model, person, settings
        self.surface, self.search = _Surface(model, person.rest, settings), _search(model, settings, person)
        self.poser = _Poser(model, person, settings) if settings.pose_vertices else None
        self.cascade = PoseCascade(model, person, settings, self.search, self.poser, self.surface.lacking)

    def track(self, frame: Frame, points: Points3D | None, previous: Tracked | None = None) -> Tracked:
        """One frame; `previous` starts the pose and gives the temporal term. Where nothing gives a start, and where
        the frame was lost from it, the pose is searched."""
        attempt, measures = self.cascade.fit(frame.scan, points, previous)
        _refuse_unmatched([frame.number], [attempt.fit])
        previous = None if measures.get("searched") else previous  # a pose of its own
        rest = self.person.rest if previous is None else self._start(previous)
        posed = self.model.skin(rest, self.person.J, attempt.fit.rotations, attempt.fit.translation)
        surface = _unseen(posed) if frame.scan is None else self._registered(frame.scan, points, attempt, posed)
        return self.tracked(frame, points, attempt.fit, surface, previous, measures)

    def _registered(self, scan, points, attempt, posed):
        """The Surface of an Attempt, from where its start has followed the scan, else from the `posed` (n,3). One that has followed
        a scan without a limb has drawn that elsewhere; where keypoints tell where it is, it begins posed and is held there."""
        vouched = self.cascade.keypoints(attempt.fit.rotations, attempt.fit.translation, points).vouched
        held = np.flatnonzero(self.surface.lacking(scan, posed))[::HELD_STEP] if vouched else ()
        start = posed if attempt.surface is None or len(held) else attempt.surface
        return self.surface.fit(scan, start, held)

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
        face, left_out = self._face(*pose, points, V, confidence)
        diagnostics = {"skeleton_rms_m": float(fit.rms), "skeleton_iterations": float(fit.iterations), **measures}
        diagnostics |= _of_keypoints(points) | self._of_surface(V, posed) | self._of_face(points, left_out)
        return Tracked(V, *pose, face, confidence, diagnostics)

    def _of_surface(self, V, posed):
        """What the diagnostics say of a surface V (n,3) beside the `posed` (n,3)."""
        moved = np.linalg.norm(V - posed, axis=1)[self.search.looks]
        return {"moved_mm": float(1e3 * moved.mean()), "moved_p95_mm": float(1e3 * np.percentile(moved, 95))}

    def _of_face(self, points, left_out):
        """What the diagnostics say of facial keypoints, of which so many were left out."""
        if points is None:
            return {}
        facial = np.isfinite(points.points[np.isin(points.names, self.model.face_names)]).all(1).sum()
        return {"face_off": left_out / int(facial)} if facial >= FACE else {}

    def _start(self, previous):
        """The person's rest surface (n,3), with a share of the frame's before that its surface was off the pose: a limb
        that turned about its axis without a bone's turning stays turned, and an error dies away."""
        person, share = self.person, self.settings.carried_share
        before = self.model.unskin(previous.vertices, person.J, previous.rotations, previous.translation)
        off = before - person.rest
        off *= np.minimum(1, self.settings.carried_reach / np.maximum(np.linalg.norm(off, axis=1), 1e-12))[:, None]
        return person.rest + share * off

    def _face(self, rotations, translation, points, V, confidence):
        """Facial keypoints in the head joint's frame (q,3), NaN where unseen, and how many were left out."""
        head = self.model.joint("head")
        if points is None or head is None:
            return np.full((len(self.model.face_names), 3), np.nan), 0
        transforms = R, x = self.model.joint_transforms(self.person.J, rotations, translation)
        offsets = self.person.keypoint_offsets
        places, left_out = facial_places(self.model, points, V, transforms, offsets, confidence, self.settings)
        return (places - x[head]) @ R[head], left_out


def _of_keypoints(points):
    """What the diagnostics say of a frame's Points3D."""
    if points is None or not len(points.points):
        return {}
    kept = {"keypoints_kept": float(np.isfinite(points.points).all(1).mean())}
    return kept | {"keypoint_gate_px": points.gate} if points.gate else kept


class _Poser:
    """The pose that a registered surface shows. Its vertices keep their identity, so they tell how far a limb has turned
    about its axis, where a bare scan does not."""

    def __init__(self, model, person, settings):
        self.settings = settings
        outside = np.flatnonzero(~model.inside)
        self.chosen = outside[:: max(len(outside) // settings.pose_vertices, 1)]
        self.names = tuple(f"vertex.{v}" for v in self.chosen)
        persons = replace(model, v_template=person.rest, J=person.J, shapedirs=np.zeros((len(person.rest), 3, 0)))
        persons = replace(persons, J_shapedirs=np.zeros((len(person.J), 3, 0)))
        beside = with_offsets(persons, person.keypoint_offsets)
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
        surface = self.fit_or_none(scan, start, held)
        if surface is None:
            raise UserError(NO_OVERLAP)
        return surface

    def fit_or_none(self, scan, start, held=()):
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


def _refuse_unmatched(numbers, fits):
    if beyond := [number for number, fit in zip(numbers, fits) if fit.stop == "unmatched"]:
        raise Unmatched.of(beyond, "the body model finds neither scan nor keypoints within reach")
