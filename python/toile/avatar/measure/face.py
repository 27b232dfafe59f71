"""The face of an avatar: the pixels that show it, and what its decoded keypoints err by."""

from __future__ import annotations

import numpy as np

from ... import kernels
from ...measure.truth import millimetres

FACE_REACH = 0.03  # the face is within this of a facial keypoint [m]


class Facial:
    """The face of a body model."""

    def __init__(self, model):
        self.faces = model.skin_faces
        near = np.zeros(len(model.v_template), bool)
        near[model.face_vertices(FACE_REACH)] = True
        self.near = near[self.faces].all(1)
        self.points = {  # by name: the vertices whose mean it is
            name: vertices
            for name, joint, vertices in zip(model.keypoint_names, model.keypoint_joint, model.keypoint_vertices)
            if name.startswith("face.") and joint < 0
        }

    def pixels(self, V, K, shape):
        """Those (H,W) bool that show the face of a body of vertices V (n,3) [m] in the camera's frame."""
        if not self.near.any():
            return np.zeros(shape, bool)
        face = np.asarray(kernels.raster(V, self.faces, K, shape).face)
        return (face >= 0) & self.near[face]

    def errors(self, V, true):
        """Facial keypoints of body vertices V (n,3) to the true ones {name: place (3,)} [mm]: `face_mm`, and `expression_mm`
        after the rigid motion that brings them nearest (Kabsch 1976), which the head's pose does not enter. None without three.
        """
        names = [name for name in self.points if name in true]
        if len(names) < 3:
            return {"face_mm": None, "expression_mm": None}
        P = np.array([V[self.points[name]].mean(0) for name in names])
        T = np.array([true[name] for name in names])
        return {
            "face_mm": millimetres(np.linalg.norm(P - T, axis=1)),
            "expression_mm": millimetres(np.linalg.norm(rigidly_onto(P, T) - T, axis=1)),
        }


def rigidly_onto(P, T):
    """Points P (k,3) turned and moved onto T (k,3)."""
    from scipy.spatial.transform import Rotation

    p, t = P - P.mean(0), T - T.mean(0)
    return Rotation.align_vectors(t, p)[0].apply(p) + T.mean(0)
