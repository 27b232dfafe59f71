"""Motion over time: pose, tracked surface and garments of consecutive frames, with their flicker taken out.

Each frame is registered alone, so that its surfaces slide a little otherwise than the frame's before. Here a vertex is
taken as its displacement y_t from the posed model, in axes that turn with the body there, and moves by

    d = argmin  sum_t w_t |d_t|^2 + strength sum_t m_t |D2 (y + d)_t|^2,     D2 x_t = x_{t-1} - 2 x_t + x_{t+1},

a Whittaker smoother (Eilers, A perfect smoother, 2003) whose `strength` the sequence itself tells, see `strength_of`; m_t is the
largest of w_{t-1}, w_t, w_{t+1}: an ill-known place follows well-known ones beside it, but where all are ill known none is
carried off along a straight line. An
observed vertex is known better across the surface, where the scan lies, than along it: the two have strengths of their
own. Poses are smoothed by `surface.pose_smoothing`, before. Where no scan shows the surface, y is first taken from the scanned
frames beside it, by `surface.between_scans`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np

from .. import kernels
from ..config.stages import MotionSettings
from ..kernels.arrays import Bools, Floats
from ..kinematics import blended_transforms
from ..scene import (
    INTERPOLATED,
    OBSERVED,
    BodyModel,
    Dressed,
    GarmentTemplate,
    Person,
    Tracked,
)
from ..surface.between_scans import between_scans, told_by
from ..surface.loops import astray, beside_loops, loop_length
from ..surface.pose_smoothing import STRENGTHS, foretelling_errors, foretelling_strength, smooth_poses

Layers = tuple[Tracked, dict[str, Dressed]]  # of one frame
LAGS = (1, 2)
OF_ITSELF = ("observed", "hand_contact", "unsupported_contact", "smoothed_mm")  # diagnostics that no other frame gives


@dataclass(frozen=True)
class Roughness:
    """Squared second differences [m^2] at `LAGS` frames: `total` and `count` (s, 2), where s runs along and across the tracked
    surface and every garment; `missed` and `left_out` of poses, see `foretelling_errors`."""

    total: Floats
    count: Floats
    missed: Floats
    left_out: float

    def __add__(self, other: Roughness) -> Roughness:
        return Roughness(*(a + b for a, b in zip(astuple(self), astuple(other))))


@dataclass(frozen=True)
class Strengths:
    """`strength` (s,) and `noise` (s,), the root mean square of a place's error [m], in the order of a Roughness; `pose`: the
    strength of poses."""

    strength: Floats
    noise: Floats
    pose: float


def strength_of(roughness: Roughness, largest: float, pose_factor: float) -> Strengths:
    """The strengths at which noise and motion are parted as a sequence's own roughness says; of poses `pose_factor` times that
    which best foretells places of joints left out.

    White noise of variance n and accelerations of variance a give second differences at lag k the variance
    6 n + a k (2 k^2 + 1) / 3, which lags 1 and 2 solve for both; the strength is n / a, the best of a Wiener filter, at
    most `largest`. 0 where no five frames follow one another."""
    known = roughness.count.min(1) > 0
    near, far = (roughness.total / np.maximum(roughness.count, 1)).T
    motion = np.clip((far - near) / 5, 0, near)
    noise = (near - motion) / 6
    strength = np.minimum(noise / np.maximum(motion, 1e-30), largest)
    pose = pose_factor * foretelling_strength(roughness.missed, roughness.left_out)
    return Strengths(np.where(known, strength, 0.0), np.where(known, np.sqrt(noise), 0.0), pose)


class Smoother:
    """Smooths consecutive frames of one person; what does not change from frame to frame is kept."""

    def __init__(
        self,
        model: BodyModel,
        person: Person,
        templates: Sequence[GarmentTemplate],
        settings: MotionSettings,
        fps: float,
    ):
        self.model, self.person, self.templates, self.settings = model, person, templates, settings
        self.reach = max(round(settings.reach * fps), 1)  # [frames]

    def nothing(self) -> Roughness:
        """Of no frames."""
        return Roughness(*np.zeros((2, 2 + 2 * len(self.templates), 2)), np.zeros(len(STRENGTHS)), 0.0)

    def gather(self, frames: Sequence[Layers]) -> Roughness:
        """What consecutive frames say of their own roughness, by the joints and by vertices spread over each surface."""
        turns, moves = _poses([tracked for tracked, _ in frames])
        rows = []
        for name in (None, *(t.name for t in self.templates)):
            V, confidence = _positions(frames, name)
            chosen = slice(None, None, max(V.shape[1] // self.settings.samples, 1))
            y, normals = self._local(name, turns, moves, V, chosen)
            seen = confidence[:, chosen] == max(
                confidence.max(), INTERPOLATED
            )  # of frames without scans nothing is known better
            rows.append(_squares(lambda k: _parted(_second(y, k), normals[k:-k])[0], seen))
            rows.append(_squares(lambda k: _parted(_second(y, k), normals[k:-k])[1], seen))
        total, count = np.moveaxis(np.array(rows), 2, 0)
        joints = [self.model.joint_transforms(self.person.J, *pose)[1] for pose in zip(turns, moves)]
        return Roughness(total, count, *foretelling_errors(np.array(joints), self._pose_weight(frames)))

    def smooth(self, frames: Sequence[Layers], strengths: Strengths) -> list[Layers]:
        """The frames again, smoothed; to the bit as they were where nothing is known of their noise and a scan shows all of them, or none."""
        scanned = scans_show(frames)
        known = strengths.strength.any() or strengths.pose or (scanned.any() and not scanned.all())
        if len(frames) < 3 or not known:
            return list(frames)
        strength, noise = strengths.strength, strengths.noise
        found = _poses([tracked for tracked, _ in frames])
        turns, moves = smooth_poses(*found, self._pose_weight(frames), strengths.pose)
        seen_by = np.where(scanned[:, None, None], turns, found[0]), np.where(scanned[:, None], moves, found[1])
        surfaces = []
        for i, name in enumerate((None, *(t.name for t in self.templates))):
            own = slice(2 * i, 2 * i + 2)
            surfaces.append(self._smooth_surface(name, seen_by, (turns, moves), frames, strength[own], noise[own]))
        out, source = [], told_by(scanned, self.reach)
        for t, (tracked, dressed) in enumerate(frames):
            told = frames[source[t]][1]
            face = self._face(tracked, turns[t], moves[t])
            pose = {"rotations": turns[t], "translation": moves[t], "face": face}
            cloth = {
                g.name: _told(g, dressed[g.name], told[g.name], v[t]) for g, v in zip(self.templates, surfaces[1:])
            }
            out.append((_shown_by(replace(_moved(tracked, surfaces[0][t]), **pose), source[t] - t), cloth))
        return out

    def _pose_weight(self, frames):
        """(T,) of the frames' poses: less where no scan tells."""
        return np.where(scans_show(frames), 1.0, self.settings.unscanned_weight)

    def _smooth_surface(self, name, seen_by, poses, frames, strength, noise):
        """Vertices (T,n,3) of the tracked surface, or of the garment `name`, at `poses` (turns, moves); they lie about those that each
        frame was `seen_by`: the same, but those found where no scan tells."""
        V, confidence = _positions(frames, name)
        shown = scans_show(frames)
        y, normals = (between_scans(x, shown, self.reach) for x in self._local(name, *seen_by, V))
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        strength = strength * [1.0, self.settings.across_share]
        parts, trust = _parted(_second(y), normals[1:-1]), self._trust(name, V, confidence)
        d = sum(_smoothing(trust, s, a) for s, a in zip(strength, parts))
        if strength.any():  # a vertex that would be moved far was misplaced in that frame (Cauchy's weight)
            outlying = np.einsum("tni,tni->tn", d, d) / (self.settings.outlier**2 * (noise**2).sum())
            trust = trust / (1 + outlying)
            d = sum(_smoothing(trust, s, a) for s, a in zip(strength, parts))
        rest = (self.person if name is None else self._template(name)).rest
        for t, (turns, move) in enumerate(zip(*poses)):
            A, b = self._transforms(name, turns, move)
            V[t] = b + np.einsum("nij,nj->ni", A, rest) + np.einsum("nij,nj->ni", _axes(A), y[t] + d[t])
        return V

    def _trust(self, name, V, confidence):
        """Weights (T,n) of vertices (T,n,3) by their confidence. In a frame where a loop of a garment is much shorter or longer
        than in the others, what lies about it counts as hidden: its opening was cut off there, or run over."""
        s = self.settings
        trust = np.array([s.hidden_weight, s.interpolated_weight, 1.0])[confidence]
        for loop in () if name is None else self._template(name).loops:
            rest, lengths = self._template(name).rest, np.array([loop_length(v[loop]) for v in V])
            wrong = np.ix_(astray(lengths, s.whole_rank, s.whole_opening), beside_loops(rest, [loop], s.loop_reach))
            trust[wrong] = np.minimum(trust[wrong], s.hidden_weight)
        return trust

    def _template(self, name):
        return next(t for t in self.templates if t.name == name)

    def _local(self, name, turns, moves, V, chosen=slice(None)):
        """Displacements (T,k,3) of vertices from the posed model, and their normals, in axes that turn with it."""
        y = np.empty((len(V), len(V[0][chosen]), 3))
        normals = np.empty_like(y)
        layer = self.person if name is None else self._template(name)
        F = self.model.f if name is None else layer.faces
        for t, v in enumerate(V):
            A, b = self._transforms(name, turns[t], moves[t], chosen)
            axes = _axes(A)
            y[t] = np.einsum("nji,nj->ni", axes, v[chosen] - b - np.einsum("nij,nj->ni", A, layer.rest[chosen]))
            normals[t] = np.einsum("nji,nj->ni", axes, kernels.vertex_normals(v, F)[chosen])
        return y, normals

    def _transforms(self, name, turns, move, chosen=slice(None)):
        """Skinning of a surface as matrices (k,3,3) and offsets (k,3)."""
        model, J = self.model, self.person.J
        R, x = model.joint_transforms(J, turns, move)
        if name is None:
            return blended_transforms(J, R, x, model.weights_idx[chosen], model.weights_val[chosen])
        skin = self._template(name).skin[chosen]
        return (skin @ R.reshape(-1, 9)).reshape(-1, 3, 3), skin @ (x - np.einsum("kij,kj->ki", R, J))

    def _face(self, tracked, turns, move):
        """Facial keypoints stay where they are in the world, and are told in the smoothed head's frame."""
        head = self.model.joint("head")
        if head is None or not len(tracked.face):
            return tracked.face
        R, x = self.model.joint_transforms(self.person.J, tracked.rotations, tracked.translation)
        S, y = self.model.joint_transforms(self.person.J, turns, move)
        return (tracked.face @ R[head].T + x[head] - y[head]) @ S[head]


