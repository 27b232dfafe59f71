"""The body model as the core's kernels take it."""

from .. import _core
from .arrays import as_faces, as_floats, as_indices, as_vertices


def core_model(model):
    """`toile.scene.BodyModel` -> the core's BodyModel, checked there."""

    def floats(name, shape):
        return as_floats("body_model", name, getattr(model, name), shape)

    v_template, J = as_vertices("body_model", "v_template", model.v_template), as_vertices("body_model", "J", model.J)
    n, K = len(v_template), len(J)
    weights, shapes = floats("weights_val", (n, None)), floats("shapedirs", (n, 3, None))
    S = shapes.shape[2]
    joint = as_indices("body_model", "keypoint_joint", model.keypoint_joint)
    corners = [as_indices("body_model", "keypoint_vertices", vertices).tolist() for vertices in model.keypoint_vertices]
    keypoints = [
        _core.BodyKeypoint(name, int(j), vs, [1.0 / len(vs) for _ in vs])
        for name, j, vs in zip(model.keypoint_names, joint, corners)
    ]
    return _core.BodyModel(
        v_template,
        as_faces("body_model", "f", model.f),
        J,
        as_indices("body_model", "parents", model.parents).tolist(),
        as_faces("body_model", "weights_idx", model.weights_idx, width=weights.shape[1]),
        weights,
        shapes.reshape(3 * n, S),
        floats("J_shapedirs", (K, 3, S)).reshape(3 * K, S),
        keypoints,
    )
