"""Single-layer tracking: one rest surface for the person, a pose a frame, then a free-form fit of the surface."""

import numpy as np

from .. import kernels
from ..errors import UserError
from ..scene import HIDDEN, INTERPOLATED, OBSERVED, Person, Tracked
from ..surface.operators import smooth_on
from ..vision.threads import parallel_map_with


def prepare(model, frames, settings):
    """The personalised rest shape from sampled frames [(Frame, Points3D | None)].

    One shape is fitted to all of them with a pose each; each frame's free-form surface is then unposed, and where
    most frames saw it the mean of the offsets is added, smoothed, to the shape.
    """
    solver = kernels.SkeletonSolver(model, **_options(settings))
    fits = solver.solve_shared([_evidence(frame, points) for frame, points in frames])
    _refuse_unmatched([frame.number for frame, _ in frames], fits)
    shape = np.asarray(fits[0].shape)
    rest, J = model.rest(shape)

    def offset(surface, found):
        scan, pose = found[0].scan, (found[1].rotations, found[1].translation)
        V, confidence = surface.fit(scan, model.skin(rest, J, *pose))
        seen = (confidence == OBSERVED)[:, None]
        return np.where(seen, model.unskin(V, J, *pose) - rest, 0), seen

    offsets, weight = np.zeros_like(rest), np.zeros((len(rest), 1))
    scanned = [(frame, fit) for (frame, _), fit in zip(frames, fits) if frame.scan is not None]
    for moved, seen in parallel_map_with(lambda: _Surface(model, rest, settings), offset, scanned):
        offsets += moved
        weight += seen
    mean = offsets / np.maximum(weight, 1) * (weight >= max(len(frames) // 2, 1))
    return Person(shape, rest + smooth_on(model.f, mean, settings.rest_smoothing), J)


class Tracker:
    """Tracks frames of one person; the template's part of the solvers is made once."""

    def __init__(self, model, person, settings):
        self.model, self.person, self.settings = model, person, settings
        self.skeleton = kernels.SkeletonSolver(
            model, **_options(settings) | {"solve_shape": False, "surface_samples": settings.surface_samples}
        )
        self.surface = _Surface(model, person.rest, settings)

    def track(self, frame, points, previous=None):
        """One frame; `previous` (Tracked) starts the pose and gives the temporal term."""
        person, model = self.person, self.model
        evidence = _evidence(frame, points)
        if previous is not None:
            before = (previous.rotations, previous.translation, person.shape)
            evidence |= {"start": before, "previous": [before]}
        elif points is not None:
            evidence["start"] = self._cold_start(points)
        fit = self.skeleton.solve(**evidence)
        _refuse_unmatched([frame.number], [fit])
        V = model.skin(person.rest, person.J, fit.rotations, fit.translation)
        confidence = np.full(len(V), INTERPOLATED, np.uint8)
        if frame.scan is not None:
            V, confidence = self.surface.fit(frame.scan, V)
        if not np.isfinite(V).all():
            raise UserError(f"frame {frame.number}: tracking left vertices that are not finite")
        diagnostics = {"skeleton_rms_m": float(fit.rms), "skeleton_iterations": float(fit.iterations)}
        return Tracked(
            V, np.asarray(fit.rotations), np.asarray(fit.translation), self._face(fit, points), confidence, diagnostics
        )

    def _cold_start(self, points):
        """Keypoints alone, with the person's shape, give the first pose."""
        K = len(self.model.parents)
        seen = points.points[~np.isnan(points.points).any(1)]
        middle = np.median(seen, axis=0) - np.median(self.person.J, axis=0) if len(seen) else np.zeros(3)
        start = kernels.SkeletonSolver(self.model, **_options(self.settings)).solve(keypoints=points)
        if start.stop == "unmatched":
            return np.zeros((K, 3)), middle, self.person.shape
        return np.asarray(start.rotations), np.asarray(start.translation), self.person.shape

    def _face(self, fit, points):
        """Facial keypoints in the head joint's frame (q,3), NaN where unseen."""
        names = [n for n in self.model.keypoint_names if n.startswith("face.")]
        face = np.full((len(names), 3), np.nan)
        if points is None or self.model.joint("head") is None:
            return face
        R, x = self.model.joint_transforms(self.person.J, np.asarray(fit.rotations), np.asarray(fit.translation))
        head, at = self.model.joint("head"), {n: i for i, n in enumerate(points.names)}
        for row, name in enumerate(names):
            if name in at:
                face[row] = R[head].T @ (points.points[at[name]] - x[head])
        return face


class _Surface:
    """Free-form registration of the body's surface from a skinned start."""

    def __init__(self, model, rest, settings):
        self.model, self.settings = model, settings
        self.solver = kernels.NricpSolver(rest, model.f, large_motion=False, rebase=True, **settings.nricp.model_dump())

    def fit(self, scan, start):
        """-> vertices (n,3) and confidence (n,)."""
        fit = self.solver.solve(scan.vertices, scan.faces, start=start)
        confidence = None if fit.stop == "no_overlap" else self._confidence(fit.V, scan)
        if confidence is None or not (confidence == OBSERVED).any():
            raise UserError("scan.ply: the scan and the posed body do not overlap")
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


def _options(settings):
    """TrackSettings as the SkeletonSolver takes them."""
    return settings.skeleton.model_dump()


def _evidence(frame, points):
    scan = frame.scan
    return {
        "scan_V": None if scan is None else scan.vertices,
        "scan_F": None if scan is None else scan.faces,
        "keypoints": points,
    }


def _refuse_unmatched(numbers, fits):
    for number, fit in zip(numbers, fits):
        if fit.stop == "unmatched":
            raise UserError(f"frame {number}: the body model finds neither scan nor keypoints within reach")
