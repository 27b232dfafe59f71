"""Where limbs of a posed body run into its other parts: contacts of vertices with surfaces, and how joints move them.

The equations: docs/method/animation.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from .. import kernels
from ..kinematics import blended_by, posed_joints
from .operators import distance_along_edges
from .sampling import spread_points
from .wrapping import Wrapping

LIMBS = ("upperarm01.L", "upperarm01.R", "upperleg01.L", "upperleg01.R")  # roles of the joints that they begin at
# joints that give way, and how much a turn of theirs costs
TURNED = {"upperarm01": 1.0, "lowerarm01": 2.0, "upperleg01": 2.0, "lowerleg01": 4.0}
CREASE = 0.08  # [m] along the surface from where a limb begins: nearer, skin folds at the joint in any pose
REACH = 0.15  # [m] deepest that a contact is looked for
DEEP = 0.02  # [m] in the trunk or the head, or what is worn: such a limb comes out of them first
POINTS = 1000  # of a limb, evenly spread
AREA = 4e-4  # [m^2] of skin that weighs 1


class Contacts(NamedTuple):
    """Limb vertices nearer to another part than asked: `distance` (k,) [m] between what both wear, negative inside; `room` (k,) [m],
    which that takes of the skins' distance; `weight` (k,); `past` (k,) bool, the crease; `rows` (k,D), how each distance changes
    with the turns [m/rad]."""

    distance: np.ndarray
    room: np.ndarray
    weight: np.ndarray
    past: np.ndarray
    rows: np.ndarray


@dataclass(frozen=True)
class Part:
    """The trunk, the head or a limb; indices count its own vertices (v,), which are a `span` of the body's in order of
    parts. A limb has `points`, those beyond the crease, with weights, and faces `beyond` it."""

    span: slice
    faces: np.ndarray  # (m,3)
    border: np.ndarray  # bool (v,): where it is cut off
    points: np.ndarray  # (p,)
    weight: np.ndarray  # (p,)
    past: np.ndarray  # (p,) bool: farther than CREASE
    beyond: np.ndarray  # (f,3)
    edge: float  # the longest [m]


class Limbs:
    """The parts of one body: `rest` (n,3) and joints `J` (K,3) [m], skinned by the weights of a BodyModel, whose roles name the
    limbs. `worn`: the Wrapping of its vertices, none by default. What gives way are D turns: each of `turned` joints about three axes
    of its parent."""

    def __init__(self, model, rest, J, worn=None):
        rest, self.J, self.parents = np.asarray(rest, np.float64), np.asarray(J, np.float64), model.parents
        weights = np.zeros((len(rest), len(self.J)))
        np.add.at(weights, (np.arange(len(rest))[:, None], model.weights_idx), model.weights_val)
        limbs = [k for k in map(model.joint, LIMBS) if k is not None]
        named = [(model.joint(f"{role}.{side}"), stiff) for role, stiff in TURNED.items() for side in "LR"]
        named = [(k, stiff) for k, stiff in named if k is not None]
        self.turned = np.array([k for k, _ in named], int)
        self.stiff = np.repeat([stiff for _, stiff in named], 3)
        self.parts, order = self._parts(model, rest, weights, limbs)
        self.limbs = self.parts[: len(limbs)]
        self.rest, self.weights = rest[order], csr_matrix(weights[order])
        self.worn = Wrapping.none(len(order)) if worn is None else worn.of(order)
        below = np.array([model.beyond(k) for k in self.turned], bool).reshape(len(self.turned), len(self.J))
        self.carried = weights[order] @ below.T  # (n,joints)

    def _parts(self, model, rest, weights, limbs):
        """[Part]: the limbs, the head, the trunk; and the body's vertices in their order."""
        roots = limbs + [k for k in [model.joint("neck01")] if k is not None]
        owner = np.full(len(rest), len(roots))
        for i, k in enumerate(roots):
            owner[weights[:, model.beyond(k)].sum(1) > 0.5] = i
        owner[model.inside] = -1
        area = kernels.voronoi_mass(rest, model.f)
        order = np.concatenate([np.flatnonzero(owner == i) for i in range(len(roots) + 1)])
        parts, start = [], 0
        for i in range(len(roots) + 1):
            end = start + int((owner == i).sum())
            away = _from_cut(rest, model.skin_faces, owner == i) if i < len(limbs) else np.zeros(len(rest))
            parts.append(_part(rest, model.skin_faces, owner == i, slice(start, end), away, area))
            start = end
        return parts, order

    def transforms(self, rotations, translation):
        """Rotation vectors (T,K,3), (T,3) -> world rotations (T,K,3,3) and places of joints (T,K,3)."""
        from scipy.spatial.transform import Rotation

        R = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(*rotations.shape, 3)
        return posed_joints(self.parents, self.J, R, translation)

    def skin(self, R, x):
        """Vertices (n,3) of one pose, in order of parts."""
        A, b = blended_by(self.weights, self.J, R, x)
        return np.einsum("nij,nj->ni", A, self.rest) + b

    def contacts(self, R, x, margin):
        """Contacts of all limbs nearer than `margin` [m] to a part that is not their own, in the pose of these transforms. Those of
        two limbs wait while one of them lies DEEP in the trunk or the head: there they would lock one another in."""
        V, n, most = self.skin(R, x), len(self.limbs), 2 * self.worn.thick.max(initial=0)
        boxes, surfaces = [_box(V[part.span], margin + most) for part in self.parts], {}

        def touching(i, j):
            limb = self.limbs[i]
            at = V[limb.span][limb.points]
            near = np.flatnonzero(_within(at, boxes[j]))
            if not len(near):
                return None
            surfaces[j] = surfaces.get(j) or PosedPart(V, self.parts[j], self.carried, self.worn)
            worn = self.worn.of(limb.span).of(limb.points[near])
            hit, distance, room, *rest = surfaces[j].nearest(at[near], margin, worn)
            near = near[hit]
            rows = self._rows(R, x, at[near], self.carried[limb.span][limb.points[near]], *rest)
            return Contacts(distance, room, limb.weight[near], limb.past[near], rows)

        found = [[touching(i, j) for j in range(n, len(self.parts))] for i in range(n)]
        free = [i for i in range(n) if not any(c and (c.distance < -DEEP).any() for c in found[i])]
        found.append([touching(i, j) for i in free for j in free if i != j])
        empty = Contacts(*np.zeros((3, 0)), np.zeros(0, bool), np.zeros((0, len(self.stiff))))
        return Contacts(*map(np.concatenate, zip(empty, *(c for of in found for c in of if c))))

    def crowded(self, R, x):
        """Whether limbs, beyond the crease, leave too little room for what is worn in the pose of these transforms."""
        if not self.worn.thick.any():
            return False
        found = self.contacts(R, x, 0.0)
        return bool((found.past & (found.room > 0)).any())

    def _rows(self, R, x, p, p_carried, q, normal, q_carried):
        axes = np.moveaxis(R[self.parents[self.turned]], 2, 1)  # rows: a joint's three axes in the world
        # d distance = n . (w_p a x (p - x) - w_q a x (q - x)) = a . (w_p (p - x) - w_q (q - x)) x n
        x = x[self.turned]
        lever = p_carried[..., None] * (p[:, None] - x) - q_carried[..., None] * (q[:, None] - x)
        rows = np.einsum("jac,kjc->kja", axes, np.cross(lever, normal[:, None]))
        return rows.reshape(len(p), len(self.stiff))

    def pairs(self, R, x):
        """How many pairs of faces, one of a limb beyond its crease, one of another part, intersect."""
        V = self.skin(R, x)
        count = 0
        for i, limb in enumerate(self.limbs):
            for j, other in enumerate(self.parts[i + 1 :], i + 1):
                faces = other.beyond if j < len(self.limbs) else other.faces
                count += _pairs(V[limb.span], limb.beyond, V[other.span], faces, max(limb.edge, other.edge))
        return count


