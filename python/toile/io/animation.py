"""What `toile animate` leaves: meshes/LAYER/NUMBER.ply, layers/LAYER.npz, skeleton.npz, textures/LAYER.png, animation.json.

animation.json is written last.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats
from .bounded import read_json
from .export.clip import Clip, ClipLayer, ClipSkeleton
from .files import load_record
from .mesh import read_mesh

FACTS = "animation.json"
NAME = "[A-Za-z0-9_-]+"  # of a layer


@dataclass(frozen=True)
class AnimatedLayer:
    """What of a layer does not move."""

    faces: Anything  # (m,3)
    uv: Anything  # (t,2) v up
    face_uv: Anything  # (m,3)
    joints: Anything  # (n,B)
    weights: Anything  # (n,B) rows sum to 1


@dataclass(frozen=True)
class AnimatedSkeleton:
    """Joints and their motion."""

    joint_names: tuple[str, ...]
    parents: Anything  # (K,)
    J: Anything  # (K,3) [m]
    frames: Anything  # (T,)
    rotations: Anything  # (T,K,3) [rad]
    translation: Anything  # (T,3) [m]
    fps: float
    up: str


def layer_file(folder: Path, name: str) -> Path:
    """Where the AnimatedLayer of a layer lies."""
    return folder / "layers" / f"{name}.npz"


def mesh_file(folder: Path, name: str, frame: int) -> Path:
    """Where a layer of a frame lies."""
    return folder / "meshes" / name / f"{frame:06d}.ply"


def picture_file(folder: Path, frame: int) -> Path:
    """Where the picture of a frame lies."""
    return folder / "pictures" / f"{frame:06d}.png"


def texture_file(folder: Path, name: str) -> Path:
    """Where a layer's texture lies."""
    return folder / "textures" / f"{name}.png"


def skeleton_file(folder: Path) -> Path:
    """Where the AnimatedSkeleton lies."""
    return folder / "skeleton.npz"


def is_animation(path: Path | str) -> bool:
    """Does the folder hold what `toile animate` leaves?"""
    return (Path(path) / FACTS).exists()


def open_animation(path: Path | str) -> Clip:
    """The clip of an animation, its frames read when asked for."""
    folder = Path(path)
    facts: dict[str, Any] = read_json(folder / FACTS, dict)
    if not (folder / "meshes").is_dir():
        raise UserError(f"{folder}/meshes: missing: the animation was made with --no-meshes")
    if not skeleton_file(folder).exists():
        raise UserError(f"{skeleton_file(folder)}: missing: the animation is of an older version, animate it again")
    skeleton = load_record(skeleton_file(folder), AnimatedSkeleton)
    row = {int(number): i for i, number in enumerate(skeleton.frames)}

    def pose(frame: int) -> tuple[Floats, Floats]:
        return skeleton.rotations[row[frame]], skeleton.translation[row[frame]]

    # layers in the order in which the avatar has them: from the body outwards
    names = facts.get("layers")
    if not isinstance(names, list) or not all(isinstance(n, str) and re.fullmatch(NAME, n) for n in names):
        raise UserError(f"{folder / FACTS}: layers: expected names")
    layers = tuple(_layer(folder, name) for name in names)
    joints = ClipSkeleton(tuple(skeleton.joint_names), tuple(np.asarray(skeleton.parents).tolist()), skeleton.J, pose)
    return Clip(folder.resolve().name, float(skeleton.fps), str(skeleton.up), tuple(sorted(row)), layers, joints)


def _layer(folder: Path, name: str) -> ClipLayer:
    still, texture = load_record(layer_file(folder, name), AnimatedLayer), texture_file(folder, name)

    def at(frame: int) -> Floats:
        mesh = read_mesh(mesh_file(folder, name, frame))
        if not np.array_equal(mesh.faces, still.faces):
            raise UserError(f"{mesh_file(folder, name, frame)}: its faces are not those of {layer_file(folder, name)}")
        return np.asarray(mesh.vertices, np.float64)

    there = texture if texture.exists() else None
    return ClipLayer(name, still.faces, at, still.uv, still.face_uv, still.joints, still.weights, there)
