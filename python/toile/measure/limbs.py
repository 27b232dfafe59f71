"""Whether each arm, leg and the head is shown by anything: the scan, keypoints, or pictures that it lies within."""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..kernels.arrays import Bools, Floats
from ..scene import OBSERVED, BodyModel, Camera
from ..surface.keypoints import keypoint_bones
from .evidence import UNSEEN
from .glimpse import Glimpse
from .judged import JudgedLayer

# roles at which begins what only a whole limb shows
LIMBS = ("lowerarm01.L", "lowerarm01.R", "lowerleg01.L", "lowerleg01.R")
DEEP = 0.02  # m: so far in the rest of the body is no limb that touches it
POINTS = 150  # of a limb, that are looked for in the rest of the body
VIEWS = 2  # in which a place must lie to be known by pictures; all, where there are fewer


def limbs_shown(seen: Glimpse, cameras: dict[str, Camera], model: BodyModel, body: JudgedLayer) -> dict[str, float]:
    """limb_observed: share of a forearm with its hand, a shank with its foot, or the head that the scan or pictures show, the least
    of the five; pictures show what lies within those with masks, and all of a limb of which keypoints are seen. limb_inside: share
    of the former four that lies DEEP and more in the rest of the body and that pictures do not show, the largest. {} of a model
    that does not name them."""
    firsts = {role: k for role in (*LIMBS, "head") if (k := model.joint(role)) is not None}
    beyond = [model.beyond(k) for k in firsts.values()]
    parts = [joints[model.mover] for joints in beyond]  # of the vertices, those that these joints move most
    own = [body.looks[part[body.looks]] for part in parts]
    if len(firsts) <= len(LIMBS) or not all(map(len, own)):
        return {}
    pictured = _pictured(seen, cameras, body.vertices)
    for first, joints, part in zip(firsts.values(), beyond, parts):
        pictured |= part & _detected(seen, cameras, model, joints, first)
    shown = pictured | (body.confidence == OBSERVED)
    inside = [_inside(body, part, looks, pictured) for part, looks in zip(parts[: len(LIMBS)], own)]
    return {"limb_observed": float(min(shown[looks].mean() for looks in own)), "limb_inside": max(inside)}


def _pictured(seen: Glimpse, cameras: dict[str, Camera], V: Floats) -> Bools:
    """bool (n,): which of the vertices lie within VIEWS of the pictures that have masks. Label images may show a part of the person
    and tell nothing of what they leave out."""
    views = () if seen.of_labels else seen.mask_views
    within = np.zeros(len(V), int)
    for name in views:
        within += cameras[name].sees(V)
    return within >= max(1, min(VIEWS, len(views)))


def _detected(
    seen: Glimpse, cameras: dict[str, Camera], model: BodyModel, joints: Bools, first: int
) -> bool | np.bool_:
    """Whether a keypoint that `joints` (K,) move is seen, within the picture, by VIEWS cameras. The place of the `first` joint itself,
    as an elbow, tells nothing of where the limb points."""
    rows = {name: i for i, name in enumerate(model.keypoint_names)}
    moved = joints[keypoint_bones(model)] & (np.asarray(model.keypoint_joint) != first)
    kept = [i for i, name in enumerate(seen.keypoint_names) if name in rows and moved[rows[name]]]
    if not kept or not seen.keypoints.size:
        return False
    size = np.array([cameras[name].size[::-1] for name in seen.keypoint_views])[:, None]
    at = seen.keypoints[:, kept]
    found = (at[..., 2] > UNSEEN) & (at[..., :2] >= 0).all(-1) & (at[..., :2] < size).all(-1)
    return (found.sum(0) >= min(VIEWS, len(found))).any()


def _inside(body: JudgedLayer, part: Bools, looks: np.ndarray, pictured: Bools) -> float:
    """Share of a limb's points that lie DEEP in the rest of the body and in no pictures."""
    points = looks[:: max(len(looks) // POINTS, 1)]
    hidden = points[~pictured[points]]
    if not len(hidden):
        return 0.0
    rest = body.faces[~part[body.faces].any(1)]
    deep = kernels.signed_distance(body.vertices[hidden], body.vertices, rest) < -DEEP
    return float(deep.sum() / len(points))
