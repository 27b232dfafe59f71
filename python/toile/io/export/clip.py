"""What is handed on: layers of fixed topology over time, and the skeleton that they hang on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...frame_numbers import evenly
from ...kernels.arrays import Anything, Floats
from ...kinematics import blend_skinning, blended_transforms, joint_transforms, unblended

TO_Y_UP = {  # rotations (3,3) that take this axis upwards to y upwards
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
SPREAD = 20  # frames that a rest surface is taken of
INFLUENCES = 11  # joints that move a vertex, at most: as many as a garment's vertices have

Vertices = Callable[[int], Floats]  # a frame's number -> (n,3) [m]
Pose = Callable[[int], tuple[Floats, Floats]]  # a frame's number -> rotations (K,3) [rad], translation (3,) [m]


@dataclass(frozen=True)
class ClipSkeleton:
    """Joints whose axes are the world's at rest: R_k = R_parent exp(r_k)."""

    names: tuple[str, ...]
    parents: tuple[int, ...]  # -1 for the root, which is the first
    J: Anything  # (K,3) rest joints [m]
    pose: Pose

    @property
    def offsets(self) -> Floats:
        """Rest joints (K,3) relative to their parents; the root's is its place."""
        J = np.asarray(self.J, np.float64)
        return np.array([J[k] - (J[p] if p >= 0 else 0) for k, p in enumerate(self.parents)])

    def posed(self, frame: int) -> tuple[Floats, Floats]:
        """World rotations (K,3,3) and joint positions (K,3)."""
        return joint_transforms(self.parents, self.J, *self.pose(frame))


@dataclass(frozen=True)
class ClipLayer:
    """One surface; UVs have a topology of their own, v up. `joints` and `weights` (n,B) where the skeleton moves it."""

    name: str
    faces: Anything  # (m,3) int32
    at: Vertices
    uv: Anything | None = None  # (t,2)
    face_uv: Anything | None = None  # (m,3)
    joints: Anything | None = None
    weights: Anything | None = None
    texture: Path | None = None  # a picture over the UV square


@dataclass(frozen=True)
class Clip:
    """Layers and skeleton at the numbers `frames`, which rise and may have gaps: number / fps is a frame's time [s]."""

    name: str
    fps: float
    up: str
    frames: tuple[int, ...]
    layers: tuple[ClipLayer, ...]
    skeleton: ClipSkeleton | None = None

    @property
    def skinned(self) -> bool:
        """Has a skeleton, and it moves all layers."""
        return self.skeleton is not None and all(layer.joints is not None for layer in self.layers)

    def with_y_up(self) -> Clip:
        """The same clip turned until y is up."""
        M = TO_Y_UP[self.up]
        layers = tuple(replace(layer, at=_turned(layer.at, M)) for layer in self.layers)
        skeleton = self.skeleton
        if skeleton is not None:
            skeleton = replace(skeleton, J=skeleton.J @ M.T, pose=_turned_pose(skeleton.pose, M))
        return replace(self, up="y", layers=layers, skeleton=skeleton)


def _turned(at: Vertices, M: Floats) -> Vertices:
    return lambda frame: at(frame) @ M.T


def _turned_pose(pose: Pose, M: Floats) -> Pose:
    def turned(frame: int) -> tuple[Floats, Floats]:
        rotations, translation = pose(frame)
        return rotations @ M.T, M @ translation

    return turned


def heaviest(weights: Anything, count: int = INFLUENCES) -> tuple[Anything, Floats]:
    """Joints and weights (n,count), heaviest first, of weights (n,K); rows sum to 1."""
    count = min(count, weights.shape[1])
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :count].astype(np.int32)
    kept = np.take_along_axis(weights, joints.astype(np.int64), 1).astype(np.float64)
    return np.where(kept > 0, joints, 0), kept / kept.sum(1, keepdims=True)


def fewer(layer: ClipLayer, count: int) -> ClipLayer:
    """The layer with at most `count` joints a vertex."""
    if layer.joints is None or layer.weights is None:
        return layer
    order = np.argsort(-layer.weights, axis=1, kind="stable")[:, :count]
    joints, weights = (np.take_along_axis(a, order, 1) for a in (layer.joints, layer.weights))
    return replace(layer, joints=joints, weights=weights / weights.sum(1, keepdims=True))


def rest_surface(clip: Clip, layer: ClipLayer) -> tuple[Floats, Floats]:
    """The layer at rest (n,3): the mean over frames spread evenly, unskinned; and how far skinning it lies from the layer
    (f,n) [m] in these frames."""
    skeleton, joints, weights = clip.skeleton, layer.joints, layer.weights
    assert skeleton is not None and joints is not None and weights is not None
    J, frames = np.asarray(skeleton.J), evenly(clip.frames, SPREAD)
    rest: Floats = np.zeros(0)
    for i, frame in enumerate(frames):
        unskinned = unblended(layer.at(frame), *blended_transforms(J, *skeleton.posed(frame), joints, weights))
        rest = unskinned if i == 0 else rest + (unskinned - rest) / (i + 1)
    skinned = (blend_skinning(rest, J, *skeleton.posed(frame), joints, weights) for frame in frames)
    off = [np.linalg.norm(V - layer.at(frame), axis=1) for V, frame in zip(skinned, frames)]
    return rest, np.array(off)
