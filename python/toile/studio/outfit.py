"""Garments on one body, inner to outer: each is simulated over the body and what is worn under it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .cloth import OVER_CLOTH, ClothSimulation
from .cut import outside
from .surface import open_loops, vertex_normals

LIP_REACH, LIP_DEPTH = 0.02, 0.006  # m: how far beyond the border, and below the skin, a border is turned in
HOLDING = 16  # triangles of the trunk that hold a point of a waistband: one alone folds it into every crease


@dataclass(frozen=True)
class Settled:
    """A garment at rest on the body in its rest pose, and what the simulation was begun with."""

    name: str
    flat: np.ndarray  # (G,3) the garment's rest shape before placement
    rest: np.ndarray  # (G,3) placed
    faces: np.ndarray  # (m,3)
    cloth_rest: np.ndarray  # (G,3) the simulation's rest shape
    first_body: np.ndarray  # (n,3) what the simulation was first worn over
    body: np.ndarray  # (n,3) and last
    vertices: np.ndarray  # (G,3) float32, in the world
    velocities: np.ndarray  # (G,3) float32
    held: np.ndarray  # (h,) vertices that the body holds: a waistband's

    @staticmethod
    def of(name, flat, rest, sim):
        vertices, body = sim.vertices.astype(np.float32), sim.body
        return Settled(name, flat, rest, sim.faces, sim.rest, sim.first_body, body, vertices, sim.velocities, sim.held)


class AttachedPoints:
    """Points that follow triangles of a surface as if stuck to them: the mean of where the `count` triangles with the
    nearest middles would take each. One alone follows every crease of the skin, many together its larger motion."""

    def __init__(self, points, V, F, count=1):
        from scipy.spatial import cKDTree

        near = cKDTree(V[F].mean(1)).query(points, count)[1].reshape(len(points), count)
        self.corners = F[near]
        origin, axes = self._frames(V)
        self.local = np.einsum("pkij,pkj->pki", axes, points[:, None] - origin)

    def at(self, V):
        """Where they are (p,3) when the surface's vertices are at V."""
        origin, axes = self._frames(V)
        return (origin + np.einsum("pkij,pki->pkj", axes, self.local)).mean(1)

    def _frames(self, V):
        a, b, c = np.moveaxis(V[self.corners], 2, 0)
        unit = lambda x: x / np.linalg.norm(x, axis=-1, keepdims=True)
        along, normal = unit(b - a), unit(np.cross(b - a, c - a))
        return a, np.stack([along, np.cross(normal, along), normal], -2)


class TurnedInGarment:
    """A garment as the next one meets it: its borders turned in under the skin, so that no open edge stands out."""

    def __init__(self, V, F, body_V, skin_faces):
        import igl

        loops = open_loops(F)
        border, after = np.concatenate(loops), np.concatenate([np.roll(loop, -1) for loop in loops])
        beyond = V[border] + LIP_REACH * outwards(V, F, loops)
        _, face, near = igl.point_mesh_squared_distance(beyond, body_V, skin_faces.astype(np.int64))[:3]
        T = body_V[skin_faces[face]]
        n = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
        self.edge = AttachedPoints(near - LIP_DEPTH * n / np.linalg.norm(n, axis=1, keepdims=True), body_V, skin_faces)
        lip = len(V) + np.arange(len(border))
        lip_after = np.concatenate(
            [np.roll(part, -1) for part in np.split(lip, np.cumsum([len(c) for c in loops])[:-1])]
        )
        sides = np.stack([after, border, lip], 1), np.stack([after, lip, lip_after], 1)
        self.faces = np.concatenate([F, *sides]).astype(np.int32)
        self.count = len(V) + len(border)

    def vertices(self, V, body_V):
        """(count,3): the garment's vertices V, then the turned-in edge's."""
        return np.concatenate([V, self.edge.at(body_V)])


def outwards(V, F, loops):
    """Unit vectors (b,3) at the vertices of the loops, one after the other: away from the cloth, in its surface."""
    along = np.concatenate([V[np.roll(c, -1)] - V[np.roll(c, 1)] for c in loops])
    out = np.cross(along, vertex_normals(V, F)[np.concatenate(loops)])
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def upper_border(V, F):
    """The open loop that lies highest, as a vertex cycle."""
    return max(open_loops(F), key=lambda loop: V[loop, 2].mean())


