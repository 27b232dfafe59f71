"""Truth bodies: anny phenotypes that leave the pipeline's model on purpose (smooth offsets, other skinning weights)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ..io.body import load_body_model
from ..scene import BodyModel
from ..surface.operators import smooth_on
from . import deviation
from .surface import smooth_noise, vertex_normals
from .truths import PLAIN, Hard

OFFSET_MM = (5.0, 15.0)  # largest displacement outside the model's span, drawn from this range
OFFSET_LENGTH = 0.12  # m, correlation length of the offsets
WEIGHT_SMOOTHING = 6  # umbrella steps on the skinning weights
INFLUENCES = 8  # bones per vertex kept


@dataclass(frozen=True)
class TruthBody:
    """A body of the studio: `rest` (n,3) [m] in anny's rest pose, z up, facing -y; joints `model.J` (K,3)."""

    model: BodyModel  # no shape basis; skinning weights differ from the pipeline's
    neutral: np.ndarray  # (n,3) anny's average body, soles at z = 0: coordinates that mean the same on every body
    skin_faces: np.ndarray  # (m,3) faces of the skin component, without eyes and tongue
    phenotype: dict[str, float]
    expressions: np.ndarray | None  # (e,n,3) facial actions, then a full breath, as rest displacements [m]
    offset: np.ndarray  # (n,3) what was added outside the model's span [m]
    bulges: np.ndarray  # (b,n,3) rest displacements [m] of muscles at full bend
    bulge_joints: np.ndarray  # (b,) the joint that bends each
    bulge_angles: np.ndarray  # (b,) [rad] at which it is full

    @property
    def rest(self):
        return self.model.v_template

    @property
    def J(self):
        return self.model.J

    @cached_property
    def dense_weights(self):
        W = np.zeros((len(self.rest), len(self.J)))
        np.put_along_axis(W, self.model.weights_idx, self.model.weights_val, axis=1)
        return W

    @cached_property
    def trunk_faces(self):
        """(k,3) faces of the skin that legs do not move."""
        leg = [n.startswith(("upperleg", "lowerleg")) for n in self.model.joint_names]
        still = self.dense_weights[:, leg].sum(1) < 0.1
        return self.skin_faces[still[self.skin_faces].all(1)]

    def pose(self, rotations, translation, expression=None):
        """Posed vertices (n,3) for rotations (K,3), translation (3,) and facial actions (e,)."""
        rest = self.rest if expression is None else self.rest + np.tensordot(expression, self.expressions, 1)
        if len(self.bulges):
            bend = np.linalg.norm(np.asarray(rotations)[self.bulge_joints], axis=1) / self.bulge_angles
            rest = rest + np.tensordot(np.sin(0.5 * np.pi * np.minimum(bend, 1)), self.bulges, 1)
        return self.model.skin(rest, self.J, rotations, translation)

    def joints(self, rotations, translation):
        return self.model.joint_transforms(self.J, rotations, translation)[1]


BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")
ACTIONS = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "mouthFunnel", "browInnerUp", *BLINKS)

PHENOTYPES = {  # gender 0 male .. 1 female; the rest around 0.5; drawn uniformly
    "fitted": dict(gender=(0.0, 1.0), age=(0.6, 0.7), muscle=(0.4, 0.6), weight=(0.35, 0.55), height=(0.4, 0.55)),
    "logo": dict(gender=(0.0, 0.4), age=(0.6, 0.75), muscle=(0.4, 0.7), weight=(0.3, 0.5), height=(0.45, 0.6)),
    "loose": dict(gender=(0.3, 1.0), age=(0.6, 0.75), muscle=(0.3, 0.5), weight=(0.2, 0.45), height=(0.35, 0.5)),
    "child": dict(gender=(0.0, 1.0), age=(0.25, 0.35), muscle=(0.4, 0.6), weight=(0.4, 0.6), height=(0.4, 0.6)),
    "tall": dict(gender=(0.0, 0.5), age=(0.6, 0.7), muscle=(0.4, 0.6), weight=(0.4, 0.6), height=(0.72, 0.8)),
    "heavy": dict(gender=(0.0, 0.6), age=(0.65, 0.8), muscle=(0.2, 0.4), weight=(0.95, 1.0), height=(0.4, 0.6)),
}
BELLY = {"heavy": 0.06}  # m that the belly stands out beyond what anny has