def _from_cut(rest, F, inside):
    """(n,) [m] along the surface from where the vertices `inside` border on others."""
    edges = kernels.unique_edges(F)
    cut = np.unique(edges[inside[edges[:, 0]] != inside[edges[:, 1]]])
    return distance_along_edges(rest, edges, cut)


def _part(rest, F, own, span, away, area):
    number = np.cumsum(own) - 1
    V, F, away = rest[own], number[F[own[F].all(1)]].astype(np.int32), away[own]
    points = spread_points(V, POINTS)
    weight = np.clip(2 * away[points] / CREASE - 1, 0, 1) * area[own].sum() / len(points) / AREA
    points, weight, past = points[weight > 0], weight[weight > 0], away[points[weight > 0]] > CREASE
    i, j = kernels.unique_edges(F).T
    longest = float(np.linalg.norm(V[i] - V[j], axis=1).max())
    return Part(
        span, F, kernels.border_vertices(F, len(V)), points, weight, past, F[(away[F] > CREASE).all(1)], longest
    )


def _box(V, more):
    X = np.ascontiguousarray(V.T)
    return X.min(1) - more, X.max(1) + more


def _within(V, box):
    inside = (V > box[0]) & (V < box[1])
    return inside[:, 0] & inside[:, 1] & inside[:, 2]