class LayersBelow:
    """What a garment is worn over: the body's skin, then the garments `worn` (Settled), inner to outer."""

    def __init__(self, body_V, skin_faces, worn):
        self.faces, self.lips, count = [skin_faces], [], len(body_V)
        for s in worn:
            lip = TurnedInGarment(s.vertices.astype(np.float64), s.faces, body_V, skin_faces)
            self.faces.append(lip.faces + count)
            self.lips.append(lip)
            count += lip.count

    def vertices(self, body_V, garments):
        """Vertices that `faces` index, for a body (n,3) and each garment (G,3)."""
        return np.concatenate([body_V, *(lip.vertices(V, body_V) for lip, V in zip(self.lips, garments))])


def runs_of_shirts(settled):
    """The garments, inner to outer, in lists: shirts over one another, which no waistband holds, in one."""
    runs = []
    for s in settled:
        if runs and not len(s.held) and not len(runs[-1][-1].held):
            runs[-1].append(s)
        else:
            runs.append([s])
    return runs


def joined(shirts):
    """Several shirts as one Settled, over what the innermost lies on."""
    if len(shirts) == 1:
        return shirts[0]
    flat, rest, cloth_rest, vertices, velocities = (
        np.concatenate([getattr(s, name) for s in shirts])
        for name in ("flat", "rest", "cloth_rest", "vertices", "velocities")
    )
    name, faces, under = "+".join(s.name for s in shirts), joined_faces(shirts), shirts[0]
    worn_over = under.first_body, under.body
    return Settled(name, flat, rest, faces, cloth_rest, *worn_over, vertices, velocities, under.held)


class Outfit:
    """The simulations of all garments of a sequence, as they stand when everything has settled on the body. Shirts over
    one another move together: in an armpit their folds lie between each other, and neither is a wall to the other."""

    def __init__(self, settled, body_V, skin_faces, trunk_faces):
        """On a body in its rest pose; `trunk_faces`: the part of its skin that holds waistbands."""
        runs = runs_of_shirts(settled)
        self.settled = [joined(run) for run in runs]
        self.under = [LayersBelow(body_V, skin_faces, self.settled[:i]) for i in range(len(self.settled))]
        held = [s.vertices[s.held].astype(np.float64) for s in self.settled]
        self.bands = [AttachedPoints(points, body_V, trunk_faces, HOLDING) for points in held]
        self.sims = []
        for run, s, under in zip(runs, self.settled, self.under):
            cloth = s.cloth_rest, s.faces, s.first_body, under.faces
            sim = ClothSimulation(*cloth, held=s.held, meets_itself=len(run) > 1)
            sim.go_on_from(s.vertices, s.velocities, s.body)
            self.sims.append(sim)

    def go_on_from(self, vertices, velocities, body_V):
        """Takes up the state, as `frame` and `velocities` gave it, in which another such outfit was left."""
        worn = []
        for sim, under, V, v in zip(
            self.sims, self.under, split(vertices, self.settled), split(velocities, self.settled)
        ):
            sim.go_on_from(V, v, under.vertices(body_V, worn))
            worn.append(V.astype(np.float64))

    @property
    def velocities(self):
        return np.concatenate([sim.velocities for sim in self.sims])

    def frame(self, body_V):
        """Advances one frame while the body goes to body_V (n,3); the garments' vertices, one after the other."""
        worn = []
        for sim, under, band in zip(self.sims, self.under, self.bands):
            below = under.vertices(body_V, worn)
            held = outside(band.at(body_V), below, np.concatenate(under.faces), OVER_CLOTH)
            worn.append(sim.frame(below, held))
        return np.concatenate(worn)


def split(values, settled):
    """The rows (..., G, 3) of all garments as one array a garment."""
    return np.split(values, np.cumsum([len(s.rest) for s in settled])[:-1], axis=-2)


def joined_faces(settled):
    """All garments' triangles over their vertices, one garment after the other."""
    start = np.cumsum([0, *(len(s.rest) for s in settled)])
    return np.concatenate([s.faces + n for s, n in zip(settled, start)]).astype(np.int32)
