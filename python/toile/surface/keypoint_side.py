"""How far a posed body lies from triangulated keypoints, limb by limb: what a scan without a limb does not tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import kernels
from ..kernels.arrays import Floats
from ..scene import BodyModel, Person, Points3D
from .keypoints import keypoint_bones
from .limbs import LIMBS
from .two_sided import FAR

# What the surface off its keypoints weighs against scan and body off one another. A scan that lacks a limb is as well explained by a
# pose that hides it; one that shows a limb, and keypoints put it elsewhere, is off such a pose by the limb. On arms and legs of the
# mean body laid four and five other ways the first asks for no weight at all, the second for less than 0.35.
WEIGHT = 0.2


class BesideKeypoints(NamedTuple):
    """What counts beside a TwoSided's distance [m]: of each limb, and of trunk and head, the median distance of its keypoints, up to
    twice FAR, by its share of the surface, times WEIGHT. `contradicted`: one of them is beyond FAR. `vouched`: none is, and of every
    limb half of its keypoints and more are seen, three in four of these within FAR."""

    distance: float
    contradicted: bool
    vouched: bool


class KeypointSide:
    """Measures poses of a Person against Points3D, of which single ones may be wrong, as TwoSided measures them against a scan."""

    def __init__(self, model: BodyModel, person: Person):
        self.model, self.person, self.bones = model, person, keypoint_bones(model)
        self.row = {name: i for i, name in enumerate(model.keypoint_names)}
        of_joint = np.zeros(len(model.parents), int)  # 0: trunk and head
        for part, limb in enumerate((k for k in map(model.joint, LIMBS) if k is not None), 1):
            of_joint[limb] = part
        for joint, parent in enumerate(model.parents):
            of_joint[joint] = of_joint[joint] or (of_joint[parent] if parent >= 0 else 0)
        self.part, faces = of_joint[self.bones], model.skin_faces
        of_face = of_joint[model.mover][faces[:, 0]]
        area = np.bincount(of_face, kernels.face_areas(person.rest, faces), of_joint.max() + 1)
        self.share = area / area.sum()

    def __call__(self, rotations: Floats, translation: Floats, points: Points3D | None) -> BesideKeypoints:
        """How a pose lies beside keypoints; 0 and False where there are none."""
        known = [] if points is None else [i for i, name in enumerate(points.names) if name in self.row]
        if not known:
            return BesideKeypoints(0.0, False, False)
        rows = [self.row[points.names[i]] for i in known]
        off = np.linalg.norm(self._places(rotations, translation)[rows] - points.points[known], axis=1)
        given = [off[self.part[rows] == part] for part in range(len(self.share))]
        parts = [some[np.isfinite(some)] for some in given]
        distance = np.array([np.median(some) if len(some) else 0.0 for some in parts])
        contradicted = bool((distance > FAR).any())
        vouched = not contradicted and all(_vouch(*limb) for limb in list(zip(parts, given))[1:])
        weighed = float(WEIGHT * (self.share @ np.minimum(distance, 2 * FAR)))
        return BesideKeypoints(weighed, contradicted, vouched)

    def _places(self, rotations, translation):
        """The model's keypoints (q,3) in a pose, beside its own as the detector's lie."""
        rotations, translation = np.asarray(rotations), np.asarray(translation)
        R, x = self.model.joint_transforms(self.person.J, rotations, translation)
        V = self.model.skin(self.person.rest, self.person.J, rotations, translation)
        places, offsets = self.model.keypoints(V, x), self.person.keypoint_offsets
        return places if offsets is None else places + np.einsum("qij,qj->qi", R[self.bones], offsets)


def _vouch(seen, given):
    """Do the distances (k,) of a limb's keypoints that were seen, of those given, tell where all of it is?"""
    return bool(len(seen) and 2 * len(seen) >= len(given) and np.percentile(seen, 75) < FAR)
