"""An avatar in the poses of its training or of a motion, with joints turned further. `toile view` shows it."""

from __future__ import annotations

import tempfile
import threading
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from ...errors import UserError
from ...io.export.clip import Clip, ClipLayer
from ...io.image import write_image
from ...io.motion import Motion
from ...io.retargeting import stance_of_model
from ..model.assets import training_poses
from .animate import DrivenAvatar

KEPT = 64  # poses whose vertices are kept
FPS = 30.0  # at which training poses are played
# joints by role, and the axis of their turn: across to the left (a), backwards (b), up (u), as a body at rest stands
TURNS = {
    "left arm up": ("upperarm01.L", "-b"), "right arm up": ("upperarm01.R", "b"),
    "left arm forward": ("upperarm01.L", "-u"), "right arm forward": ("upperarm01.R", "u"),
    "left elbow": ("lowerarm01.L", "-u"), "right elbow": ("lowerarm01.R", "u"),
    "left leg forward": ("upperleg01.L", "-a"), "right leg forward": ("upperleg01.R", "-a"),
    "left leg aside": ("upperleg01.L", "-b"), "right leg aside": ("upperleg01.R", "b"),
    "left knee": ("lowerleg01.L", "a"), "right knee": ("lowerleg01.R", "a"),
    "trunk forward": ("spine02", "a"), "trunk turned": ("spine02", "u"), "head turned": ("head", "u"),
}  # fmt: skip


class PosedAvatar:
    """An avatar trained with --temporal: `clip`, whose frames are those of `motion` (the path of a run, a BVH or an .npz) or,
    without one, count its training poses; and `turns`, names of what can be turned. `garments`, `apart`: as DrivenAvatar takes them. Threads may ask at
    once."""

    def __init__(self, folder, motion=None, garments=(), apart=True):
        if motion is None:
            poses = training_poses(folder)
            numbers = np.arange(len(poses["rotations"]))
            motion_of = Motion(numbers, poses["rotations"], poses["translation"], None, FPS)
            self.driven = DrivenAvatar(folder, motion_of, garments=garments)
        else:
            self.driven = DrivenAvatar(folder, motion, garments=garments, apart=apart)
        self.motion, self.warnings = self.driven.motion, self.driven.warnings
        self.flowing = None if motion is None else self.driven.latents  # of garments that follow the motion over time
        self.model, avatar = self.driven.model, self.driven.avatar
        self.turns = [name for name, (role, _) in TURNS.items() if self.model.joint(role) is not None]
        self.folder = tempfile.TemporaryDirectory(prefix="toile-")  # of the textures; gone with this object
        self.kept, self.lock = OrderedDict(), threading.Lock()
        self.row = {int(number): i for i, number in enumerate(self.motion.frames)}
        layers = tuple(self._layer(layer) for layer in avatar.layers)
        self.clip = Clip(Path(folder).name, self.motion.fps, avatar.scene.up, tuple(sorted(self.row)), layers)

    def _layer(self, layer):
        texture = Path(self.folder.name) / f"{layer.name}.png"
        mean = self.driven.avatar.model(layer.name).mean_texture.permute(1, 2, 0)
        write_image(texture, (mean.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy())
        at = lambda frame: self.vertices(frame, {})[layer.name]
        return ClipLayer(layer.name, layer.faces, at, layer.uv, layer.face_uv, texture=texture)

    def vertices(self, frame, turns):
        """{layer: (n,3)} [m] of a frame with `turns` {name: angle [rad]} added, garments out of the body."""
        key = frame, tuple(sorted(turns.items()))
        with self.lock:
            if key not in self.kept:
                self.kept[key] = self._decoded(frame, turns)
                while len(self.kept) > KEPT:
                    self.kept.popitem(last=False)
            return self.kept[key]

    @torch.no_grad()
    def _decoded(self, frame, turns):
        driven, motion, row = self.driven, self.motion, self.row[frame]
        if self.flowing is not None and not turns:
            driven.motion, driven.latents = motion, self.flowing
        else:  # held for ever
            rotations, translation = self.turned(motion.rotations[row], turns)[None], motion.translation[[row]]
            face = None if motion.face is None else motion.face[[row]]
            driven.hold(replace(motion, frames=np.array([0]), rotations=rotations, translation=translation, face=face))
            row = 0
        latents = {name: z[row : row + 1].to(driven.device) for name, z in driven.latents.items()}
        batch = driven.batch(row, driven.avatar.cameras[0])
        decoded, _, _ = driven.layering(driven.decoded(batch, latents, texture=False), batch)
        return {name: layer.vertices[0].double().cpu().numpy() for name, layer in decoded.items()}

    def turned(self, rotations, turns):
        """Rotations (K,3) with joints turned about the axes of their parents at rest."""
        avatar = self.driven.avatar
        axes = dict(zip("abu", stance_of_model(self.model, avatar.skeleton.J.cpu().numpy(), avatar.scene.up[-1]).T))
        rotations = np.array(rotations)
        for name, angle in turns.items():
            if name not in self.turns:
                raise UserError(f"'{name}': there are {', '.join(self.turns)}")
            role, axis = TURNS[name]
            k, sign = self.model.joint(role), -1 if axis[0] == "-" else 1
            more = Rotation.from_rotvec(sign * angle * axes[axis[-1]])
            rotations[k] = (more * Rotation.from_rotvec(rotations[k])).as_rotvec()
        return rotations
