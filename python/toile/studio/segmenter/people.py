"""Clothed people in many poses, without simulation: bodies of the studio, garments cut from them or painted onto them, all
moved by the body's bones; and those of studio captures, whose cloth was simulated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...kinematics import blend_skinning
from ...surface.operators import smooth_on
from ..body import make_body
from ..cut import cut_garment, hung, shirt_field
from ..motions import MOTIONS
from ..surface import smooth_noise, vertex_normals
from ..truth import random_frame
from . import CLASSES

TOPS, BOTTOMS = ("tshirt", "longsleeve", "tank"), ("trousers", "shorts", "skirt")
GARMENTS = (*TOPS, *BOTTOMS, "dress")
MOVED = ("walk", "rom", "talk", "fast", "sit")
FRAMES = 90  # of each motion, of which some are taken
WORN = 0.4  # share of people whose cloth was simulated, where captures are given
LOOSE = (0.0, 0.03)  # m that garments stand off more than they were cut
WRINKLE, WRINKLE_LENGTH = (0.0, 0.008), (0.02, 0.08)  # m
WEIGHTS_FROM, WEIGHT_SMOOTHING = 4, 6  # body vertices, umbrella steps
LENGTHENED = {"tshirt": 0.3, "longsleeve": 0.3, "tank": 0.3, "skirt": 0.35, "dress": 0.3}  # m, of the tallest, at most
SHORTENED = {
    "tshirt": 0.22,
    "longsleeve": 0.22,
    "tank": 0.22,
    "trousers": 0.35,
    "skirt": 0.2,
    "dress": 0.25,
    "shorts": 0.1,
}
SHORT = 0.1  # m that a top over bare legs is longer at most
TALL = 1.7  # m, of whom lengths are told
TUCKED, LEGGED = 0.2, 0.4  # shares of tops under the bottoms, and of trousers and skirts over tights


@dataclass(frozen=True)
class DressedPerson:
    """One posed person. `layer` (m,) of each face is 0 for the body, else a garment; `classes` {layer: class} of garments;
    `place` (n,3) [m] are coordinates fixed to skin and cloth; `part` (n,3) of the body's vertices: the shares of arm and
    head, and metres to a shirt's nearest border, positive inside; `painted` what is painted on the body, see `body_class`."""

    vertices: np.ndarray
    faces: np.ndarray
    layer: np.ndarray
    classes: dict[int, int]
    place: np.ndarray
    part: np.ndarray
    painted: dict[str, float]


def body_class(place, part, painted):
    """Classes (p,) of points of the body."""
    y, z = place[:, 1], place[:, 2]
    arm, head, inside = part.T
    label = np.full(len(place), CLASSES.index("skin"))
    legs = (arm < 0.5) & (z < painted["waist"]) & (z > painted["ankle"])
    label[legs] = CLASSES.index("bottom")
    label[inside > painted["top"]] = CLASSES.index("top")
    label[(z < painted["shoe"]) & (arm < 0.5)] = CLASSES.index("shoes")
    label[(head > 0.5) & (z > 1.67) & ((z - 1.76) + 1.1 * (y + 0.07) > painted["hair"])] = CLASSES.index("hair")
    return label


def painted(rng, bare_legs, bare_trunk):
    """What is painted on the body [m on the neutral body]; out of reach where nothing is."""
    return {
        "waist": 0.0 if bare_legs else rng.uniform(1.0, 1.1),
        "ankle": rng.choice([0.0, rng.uniform(0.3, 0.9)]),
        "top": 9.0 if bare_trunk else 0.0,
        "shoe": rng.choice([0.0, rng.uniform(0.07, 0.2)], p=[0.25, 0.75]),
        "hair": rng.choice([9.0, rng.uniform(-0.05, 0.05)], p=[0.1, 0.9]),
    }


@dataclass(frozen=True)
class SkinnedGarment:
    """Cut from a body at rest: `vertices`, `faces`, and dense skinning weights as indices and values."""

    vertices: np.ndarray
    faces: np.ndarray
    idx: np.ndarray
    val: np.ndarray


