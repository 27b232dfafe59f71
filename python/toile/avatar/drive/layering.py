"""Decoded garments moved out of the body and of one another (docs/method/animation.md): no loss forbids intersections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ... import kernels
from ...surface.dent import dented
from ...surface.layering import Layering

MARGIN = 0.002  # of cloth off what lies under it [m]
SHAPES = 10  # steps from a garment's rest shape to the frame's
STRETCH = 0.02  # [m] by which an edge may grow on the way out; more has led cloth across a limb
TURN = 0.025  # [rad] of the joint that turns most, between two poses of the way from rest


class GarmentLayering:
    """Garments of an Avatar out of the layers under them, inner to outer. `skin_faces`: those of the body that cloth can meet."""

    def __init__(self, avatar, skin_faces):
        self.avatar = avatar
        self.body = next(layer for layer in avatar.layers if layer.kind != "garment")
        self.garments = [layer for layer in avatar.layers if layer.kind == "garment"]
        self.skin_faces = skin_faces
        sizes = [(layer.name, layer.faces, len(layer.rest)) for layer in self.garments]
        self.layering = Layering(skin_faces, len(self.body.rest), sizes, MARGIN)
        self.edges = {layer.name: kernels.unique_edges(layer.faces).T for layer in self.garments}

    @torch.no_grad()
    def __call__(self, decoded, pose):
        """({layer: Decoded} of one sample, pairs of triangles that intersected, pairs left). `pose` {"rotations" (1,K,3),
        "translation" (1,3)}: the sample's. What keeps pairs, or is drawn out long, is led there in its stead, if that
        leaves fewer pairs, or as few and shorter edges. Where cloth meets skin even so, for want of room, the skin gives way."""
        cloth = {g.name: points(decoded[g.name]) for g in self.garments}
        layered = self.layering.solve(points(decoded[self.body.name]), cloth)
        before = layered.intersections_before
        ways = self._ways(decoded, pose)
        while self._caught(cloth, layered) and (other := next(ways, None)) is not None:
            layered = min(layered, other, key=lambda f: (f.intersections_left, self._stretch(cloth, f.vertices)))
        moved = dict(decoded)
        for name, V in layered.vertices.items():
            moved[name] = replace(decoded[name], vertices=self._tensor(V, decoded[name]))
        moved, left = self._given_way(moved, layered)
        return moved, before, left

    def _given_way(self, placed, layered):
        """(`placed`, pairs left) with the skin dented where garments, as `layered`, meet it, if that ends it."""
        left, skin = layered.intersections_left, placed[self.body.name]
        if not left:
            return placed, left
        parts = self.layering.attachments
        cloths = [(layered.vertices[name][part.cloth], part.faces) for name, part in parts.items()]
        meet = lambda V: sum(len(kernels.intersecting_pairs(V, self.skin_faces, *cloth)) for cloth in cloths)
        before, V = meet(points(skin)), dented(points(skin), self.skin_faces, cloths)
        if not before or V is None:
            return placed, left
        skin = replace(skin, vertices=self._tensor(V, skin))
        return placed | {self.body.name: skin}, left - before + meet(points(skin))

    def dent(self, decoded, shown):
        """How far skin gave way at most [m] between a sample as it is decoded and as it is shown."""
        given, placed = (points(one[self.body.name]) for one in (decoded, shown))
        return float(np.linalg.norm(placed - given, axis=1).max())

    def _caught(self, cloth, layered):
        """Whether cloth was not led out, or was drawn out long."""
        return layered.intersections_left > 0 or self._stretch(cloth, layered.vertices) > STRETCH

    def _stretch(self, cloth, moved):
        """By how much the edge grew that grew most [m]."""
        length = lambda V, ij: np.linalg.norm(V[ij[0]] - V[ij[1]], axis=1)
        grown = [length(moved[name], ij) - length(cloth[name], ij) for name, ij in self.edges.items()]
        return max((float(one.max(initial=0)) for one in grown), default=0.0)

    def _ways(self, decoded, pose):
        """Layered of the frame's shapes as they come to its pose: from rest, in small turns, cloth carried along and moved out at each,
        so that a limb comes to its place pushing the cloth before it; and so that cloth is about the right limbs even at rest, after
        small steps there from the garments' rest shapes."""
        way = _Way(self, decoded, pose)
        if way.go(0.0).intersections_left == 0:
            yield way.turn()
        way = _Way(self, decoded, pose)
        goal = {g.name: way.unposed[g.name] for g in self.garments}
        rest = {g.name: goal[g.name].new_tensor(g.rest)[None] for g in self.garments}
        step = {name: (goal[name] - rest[name]) / SHAPES for name in goal}
        way.unposed |= rest
        way.go(0.0)
        for _ in range(SHAPES):
            way.unposed |= {name: way.unposed[name] + one for name, one in step.items()}
            way.go(0.0)
        yield way.turn()

    def _tensor(self, V, like):
        return torch.tensor(V, dtype=torch.float32, device=like.vertices.device)[None]


class _Way:
    """`unposed` {layer: (1,n,3)}, a frame's shapes, which change as they go: its garments are moved out wherever they come by."""

    def __init__(self, layering, decoded, pose):
        avatar = layering.avatar
        self.layering, self.pose, self.skeleton = layering, pose, avatar.skeleton
        self.skin = {name: avatar.model(name).skin for name in decoded}
        transforms = self.skeleton(pose["rotations"], pose["translation"])
        self.unposed = {name: self.skin[name].unpose(one.vertices, *transforms) for name, one in decoded.items()}

    def turn(self):
        """Layered at the pose, all the way from rest."""
        for share in shares(self.pose["rotations"]):
            layered = self.go(share)
        return layered

    def go(self, share):
        """Layered of the shapes at so much of the way from rest to the pose, which they take on; the root turns as in the pose."""
        rotations = self.pose["rotations"] * share
        rotations[:, 0] = self.pose["rotations"][:, 0]
        transforms = self.skeleton(rotations, self.pose["translation"])
        posed = {name: _array(self.skin[name].pose(V, *transforms)) for name, V in self.unposed.items()}
        layered = self.layering.layering.solve(posed.pop(self.layering.body.name), posed)
        for name, V in layered.vertices.items():
            self.unposed[name] = self.skin[name].unpose(self.unposed[name].new_tensor(V)[None], *transforms)
        return layered


def shares(rotations):
    """Of rotation vectors (1,K,3), from none to all, so that no joint but the root turns by more than TURN [rad] at once."""
    most = float(rotations[:, 1:].norm(dim=-1).max()) if rotations.shape[1] > 1 else 0.0
    turns = int(np.ceil(most / TURN))
    return np.linspace(0, 1, turns + 1) if turns else np.ones(1)


def points(decoded):
    return _array(decoded.vertices)


def _array(V):
    return V[0].double().cpu().numpy()
