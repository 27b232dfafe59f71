"""A body's pose in a scan without any other start: quick fits from many headings and postures, then limb by limb."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import kernels
from ..scene import Mesh
from .sampling import by_area
from .thinning import thinned
from .two_sided import SCAN_POINTS, TwoSided, middle_of, outside_of, principal_axis

# Where the two halves of a limb may point, in (outwards, forwards, upwards) of the trunk.
ARMS = {
    "down": ((0.2, 0, -1), (0.2, 0, -1)),
    "out": ((1, 0, 0), (1, 0, 0)),
    "forwards": ((0.2, 1, 0), (0, 1, 0)),
    "up": ((0.2, 0, 1), (0.2, 0, 1)),
    "bent": ((0.3, 0, -1), (0, 1, 0)),
    "folded": ((0.6, 0.6, 0), (-0.5, 1, 0.5)),
}
LEGS = {
    "straight": ((0.1, 0, -1), (0, 0, -1)),
    "before": ((0.1, 0.5, -1), (0.1, 0.4, -1)),
    "behind": ((0.1, -0.5, -1), (0.1, -0.6, -1)),
    "lifted": ((0.1, 1, -0.1), (0, 0, -1)),
}
WAYS = {"arms": ARMS, "legs": LEGS}
ARM, LEG = ("upperarm01", "lowerarm01", "wrist"), ("upperleg01", "lowerleg01", "foot")
STRAIGHT_UP = 0.98  # cosine
# What a body is tried in at every heading: {limb: where it points}; others as at rest.
POSTURES = (
    {},
    {"arms": "down"},
    {"arms": "forwards"},
    {"arms": "down", "legs": "lifted"},
)


class QuickFit(NamedTuple):
    """A pose that was fitted, and how far it lies from the scan, see TwoSided."""

    distance: float
    astray: float
    fit: Any  # SkeletonResult

    @property
    def pose(self):
        return np.asarray(self.fit.rotations), np.asarray(self.fit.translation), np.asarray(self.fit.shape)


class PoseSearch:
    """Finds a body in a scan: quick fits in a few postures from `headings` headings about the long axis, upright first, then,
    where none of these explains the scan, upside down and along the scan's own axis; of the best of them each limb is
    laid the other ways that limbs go. The nearest from both sides wins. `person`: whose shape is kept; without, a shape is
    fitted too. `options` are the SkeletonSolver's."""

    def __init__(self, model, headings, settings, options, person=None):
        self.model, self.headings, self.settings, self.looks = model, headings, settings, outside_of(model)
        self.shape = np.zeros(model.shapedirs.shape[2]) if person is None else person.shape
        self.rest, self.J = model.rest(self.shape)
        top = model.joint("head")
        way = self.rest.max(0) - self.rest.min(0) if top is None else np.abs(self.J[top] - self.J[0])
        self.up = np.eye(3)[int(np.argmax(way))]
        self.solver = quick_solver(model, settings, options | {"solve_shape": person is None})
        self.limbs = dict(self._limbs())

    def _limbs(self):
        """(name, limb) of those that the model has: the joints that its two halves turn about, all its joints, its ways at
        rest (2,3), and the directions (3,3) outwards, forwards and upwards as columns."""
        for name, roles in (("arms", ARM), ("legs", LEG)):
            sides = [[self.model.joint(f"{role}.{side}") for role in roles] for side in "LR"]
            if None in sides[0] + sides[1]:
                continue
            left = self.J[sides[0][0]] - self.J[sides[1][0]]
            left -= (left @ self.up) * self.up
            left /= np.linalg.norm(left)
            for side, joints, outwards in zip("LR", sides, (left, -left)):
                frame = np.stack([outwards, np.cross(left, self.up), self.up], axis=1)
                yield f"{name}.{side}", self._limb(joints, frame)

    def _limb(self, joints, frame):
        ways = np.diff(self.J[joints], axis=0)
        return joints[:2], np.flatnonzero(self.model.beyond(joints[0])), ways, frame

    def measure(self, scan, fit):
        """(distance [m], astray) of a fit, see TwoSided."""
        return TwoSided(scan, self.looks)(fit.V)

    def pose(self, scan, near=None):
        """The best pose (rotations, translation, shape), and its distance from both sides [m]; (None, infinity) where no
        search is asked for. `near`: (pose, distance) of another frame; where one of its heading is as close, it is taken."""
        if not self.headings:
            return None, np.inf
        s = self.settings
        scan = thinned(without_ground(scan, self.up, s.ground_height, s.ground_share), s.scan_spacing)
        measure = TwoSided(scan, self.looks)
        seen = {"scan_confidence": scan.confidence, "scan_index": scan.index}

        def fitted(start):
            fit = self.solver.solve(scan.vertices, scan.faces, start=start, **seen)
            return QuickFit(*measure(fit.V), fit)

        if near is not None and near[0] is not None:
            turn = Rotation.from_rotvec(near[0][0][0])
            best = self._bettered([fitted(self._at(scan, turn, posture)) for posture in POSTURES], fitted)
            if best.distance <= s.as_close * near[1]:
                return best.pose, best.distance
        tried, best = [], None
        for axis in self._axes(scan):
            turns = [self._turned(axis, i) for i in range(self.headings)]
            tried += [fitted(self._at(scan, turn, posture)) for turn in turns for posture in POSTURES]
            if min(tried, key=_distance).astray > s.hopeless:
                continue
            best = self._bettered(tried, fitted)
            if best.astray <= s.astray:
                break
        best = best or self._bettered(tried, fitted)
        return best.pose, best.distance

    def _bettered(self, tried, fitted):
        """The best of the best few, once each of their limbs has been laid where it comes nearer to the scan; of the
        best alone where that is hardly astray."""
        first = sorted(tried, key=_distance)[: self.settings.kept]
        first = first[:1] if first[0].astray <= self.settings.sure else first
        return min((self._limb_by_limb(one, fitted) for one in first), key=_distance)

    def _limb_by_limb(self, best, fitted):
        for _ in range(self.settings.limb_rounds):
            before = best.distance
            for name in self.limbs:
                for ways in WAYS[name[:-2]].values():
                    rotations, translation, shape = best.pose
                    start = self._laid(rotations, name, ways), translation, shape
                    best = min(best, fitted(start), key=_distance)
            if best.distance > self.settings.nearer * before:
                break
        return best

    def _laid(self, rotations, name, ways):
        """Rotations (K,3) with a limb's two halves laid along `ways`; all else of the limb is as at rest."""
        (upper, lower), below, rest, frame = self.limbs[name]
        rotations = rotations.copy()
        rotations[below] = 0
        first = shortest_turn(rest[0], frame @ ways[0])
        rotations[upper] = first.as_rotvec()
        rotations[lower] = shortest_turn(rest[1], first.inv().apply(frame @ ways[1])).as_rotvec()
        return rotations

    def _at(self, scan, turn, posture):
        """The pose at rest but for a posture, turned, in the middle of the scan."""
        rotations = np.zeros((len(self.model.parents), 3))
        for name in self.limbs:
            if name[:-2] in posture:
                rotations = self._laid(rotations, name, WAYS[name[:-2]][posture[name[:-2]]])
        rotations[0] = turn.as_rotvec()
        V = self.model.skin(self.rest, self.J, rotations, -self.J[0])
        return rotations, middle_of(_points(scan)) - middle_of(V[self.looks]) - self.J[0], self.shape

    def _axes(self, scan):
        """Where the body's long axis may point: upright, upside down, and along the scan's longest axis either way."""
        along = principal_axis(scan.vertices, scan.faces)
        leaning = np.abs(along @ self.up) < np.cos(self.settings.upright)
        return [self.up, -self.up, *([along, -along] if leaning else [])]

    def _turned(self, axis, heading):
        """The rotation that lays the long axis along another and turns the body about it, to one of the headings."""
        return shortest_turn(self.up, axis) * Rotation.from_rotvec(2 * np.pi * heading / self.headings * self.up)


