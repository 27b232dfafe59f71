"""Clips of runs and of animations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import UserError
from ..animation import is_animation, open_animation
from ..run import RegisteredSurface, Run, open_run
from .clip import Clip, ClipLayer, ClipSkeleton, heaviest

PICTURES = (".png", ".jpg", ".jpeg")


def open_clip(path: Path | str, skeleton: bool = True) -> Clip:
    """All registered frames and all layers of a run, or all of an animation. Without `skeleton` no body model is needed,
    and the body has no UVs."""
    if is_animation(path):
        return open_animation(path)
    return clip_of_run(open_run(path), skeleton)


def clip_of_run(run: Run, skeleton: bool = True) -> Clip:
    """The tracked surface, the body and the garments of a run, and its skeleton."""
    if not run.ok:
        raise UserError(f"{run.path}: no frame is registered")
    body = [run.track] if run.inner is None else [run.track, run.inner]
    layers = [_body(run, surface, skeleton) for surface in body]
    for garment in run.garments.values():
        joints, weights = heaviest(garment.skin)
        layers.append(ClipLayer(garment.name, garment.faces, garment.at, garment.uv, garment.face_uv, joints, weights))
    joints = None
    if skeleton:
        model = run.body_model
        joints = ClipSkeleton(run.joint_names, tuple(model.parents.tolist()), run.rest_joints, run.pose.at)
    return Clip(run.scene.name, run.scene.fps, run.scene.up, tuple(sorted(run.ok)), tuple(layers), joints)


def _body(run: Run, surface: RegisteredSurface, skeleton: bool) -> ClipLayer:
    layer = ClipLayer(surface.name, surface.faces, surface.at)
    if not skeleton:
        return layer
    model = run.body_model
    if not np.array_equal(surface.faces, model.f):
        raise UserError(f"{run.path}: {surface.name}/faces: not those of the body model {run.body_model_name}")
    return replace(layer, uv=model.uv, face_uv=model.f_uv, joints=model.weights_idx, weights=model.weights_val)


def with_layers(clip: Clip, names: Sequence[str] | None) -> Clip:
    """The clip with these layers in this order; by default all but the tracked surface where there is a body under it."""
    there = {layer.name: layer for layer in clip.layers}
    if names is None:
        names = [name for name in there if name != "track" or "inner" not in there]
    for name in names:
        if name not in there:
            raise UserError(f"--layers {name}: there are {', '.join(there)}")
    return replace(clip, layers=tuple(there[name] for name in dict.fromkeys(names)))


def with_frames(clip: Clip, numbers: Iterable[int]) -> Clip:
    """The clip at these frames, rising."""
    there = set(clip.frames)
    for number in numbers:
        if number not in there:
            raise UserError(f"--frames {number}: it failed or is not in {clip.name} ({_span(clip.frames)})")
    return replace(clip, frames=tuple(sorted(set(numbers))))


def _span(frames: Sequence[int]) -> str:
    return f"{len(frames)} frames from {frames[0]} to {frames[-1]}"


def with_textures(clip: Clip, folder: Path) -> Clip:
    """The clip with the pictures LAYER.png or LAYER.jpg of a folder over its UV squares."""
    found = {p.stem: p for p in sorted(folder.iterdir()) if p.suffix.lower() in PICTURES} if folder.is_dir() else {}
    layers = [replace(layer, texture=found.get(layer.name, layer.texture)) for layer in clip.layers]
    if not any(layer.name in found for layer in layers):
        names = ", ".join(f"{layer.name}.png" for layer in layers)
        raise UserError(f"--textures {folder}: expected a folder with some of {names}")
    for layer in layers:
        if layer.texture is not None and layer.uv is None:
            raise UserError(f"--textures {folder}: {layer.name} has no UVs")
    return replace(clip, layers=tuple(layers))