def scans_show(frames: Sequence[Layers]) -> Bools:
    """(T,) bool: whether a scan shows something of the frame."""
    return np.array([bool((tracked.confidence == OBSERVED).any()) for tracked, _ in frames])


def _poses(tracked):
    """Rotation vectors (T,K,3) and translations (T,3)."""
    return np.stack([t.rotations for t in tracked]), np.stack([t.translation for t in tracked])


def _positions(frames, name):
    """Vertices (T,n,3) and confidence (T,n) of the tracked surface, or of the garment `name`."""
    layers = [tracked if name is None else dressed[name] for tracked, dressed in frames]
    return np.stack([layer.vertices for layer in layers]), np.stack([layer.confidence for layer in layers])


def _moved(layer, vertices):
    """The Tracked or Dressed with other vertices, which tells how far they were moved."""
    moved = float(1e3 * np.linalg.norm(vertices - layer.vertices, axis=1).mean())
    return replace(layer, vertices=vertices, diagnostics=layer.diagnostics | {"smoothed_mm": moved})


def scan_beside(tracked: Tracked) -> int:
    """By how many frames the scanned frame that gave this one its surfaces lies after it; 0: it is its own."""
    return int(tracked.diagnostics.get("scan_beside", 0))


def _shown_by(tracked, offset):
    return replace(tracked, diagnostics=tracked.diagnostics | {"scan_beside": float(offset)}) if offset else tracked


