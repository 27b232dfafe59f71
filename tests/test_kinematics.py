"""Kinematics of a skinned body."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.fuzz.bodies import sound_body
from toile.kinematics import posed_joints


def test_joints_of_many_frames_are_those_of_each():
    model = sound_body()
    J, translation = model.J, np.array([0.1, 0.2, 0.3])
    rotations = np.random.default_rng(0).normal(scale=0.4, size=(5, *J.shape))
    local = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(*rotations.shape, 3)
    R, x = posed_joints(model.parents, J, local, translation)
    for t, vectors in enumerate(rotations):
        alone = model.joint_transforms(J, vectors, translation)
        assert np.allclose(R[t], alone[0], atol=1e-14) and np.allclose(x[t], alone[1], atol=1e-14)