def _pairs(V, F, U, U_F, edge):
    """Number of faces that intersect; `edge` [m]: none of theirs is longer."""
    F, U_F = _faces_in(V, F, _box(U, edge)), _faces_in(U, U_F, _box(V, edge))
    return len(kernels.intersecting_pairs(V, F, U, U_F)) if len(F) and len(U_F) else 0


def _faces_in(V, F, box):
    near = _within(V, box)
    return F[near[F[:, 0]] | near[F[:, 1]] | near[F[:, 2]]]


class PosedPart:
    """A posed part that points are measured from; `carried` (n,joints) and `worn`, a Wrapping, are of all vertices."""

    def __init__(self, V, part, carried, worn):
        self.V, self.part, self.carried = V[part.span], part, carried[part.span]
        self.worn = worn.of(part.span)
        self.index = kernels.SurfaceIndex(self.V, part.faces)

    @cached_property
    def normals(self):
        return kernels.vertex_normals(self.V, self.part.faces)

    def _side(self, p, behind):
        """(k,) -1 of points inside, 1 of others. Those `behind` (k,) the nearest normal are inside if the part winds about them: past
        where it is cut off its normals say nothing."""
        side, behind = np.ones(len(p)), np.flatnonzero(behind)
        if len(behind):
            side[behind[kernels.winding_number(p[behind], self.V, self.part.faces) > 0.5]] = -1
        return side

    def nearest(self, p, margin, worn):
        """Of points (k,3) that wear a Wrapping those `hit` (h,) nearer than `margin` [m] with what is worn: distance, the room this
        takes, nearest point, direction away, and what carries it."""
        face, q, bary, distance = self.index.closest(p, REACH)
        corners = self.part.faces[face]
        normal = np.einsum("kc,kcx->kx", bary, self.normals[corners])
        side = self._side(p, np.einsum("kx,kx->k", p - q, normal) < 0)
        at_border = (self.part.border[corners] | (bary < 1e-9)).all(1)  # beyond it the part goes on in another
        both = worn.under & self.worn.under[corners].all(1)
        room = np.where(both, worn.thick + np.einsum("kc,kc->k", bary, self.worn.thick[corners]), 0.0)
        hit = np.flatnonzero((face >= 0) & (side * distance - room < margin) & ~at_border)
        corners, bary, q, distance, room = corners[hit], bary[hit], q[hit], (side * distance)[hit], room[hit]
        away = np.where(np.abs(distance[:, None]) > 1e-4, (p[hit] - q) * np.sign(distance)[:, None], normal[hit])
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return hit, distance - room, room, q, away, np.einsum("kc,kcj->kj", bary, self.carried[corners])