def _told(template, dressed, source, vertices):
    """The Dressed with other vertices, which the Dressed `source` gave: itself, or a scanned frame's, of which then holds what is
    said of openings and cloth. What is said of loops' lengths holds of the vertices. The girths that these are held against lie
    farther off and hardly change."""
    moved = _moved(dressed, vertices)
    if source is not dressed:
        own = {key: moved.diagnostics[key] for key in OF_ITSELF if key in moved.diagnostics}
        confidence = np.minimum(source.confidence, INTERPOLATED)
        moved = replace(moved, confidence=confidence, diagnostics=source.diagnostics | own)
    for name, loop in zip(template.loop_names, template.loops):
        grown = loop_length(vertices[loop]) / max(loop_length(source.vertices[loop]), 1e-9)
        for key in {f"loop_length.{name}", f"loop_share.{name}"} & moved.diagnostics.keys():
            moved.diagnostics[key] *= grown
    return moved


def _axes(A):
    """Rotations (n,3,3) near matrices (n,3,3): their columns made orthonormal, the first first."""
    first, second = A[..., 0], A[..., 1]
    first = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = second - np.einsum("ni,ni->n", first, second)[:, None] * first
    second = second / np.maximum(np.linalg.norm(second, axis=1, keepdims=True), 1e-12)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def _second(x, lag=1):
    """Second differences (T - 2 lag, ...) over time."""
    return x[: -2 * lag] - 2 * x[lag:-lag] + x[2 * lag :] if len(x) > 2 * lag else x[:0]