def quick_solver(model, settings, options):
    """A SkeletonSolver that looks far and gathers the limbs coarsely; `settings` say how far, over how many vertices, and for
    how long."""
    s = settings
    quick = {"reach_start": s.reach, "reach": s.reach, "surface_samples": s.surface_samples}
    return kernels.SkeletonSolver(model, **options | quick | {"max_iterations": s.max_iterations})


def without_ground(scan, up, height, share):
    """The scan without the slab of this height [m] across `up` in which most of its area lies that looks straight up,
    where that is more than this share of all: a floor, which says nothing of a body and hides where its middle is."""
    face, _ = by_area(scan.vertices, scan.faces, SCAN_POINTS)
    at = np.sort((scan.vertices[scan.faces[face]].mean(1) @ up)[scan.face_normals[face] @ up > STRAIGHT_UP])
    held = np.searchsorted(at, at + height, side="right") - np.arange(len(at))
    if not len(at) or held.max() < share * SCAN_POINTS:
        return scan
    low = at[held.argmax()]
    level = scan.vertices[scan.faces] @ up
    kept = (np.abs(level - low) > height / 2).any(1)
    return Mesh(scan.vertices, scan.faces[kept], confidence=scan.confidence)


def shortest_turn(a, b):
    """The smallest rotation that lays direction (3,) a along b; half a turn about an axis across, where they oppose."""
    a, b = a / np.linalg.norm(a), np.asarray(b) / np.linalg.norm(b)
    axis = np.cross(a, b)
    if np.linalg.norm(axis) < 1e-9:
        across = np.cross(a, np.eye(3)[np.abs(a).argmin()])
        return Rotation.from_rotvec((a @ b < 0) * np.pi * across / np.linalg.norm(across))
    return Rotation.from_rotvec(np.arctan2(np.linalg.norm(axis), a @ b) * axis / np.linalg.norm(axis))


def _distance(found):
    return found.distance


def _points(scan):
    """Points (k,3) spread evenly over a scan."""
    return scan.vertices[scan.faces[by_area(scan.vertices, scan.faces, SCAN_POINTS)[0]]].mean(1)