def make_body(subject, rng, hard: Hard = PLAIN):
    """Draws a truth body for `subject` in PHENOTYPES that leaves the pipeline's model as `hard` says."""
    phenotype = {k: round(float(rng.uniform(*v)), 4) for k, v in PHENOTYPES[subject].items()}
    phenotype["proportions"] = round(float(rng.uniform(0.4, 0.6)), 4)
    anny_model = load_anny()
    rest, J = anny_rest(anny_model, phenotype)
    neutral, _ = anny_rest(anny_model, dict.fromkeys(phenotype, 0.5) | {"age": 0.67})
    neutral = neutral - [0, 0, neutral[:, 2].min()]
    theirs = load_body_model("anny")
    faces = theirs.f  # anny cuts its quads along other diagonals on another processor
    skin = skin_component(faces, len(rest))
    names = tuple(anny_model.bone_labels)
    idx, val = anny_model.vertex_bone_indices.numpy(), anny_model.vertex_bone_weights.numpy()
    if hard.surface:
        offset = deviation.surface_offset(theirs, neutral, rest, J, skin, hard.surface, rng)
    else:
        offset = model_offset(neutral, rest, faces, idx, val, names, rng)
    if subject in BELLY:
        offset = offset + deviation.belly(theirs, rest, J, skin, BELLY[subject])
    w_idx, w_val = other_weights(idx, val, faces, len(names))
    model = BodyModel(
        v_template=rest + offset,
        f=faces,
        J=deviation.moved_joints(J, names, hard.joints, rng) if hard.joints else J,
        parents=np.array(anny_model.bone_parents),
        weights_idx=w_idx,
        weights_val=w_val,
        shapedirs=np.zeros((len(rest), 3, 0)),
        J_shapedirs=np.zeros((len(J), 3, 0)),
        joint_names=names,
    )
    normals, where = vertex_normals(rest + offset, skin), deviation.trunk_and_limbs(theirs)
    breath = deviation.breath(model, normals, hard.breath)
    actions = np.concatenate([facial_actions(phenotype, rest), breath[None]])
    bulges = (
        deviation.muscles(model, normals, where, hard.bulge, rng) if hard.bulge else deviation.no_muscles(len(rest))
    )
    return TruthBody(model, neutral, skin, phenotype, actions, offset, *bulges)


def load_anny(**options):
    import torch
    import warp

    warp.config.log_level = warp.LOG_ERROR
    import anny

    return anny.Anny(**options).to(torch.float64)


def anny_rest(model, phenotype, **actions):
    """Rest vertices (n,3) and joints (K,3) of an anny model [m]."""
    import torch

    def one(values):
        return {k: torch.tensor([v], dtype=torch.float64) for k, v in values.items()}

    extra = {"facial_actions": one(actions)} if actions else {}
    with torch.no_grad():
        out = model(phenotype_kwargs=one(phenotype), **extra)
    return out["rest_vertices"][0].numpy(), out["rest_bone_heads"][0].numpy()


def facial_actions(phenotype, rest):
    """Displacements (e,n,3) of ACTIONS on this phenotype."""
    model = load_anny(facial_actions=list(ACTIONS))
    return np.array([anny_rest(model, phenotype, **{a: 1.0})[0] - rest for a in ACTIONS])


def model_offset(neutral, rest, faces, idx, val, names, rng):
    """A smooth field along the normals, OFFSET_MM at its largest, fading on head, hands and feet."""
    field = smooth_noise(neutral, OFFSET_LENGTH, rng)
    fade = fade_of(idx, val, names)
    field = field * fade
    field *= 1e-3 * rng.uniform(*OFFSET_MM) / np.abs(field).max()
    return field[:, None] * vertex_normals(rest, faces)


def fade_of(idx, val, names):
    """1 on torso, arms and legs, 0.25 on head, hands and feet: their features are smaller than the offsets."""
    fine = ("finger", "metacarpal", "wrist", "toe", "foot", "head", "eye", "neck")
    small = np.array([n.startswith(fine) for n in names])
    return 1 - 0.75 * (val * small[idx]).sum(1)


def other_weights(idx, val, faces, bones):
    """Skinning weights smoothed over the surface, the INFLUENCES largest kept: other weights than the pipeline's."""
    n = len(idx)
    W = np.zeros((n, bones))
    np.add.at(W, (np.arange(n)[:, None], idx), val)
    W = smooth_on(faces, W, WEIGHT_SMOOTHING)
    keep = np.argsort(-W, axis=1, kind="stable")[:, :INFLUENCES]
    kept = np.take_along_axis(W, keep, 1)
    return keep.astype(np.int32), kept / kept.sum(1, keepdims=True)


def skin_component(faces, n):
    """Faces of the largest connected component (the skin)."""
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = sp.coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    label = sp.csgraph.connected_components(graph, directed=False)[1]
    return faces[label[faces[:, 0]] == np.bincount(label).argmax()]
