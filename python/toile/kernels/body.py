"""The body model as the core's kernels take it."""

from typing import Any, Protocol

from .. import _core
from .arrays import Anything, Floats, as_faces, as_floats, as_indices, as_vertices


class BodyArrays(Protocol):
    """What kernels read of a body model; `toile.scene.BodyModel` is one."""

    @property
    def core(self) -> Any: ...
    @property
    def v_template(self) -> Anything: ...
    @property
    def f(self) -> Anything: ...
    @property
    def J(self) -> Anything: ...
    @property
    def parents(self) -> Anything: ...
    @property
    def weights_idx(self) -> Anything: ...
    @property
    def weights_val(self) -> Anything: ...
    @property
    def shapedirs(self) -> Anything: ...
    @property
    def J_shapedirs(self) -> Anything: ...
    @property
    def joint_names(self) -> tuple[str, ...]: ...
    @property
    def joint_roles(self) -> tuple[str, ...]: ...
    @property
    def inside(self) -> Anything: ...
    @property
    def keypoint_names(self) -> tuple[str, ...]: ...
    @property
    def keypoint_joint(self) -> Anything: ...
    @property
    def keypoint_vertices(self) -> tuple[Anything, ...]: ...
    @property
    def segments(self) -> dict[str, Anything]: ...


def core_model(model: BodyArrays) -> Any:
    """`toile.scene.BodyModel` -> the core's BodyModel, checked there."""

    def floats(name: str, shape: tuple[int | None, ...]) -> Floats:
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
