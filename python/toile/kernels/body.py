"""The body model as the core's kernels take it."""

import numpy as np

from .. import _core


def core_model(model):
    """`toile.scene.BodyModel` -> the core's BodyModel, checked there."""
    n, K, S = len(model.v_template), len(model.parents), model.shapedirs.shape[2]
    keypoints = [
        _core.BodyKeypoint(name, int(j), [int(v) for v in vs], [1.0 / len(vs)] * len(vs) if len(vs) else [])
        for name, j, vs in zip(model.keypoint_names, model.keypoint_joint, model.keypoint_vertices)
    ]
    return _core.BodyModel(
        np.ascontiguousarray(model.v_template, np.float64),
        np.ascontiguousarray(model.f, np.int32),
        np.ascontiguousarray(model.J, np.float64),
        [int(p) for p in model.parents],
        np.ascontiguousarray(model.weights_idx, np.int32),
        np.ascontiguousarray(model.weights_val, np.float64),
        np.ascontiguousarray(model.shapedirs.reshape(3 * n, S), np.float64),
        np.ascontiguousarray(model.J_shapedirs.reshape(3 * K, S), np.float64),
        keypoints,
    )