def _parted(a, normals):
    """Vectors (T,n,3) along and across a surface of unit normals."""
    across = np.einsum("tni,tni->tn", a, normals)[..., None] * normals
    return a - across, across


def _squares(second, seen=None):
    """[(sum of squares, how many)] of second(lag) (T', n, 3) at every lag, where `seen` (T,n) in all three frames."""
    rows = []
    for lag in LAGS:
        squares = np.einsum("tni,tni->tn", second(lag), second(lag))
        if seen is not None and len(squares):
            squares = squares[seen[: -2 * lag] & seen[lag:-lag] & seen[2 * lag :]]
        rows.append((squares.sum(), float(squares.size)))
    return rows


def _smoothing(weight, strength, a):
    """d (T,n,c), the argmin of this module's head, from weights (T,n) and second differences a (T-2,n,c):
    (W + s D'M D) d = - s D'M a by LDL' of five bands, all vertices side by side."""
    T, M = len(weight), strength * np.maximum(np.maximum(weight[:-2], weight[1:-1]), weight[2:])
    ended = lambda x: np.concatenate([np.zeros_like(x[:1])] * 2 + [x] + [np.zeros_like(x[:1])] * 2)
    M, Ma = ended(M), ended(M[..., None] * a)
    first, second, third = (slice(k, k + T) for k in range(3))  # the differences whose last, middle, first place is t
    z = 2 * Ma[second] - Ma[first] - Ma[third]
    pivot, below, beyond = weight + M[first] + 4 * M[second] + M[third], -2 * (M[first] + M[second]), M[first].copy()
    for t in range(T):
        if t > 1:
            beyond[t] /= pivot[t - 2]
            pivot[t] -= beyond[t] ** 2 * pivot[t - 2]
            z[t] -= beyond[t][:, None] * z[t - 2]
        if t > 0:
            below[t] = (below[t] - (beyond[t] * pivot[t - 2] * below[t - 1] if t > 1 else 0)) / pivot[t - 1]
            pivot[t] -= below[t] ** 2 * pivot[t - 1]
            z[t] -= below[t][:, None] * z[t - 1]
    z /= pivot[..., None]
    for t in range(T - 2, -1, -1):
        z[t] -= below[t + 1][:, None] * z[t + 1]
        if t < T - 2:
            z[t] -= beyond[t + 2][:, None] * z[t + 2]
    return z
