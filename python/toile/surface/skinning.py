"""A garment skinned to the body beneath it."""

import numpy as np

from ..kinematics import blended_by, unblended
from ..scene import BodyModel, Person


class Skinning:
    """Garment vertices to and from one pose of a person, by the garment's own weights `skin` (g,K): x = A v + b. The pose are
    `rotations` (K,3) [rad] and `translation` (3,) [m]; `joints` (K,3) [m] are posed."""

    def __init__(self, model: BodyModel, person: Person, skin, rotations, translation):
        R, self.joints = model.joint_transforms(person.J, rotations, translation)
        self.A, self.b = blended_by(skin, person.J, R, self.joints)

    def pose(self, rest):
        return np.einsum("gij,gj->gi", self.A, rest) + self.b

    def unpose(self, posed):
        return unblended(posed, self.A, self.b)
