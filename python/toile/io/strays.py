"""Whether a body that a figure drives lies as the figure's own joints do, told by where both have their joints."""

from __future__ import annotations

import numpy as np

from ..kinematics import posed_joints
from .retargeting import BONES, clip_places, roles_of

TRUNK = ("root", "neck01")
FEET = {f"foot.{side}": f"toe1-1.{side}" for side in "LR"}
ASTRAY = {
    "limb": 5.0,
    "trunk": 20.0,
    "foot": 50.0,
}  # degrees beyond which a bone is told of: bodies differ in where joints lie


def strays(figure, pick, found, model, J, R):
    """{limb, trunk or foot of the figure: degrees (T,)} by which the body `model` with rest joints J (K,3) and local rotations R
    (T,K,3,3), x left, y back, z up, lies otherwise than the frames `pick` of the figure lead it; 0 where both agree as far as bodies do."""
    ours, theirs, at = (
        posed_joints(model.parents, J, R, np.zeros(3))[1],
        clip_places(figure, pick, found),
        roles_of(figure),
    )
    limbs = {f"{role}.{side}": f"{end}.{side}" for role, end in BONES.items() for side in "LR"}
    bones = (
        [(*bone, "limb") for bone in limbs.items()] + [(*TRUNK, "trunk")] + [(*bone, "foot") for bone in FEET.items()]
    )
    told = {}
    for role, end, kind in bones:
        if not {role, end} <= set(model.joint_roles) & at.keys():
            continue
        off = angles(ours[:, model.joint(end)] - ours[:, model.joint(role)], theirs[:, at[end]] - theirs[:, at[role]])
        if off.max() > ASTRAY[kind]:
            told[f"{figure.names[at[role]]} to {figure.names[at[end]]}"] = np.where(off > ASTRAY[kind], off, 0.0)
    return told


def angles(a, b):
    """Degrees (T,) between vectors (T,3)."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ti,ti->t", a, b)))
