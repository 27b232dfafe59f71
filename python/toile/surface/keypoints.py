"""Where a detector's keypoints lie beside the body model's: an offset a keypoint, fixed in the frame of its bone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..kernels.arrays import Anything, Floats
from ..scene import HIDDEN, INTERPOLATED, OBSERVED, BodyModel


def learnt_offsets(model: BodyModel, J: Anything, poses: Any, found: Any, few: float) -> Any:
    """Offsets (q,3) [m] of the detector's keypoints from the model's, in the frame of each one's bone at rest.

    `poses`: (rotations, translation, vertices (n,3)) of frames, `found`: their Points3D. The median over the frames that saw a
    keypoint, m of them, shrunk by m / (m + few): what few frames show is the pose's error more than the detector's.
    """
    bones, rows = keypoint_bones(model), {name: i for i, name in enumerate(model.keypoint_names)}
    seen: list[list[Any]] = [[] for _ in rows]
    for (rotations, translation, V), points in zip(poses, found):
        R, x = model.joint_transforms(J, rotations, translation)
        places = model.keypoints(V, x)
        for name, point in zip(points.names, points.points):
            if name in rows and np.isfinite(point).all():
                row = rows[name]
                seen[row].append(R[bones[row]].T @ (point - places[row]))
    offsets = np.zeros((len(rows), 3))
    for row, some in enumerate(seen):
        if some:
            offsets[row] = np.median(some, axis=0) * len(some) / (len(some) + few)
    return offsets


def with_offsets(model: BodyModel, offsets: Anything | None) -> BodyModel:
    """The model with keypoints that lie `offsets` (q,3) [m] beside its own: each is one more vertex, of no face, which
    moves with its bone. For None, and for a model that names no keypoint, the model as it is."""
    if offsets is None or not len(offsets):
        return model
    bones, (n, B) = keypoint_bones(model), np.shape(model.weights_idx)
    at, basis = [], []
    for joint, vertices in zip(model.keypoint_joint, model.keypoint_vertices):
        at.append(model.J[joint] if joint >= 0 else model.v_template[vertices].mean(0))
        basis.append(model.J_shapedirs[joint] if joint >= 0 else model.shapedirs[vertices].mean(0))
    q = len(at)
    return replace(
        model,
        v_template=np.concatenate([model.v_template, np.array(at) + offsets]),
        shapedirs=np.concatenate([model.shapedirs, np.array(basis)]),
        weights_idx=np.concatenate(
            [model.weights_idx, np.repeat(bones[:, None], B, 1).astype(model.weights_idx.dtype)]
        ),
        weights_val=np.concatenate([model.weights_val, np.eye(1, B).repeat(q, 0)]),
        keypoint_joint=np.full(q, -1),
        keypoint_vertices=tuple(np.array([n + i]) for i in range(q)),
    )


def keypoint_bones(model: BodyModel) -> Any:
    """The joint (q,) that each keypoint moves with: its own, or the one that moves its vertices most."""
    bones = np.array(model.keypoint_joint)
    for row in np.flatnonzero(bones < 0):
        vertices = model.keypoint_vertices[row]
        moved = np.bincount(model.weights_idx[vertices].ravel(), model.weights_val[vertices].ravel())
        bones[row] = moved.argmax()
    return bones


def mirrored(name: str) -> str:
    """The same keypoint of the other side: "hand_left.finger1-1.L" -> "hand_right.finger1-1.R"; itself on the middle."""
    if not name.endswith((".L", ".R")):
        return name
    other = {"L": "R", "R": "L"}[name[-1]]
    swapped = name.replace("_left.", "_?.").replace("_right.", "_left.").replace("_?.", "_right.")
    return f"{swapped[:-1]}{other}"


def facial_places(
    model: BodyModel,
    points: Any,
    V: Anything,
    transforms: Any,
    offsets: Anything | None,
    confidence: Anything,
    settings: Any,
) -> tuple[Floats, int]:
    """Facial keypoints in the world (q,3) [m], NaN where unseen, and how many triangulated ones were left out.

    Each is the mean, weighted by their variances, of what was triangulated (Points3D) and of where a tracked surface V (n,3)
    of this confidence (n,) has them, unless it is hidden there. What lies farther than `face_reach` from the surface's is no
    keypoint of this face. `transforms` of the joints: R (K,3,3), x (K,3); `offsets` are those of `learnt_offsets` or None;
    `settings` TrackSettings."""
    times = {OBSERVED: 1.0, INTERPOLATED: settings.pose_unseen_factor, HIDDEN: np.inf}
    (R, x), found = transforms, {name: i for i, name in enumerate(points.names)}
    places = model.keypoints(V, x)
    if offsets is not None and len(offsets):
        places = places + np.einsum("qij,qj->qi", R[keypoint_bones(model)], offsets)
    facial, left_out = np.full((len(model.face_names), 3), np.nan), 0
    for row, name in enumerate(model.face_names):
        if name not in found:
            continue
        k, point, sigma = model.keypoint_names.index(name), points.points[found[name]], points.sigma[found[name]]
        vertices = np.asarray(model.keypoint_vertices[k], dtype=np.int64)
        spread = settings.face_sigma * times[confidence[vertices].min() if len(vertices) else HIDDEN]
        off = np.linalg.norm(point - places[k])
        left_out += int(off >= settings.face_reach)
        if off < settings.face_reach:  # NaN is neither
            facial[row] = places[k] + (point - places[k]) / (1 + (sigma / spread) ** 2)
        elif np.isfinite(spread):
            facial[row] = places[k]
    return facial, left_out