class Wardrobe:
    """A body of the studio and the garments cut from it; people in it come one after the other."""

    def __init__(self, subject, rng):
        self.rng, self.body = rng, make_body(subject, rng)
        self.garments = {name: self._garment(name) for name in GARMENTS}
        names = self.body.model.joint_names
        limb = [n.startswith(("upperarm", "lowerarm", "wrist", "finger", "metacarpal")) for n in names]
        head = [n in ("head", "neck03") for n in names]
        self.shares = np.stack([self.body.dense_weights[:, limb].sum(1), self.body.dense_weights[:, head].sum(1)], 1)

    def _garment(self, name):
        from scipy.spatial import cKDTree

        V, F = cut_garment(name, self.body)
        near = cKDTree(self.body.rest).query(V, WEIGHTS_FROM)[1]
        W = smooth_on(F, self.body.dense_weights[near].mean(1), WEIGHT_SMOOTHING)
        idx = np.argsort(-W, 1)[:, :8].astype(np.int32)
        val = np.take_along_axis(W, idx, 1)
        return SkinnedGarment(V, F, idx, val / val.sum(1, keepdims=True))

    @cached_property
    def poses(self):
        """Rotations (K,3) [rad] of all motions, some of them wider than the studio's."""
        moved = [MOTIONS[name](self.body, FRAMES, self.rng).rotations for name in MOVED]
        return np.concatenate(moved)

    def outfit(self):
        """Names of garments worn, and whether legs and trunk are bare of paint."""
        rng, kind = self.rng, self.rng.uniform()
        if kind < 0.15:
            return ("dress",), True, True
        top = rng.choice([*TOPS, "painted", "bare"], p=[0.4, 0.17, 0.17, 0.14, 0.12])
        bottom = rng.choice([*BOTTOMS, "painted", "bare"], p=[0.18, 0.18, 0.13, 0.46, 0.05])
        worn = tuple(str(name) for name in (bottom, top) if name in GARMENTS)
        tights = bottom == "painted" or (bottom in ("trousers", "skirt") and rng.uniform() < LEGGED)
        return worn, not tights, top != "painted"

    def tailored(self, name, most):
        """V (n,3) and F (m,3) of a garment at rest, shorter or up to `most` [m] longer than it was cut, its sleeves too."""
        rng, g = self.rng, self.garments[name]
        V, F, tall = g.vertices, g.faces, np.ptp(self.body.rest[:, 2]) / TALL
        change = rng.choice(["as cut", "longer", "shorter"], p=[0.3, 0.45, 0.25])
        if change == "longer" and most > 0:
            V = hung(V, rng.uniform(0, most) * tall, rng.uniform(-0.05, 0.2))
        elif change == "shorter" and name in SHORTENED:
            F = F[V[F][:, :, 2].mean(1) > V[:, 2].min() + rng.uniform(0, SHORTENED[name]) * tall]
        if name in TOPS and rng.uniform() < 0.4:
            wide = np.abs(V[F][:, :, 0]).mean(1)
            F = F[wide < wide.max() * rng.uniform(0.55, 1)]
        return V, F

    def person(self):
        """The next DressedPerson."""
        rng, body = self.rng, self.body
        worn, bare_legs, bare_trunk = self.outfit()
        worn = worn[::-1] if rng.uniform() < TUCKED else worn
        R = self.poses[rng.integers(len(self.poses))] * rng.uniform(0.6, 1.4)
        world, joints = body.model.joint_transforms(body.J, R, np.zeros(3))
        model = body.model
        posed = [blend_skinning(body.rest, body.J, world, joints, model.weights_idx, model.weights_val)]
        faces, layer, place, classes = [body.skin_faces], [np.zeros(len(body.skin_faces), int)], [body.neutral], {}
        count, loose = len(body.rest), rng.uniform(*LOOSE)
        for i, name in enumerate(worn, 1):
            g, most = self.garments[name], LENGTHENED.get(name, 0.0)
            if (
                name in TOPS
            ):  # one that hides all there is on bare legs would be a dress; one under a waistband ends there
                most = 0.0 if i < len(worn) else min(most, SHORT) if bare_legs else most
            rest, F = self.tailored(name, most)
            loose = loose if i == 1 else max(0.0, loose + rng.normal(0.008, 0.006))
            V = crumpled(rest, F, loose if name in TOPS else 0.4 * loose, rng)
            posed.append(blend_skinning(V, body.J, world, joints, g.idx, g.val))
            faces.append(F + count)
            layer.append(np.full(len(F), i))
            place.append(rest)
            classes[i] = CLASSES.index("dress" if name == "dress" else "top" if name in TOPS else "bottom")
            count += len(V)
        sleeves = (rng.uniform(0.1, 1.2),) * 2
        neck, hem = rng.uniform(-0.02, 0.03), body.J[body.model.joint("upperleg01.L")][2] + rng.uniform(-0.04, 0.22)
        part = np.column_stack([self.shares, shirt_field(body, hem, neck, sleeves)])
        wrap = np.concatenate
        return DressedPerson(
            wrap(posed), wrap(faces), wrap(layer), classes, wrap(place), part, painted(rng, bare_legs, bare_trunk)
        )


def crumpled(V, F, loose, rng):
    """The garment standing off more, and wrinkled."""
    N = smooth_on(F, vertex_normals(V, F), 4)
    N /= np.maximum(np.linalg.norm(N, axis=1, keepdims=True), 1e-9)
    waves = rng.uniform(*WRINKLE) * smooth_noise(V * [1, 1, rng.uniform(0.4, 1)], rng.uniform(*WRINKLE_LENGTH), rng, 32)
    return V + (np.maximum(loose + waves, 0))[:, None] * N


def simulated(capture, wardrobe, rng):
    """A DressedPerson of a studio capture, its garments as the simulation left them."""
    body, garments = random_frame(capture, rng)
    posed, faces = [body], [wardrobe.body.skin_faces]
    layer, place, classes, count = [np.zeros(len(faces[0]), int)], [wardrobe.body.neutral], {}, len(body)
    for i, (name, V, first, F) in enumerate(garments, 1):
        posed.append(V)
        faces.append(F + count)
        layer.append(np.full(len(F), i))
        place.append(first - 0.5 * (first.min(0) + first.max(0)) + [0, 0, 1.2])
        classes[i] = CLASSES.index("dress" if name == "dress" else "bottom" if name in BOTTOMS else "top")
        count += len(V)
    bare = bool({CLASSES.index("bottom"), CLASSES.index("dress")} & set(classes.values()))
    part = np.column_stack([wardrobe.shares, np.full(len(body), -1.0)])
    wrap = np.concatenate
    return DressedPerson(wrap(posed), wrap(faces), wrap(layer), classes, wrap(place), part, painted(rng, bare, True))


def people(subjects, captures, rng):
    """People without end: of each subject in turn, and of the captures."""
    wardrobes = [Wardrobe(subject, rng) for subject in subjects]
    while True:
        wardrobe = wardrobes[rng.integers(len(wardrobes))]
        if captures and rng.uniform() < WORN:
            yield simulated(captures[rng.integers(len(captures))], wardrobe, rng)
        else:
            yield wardrobe.person()
