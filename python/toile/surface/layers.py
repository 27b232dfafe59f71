"""The surfaces of a registered run, unposed: the body and each garment, or the tracked surface as one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import UserError
from ..frame_numbers import evenly
from ..io.run import RegisteredSurface, Run
from ..kinematics import blended_transforms, unblended

BLEND = 8  # joints that move one vertex of a garment, at most


SHAPES = 512  # frames, evenly spread, that principal modes are taken of


@dataclass(frozen=True)
class Layer:
    """One surface of the avatar; UVs have a topology of their own, v up."""

    name: str  # "body", a garment's name, or "surface", the baseline's only layer
    kind: str  # "body", "garment" or "surface"
    rest: np.ndarray  # (n,3) mean unposed shape [m]
    faces: np.ndarray  # (m,3)
    uv: np.ndarray  # (t,2)
    face_uv: np.ndarray  # (m,3) into uv
    skin_idx: np.ndarray  # (n,B) joints
    skin_val: np.ndarray  # (n,B) rows sum to 1
    label: int  # id in the scene's label table; -1 for body and surface
    loops: dict[str, np.ndarray] = field(default_factory=dict)  # a garment's open loops as vertex cycles
    modes: np.ndarray | None = None  # (M,n,3) principal modes of the unposed shape, of one standard deviation each [m]


def unposed(run: Run, surface: RegisteredSurface, skin_idx, skin_val, row: int) -> np.ndarray:
    """The vertices (n,3) of a surface of the run in a row, unposed by skinning weights `skin_val` of joints `skin_idx`
    (n,B) [m]."""
    pose = run.pose.rotations[row], run.pose.translation[row]
    J = run.rest_joints
    A, b = blended_transforms(J, *run.body_model.joint_transforms(J, *pose), skin_idx, skin_val)
    return unblended(surface.vertices[row], A, b)


def shapes(run: Run, surface: RegisteredSurface, skin_idx, skin_val, frames, modes: int):
    """Over frames, of the unposed vertices of a surface: the mean (n,3) and at most `modes` principal modes (M,n,3)."""
    total, kept, rows = 0.0, [], run.rows(frames)
    if len(rows) == 0:
        raise UserError(f"{run.path}: none of the frames asked for is registered")
    spread = set(evenly(range(len(rows)), SHAPES)) if modes else ()
    for i, row in enumerate(rows):
        shape = unposed(run, surface, skin_idx, skin_val, row)
        total = total + shape
        if i in spread:
            kept.append(shape.astype(np.float32))
    mean = total / len(rows)
    return mean, principal_modes(np.array(kept) - mean, modes) if modes else None


def principal_modes(displacements, count):
    """At most `count` modes (M,n,3) of displacements (F,n,3) from their mean: orthogonal, strongest first, each as long as its
    standard deviation over the frames, positive in the frame that shows most of it. Modes of less than a ten-thousandth of
    the first's variance are left out."""
    flat = displacements.reshape(len(displacements), -1).astype(np.float64)
    variance, U = np.linalg.eigh(flat @ flat.T / len(flat))  # of frames by frames: the vertices are many more
    variance, U = variance[::-1][:count], U[:, ::-1][:, :count]
    U = U[:, variance > max(1e-4 * variance[0], 1e-12)]
    U = U * np.sign(U[np.abs(U).argmax(0), np.arange(U.shape[1])])  # an eigenvector's sign is nobody's choice
    return (U.T @ flat / len(flat) ** 0.5).reshape(-1, *displacements.shape[1:]).astype(np.float32)


def read_layers(run: Run, frames=None, modes: int = 0) -> list[Layer]:
    """The layers of a run, inner to outer: the body, then each garment. `rest` is the mean over `frames` (all registered
    ones by default), and garments get `modes` principal modes. A run without garments has its tracked surface as the body."""
    garments = [_garment_layer(run, garment, frames, modes) for garment in run.garments.values()]
    return [_body_layer(run, run.body, "body", "body", frames, 0), *garments]


def surface_layer(run: Run, frames=None, modes: int = 0) -> Layer:
    """The tracked, clothed surface as one layer: the baseline's."""
    return _body_layer(run, run.track, "surface", "surface", frames, modes)


def registered_surface(run: Run, layer: Layer) -> RegisteredSurface:
    """The surface of the run that a layer was made of."""
    if layer.kind == "garment":
        return run.garments[layer.name]
    return run.body if layer.kind == "body" else run.track


def _body_layer(run, surface, name, kind, frames, modes):
    model = run.body_model
    if model.uv is None:
        raise UserError(f"{run.body_model_name}: uv: the body model has none, an avatar needs them")
    skin = model.weights_idx, model.weights_val
    if surface.confidence.shape[1] != len(model.v_template) or not np.array_equal(surface.faces, model.f):
        raise UserError(f"{run.path}: {surface.name}/faces: not those of the body model")
    rest, found = shapes(run, surface, *skin, frames, modes)
    return Layer(name, kind, rest, model.f, model.uv, model.f_uv, *skin, label=-1, modes=found)


def _garment_layer(run, garment, frames, modes):
    weights, faces, uv, face_uv, at = garment.skin, garment.faces, garment.uv, garment.face_uv, garment.name
    n, sure = garment.vertices.shape[1], garment.confidence.shape[1]
    fits = len(weights) == n == sure and faces.shape == face_uv.shape and weights.shape[1] == len(run.rest_joints)
    if not fits or faces.min() < 0 or faces.max() >= n or face_uv.min() < 0 or face_uv.max() >= len(uv):
        raise UserError(f"{run.path}: garment {at}: faces, UVs, skin and vertices do not fit one another")
    if not (np.isfinite(uv).all() and uv.min() >= 0 and uv.max() <= 1):
        raise UserError(f"{run.path}: garment {at}: uv leaves the unit square")
    idx = np.argsort(-weights, axis=1, kind="stable")[:, :BLEND].astype(np.int32)
    val = np.take_along_axis(weights, idx.astype(np.int64), 1).astype(np.float64)
    val /= val.sum(1, keepdims=True)
    rest, found = shapes(run, garment, idx, val, frames, modes)
    return Layer(at, "garment", rest, faces, uv, face_uv, idx, val, garment.label, garment.loops, found)
