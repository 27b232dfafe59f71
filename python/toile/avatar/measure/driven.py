"""Held-out frames driven by poses and facial keypoints alone: of a frame no code, no texture and no pixel is used.

Garments by the temporal model's codes, or as cloth that hangs (docs/method/drape.md), then out of the body; the single-layer baseline by
codes drawn from the unit Gaussian, one a sequence, as Bagautdinov et al. 2021 animate theirs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...kernels import self_intersections
from ...measure.truth import second_difference
from ..drive.cloths import LEAD
from ..drive.draping import Draping, load_cloths
from ..drive.driver import load_driver, run_track, stride_of
from ..drive.layering import GarmentLayering
from .heldout import VIEW, HeldOut

SAMPLES = 4  # codes drawn for the baseline; the first is the one shown
COMPARED = 3  # every which picture is drawn with the others too


class Driven(HeldOut):
    """HeldOut's avatars by what drives them; "baseline 1" ... are other draws of its code, "baseline 0" the code zero."""

    def __init__(self, folder, frames=None, run=None, physics=False):
        super().__init__(folder, frames, run)
        run = self.registered.run
        self.span = [n for n in run.ok if self.frames[0] <= n <= self.frames[-1]]
        self.led = [n for n in run.ok if n < self.frames[0]][-LEAD:] if physics else []
        self.latents, self.driver, self.measured, self.draping = {}, None, {}, None
        self.intersections = {}  # by frame: pairs before and after untangling
        if "layered" in self.avatars:
            avatar = self.avatars["layered"]
            self.layering = GarmentLayering(avatar.layers, self.registered.run.body_model.skin_faces)
            self.latents["layered"] = self._garment_codes(folder, avatar)
            if physics:
                self.draping = self._draping(load_cloths(folder, avatar.layers))
        if "baseline" in self.avatars:
            self._draw_codes(self.avatars["baseline"])

    def _garment_codes(self, folder, avatar):
        """{frame: {garment: (1,Z)}} from the poses up to each frame, those between the pictured ones included."""
        if not any(layer.kind == "garment" for layer in avatar.layers) or avatar.settings.data.window:
            return {n: {} for n in self.led + self.span}
        self.driver, stride, self.measured = load_driver(folder)
        track = run_track(avatar, self.registered.run, stride)
        with torch.no_grad():
            codes = {name: z.to(self.device) for name, z in self.driver.latents(track).items()}
        at = {n: i for i, n in enumerate(track.frames.tolist())}
        return {n: {name: z[at[n]][None] for name, z in codes.items()} for n in self.led + self.span}

    def _draping(self, cloths):
        """Cloth of the layered avatar over the span, begun some frames before it."""
        frames = self.led + self.span
        times = np.array(frames) / self.registered.run.scene.fps
        return Draping(
            self.avatars["layered"], cloths, self.layering, times, lambda k: self._posed("layered", frames[k])
        )

    def _posed(self, name, frame):
        """{layer: Decoded} of a frame by its codes alone, without textures."""
        batch = self._steered(frame) | {"T_camera_world": torch.eye(4, device=self.device)[None]}
        return self.avatars[self.shown[name]].decode(batch, self.latents[name][frame], texture=False)

    def _draw_codes(self, avatar):
        surface = avatar.layers[0].name
        size = avatar.model(surface).code_size
        drawn = [torch.randn(1, size, generator=torch.Generator().manual_seed(seed)) for seed in range(SAMPLES)]
        names = ["baseline", *(f"baseline {seed}" for seed in range(1, SAMPLES)), "baseline 0"]
        for name, z in zip(names, [*drawn, torch.zeros(1, size)]):
            self.shown[name] = "baseline"
            self.decoded.setdefault(name, {})
            self.latents[name] = dict.fromkeys(self.span, {surface: z.to(self.device)})

    def shown_in(self, i):
        return self.shown if i % COMPARED == 0 else {name: name for name in self.avatars}

    def _decode(self, name, sample):
        frame = int(sample["frame"])
        batch = self._steered(frame) | {key: sample[key][None].to(self.device) for key in VIEW}
        decoded = self.avatars[self.shown[name]].decode(batch, self.latents[name][frame])
        placed = self._placed(name, frame)
        return {
            layer: replace(one, vertices=torch.as_tensor(placed[layer], dtype=torch.float32, device=self.device)[None])
            for layer, one in decoded.items()
        }

    def _steered(self, frame):
        """Pose and face of a registered frame as `Avatar.decode` takes them."""
        run = self.registered.run
        face = np.zeros((0, 3)) if run.face is None else run.face.at(frame)
        rotations, translation = run.pose.at(frame)
        values = {
            "rotations": rotations, "translation": translation,
            "face": np.nan_to_num(face), "face_seen": np.isfinite(face).all(-1),
        }  # fmt: skip
        batch = {name: torch.as_tensor(value.astype(np.float32)) for name, value in values.items()}
        batch |= next(iter(self.data.values())).pose_window(frame)
        return {name: value[None].to(self.device) for name, value in batch.items()}

    @torch.no_grad()
    def _placed(self, name, frame):
        """{layer: vertices (n,3)}, garments out of the body."""
        if frame not in self.decoded[name]:
            decoded = self._posed(name, frame)
            if name == "layered":
                if self.draping:
                    row = (self.led + self.span).index(frame)
                    decoded = self.draping.at(row, decoded, self._steered(frame))
                decoded, *self.intersections[frame] = self.layering(decoded)
            self._keep(name, frame, decoded)
        return self.decoded[name][frame]

    def summary(self, errors):
        """What evaluation says beside its usual measures."""
        common = set.intersection(*(set(errors.pictures[name]) for name in self.shown))
        draws = {name: errors.measures(name, pictures=common) for name, of in self.shown.items() if of == "baseline"}
        return {
            "temporal": self.driver
            and {"model": self.driver.settings.model, "window": self.driver.settings.window} | self.measured,
            "motion": self._motion(),
            "intersections": self._intersections(),
            "physics": self.draping and {"strain": self.draping.strain, "self_pairs": self._self_pairs()},
            "baseline_draws": draws and _draw_errors(draws, errors.measures("layered", pictures=common)),
        }

    def _motion(self):
        """{garment: acceleration_mm decoded, true_acceleration_mm, jitter_mm of the error}: mean lengths of second differences
        over consecutive registered frames of the span [mm a frame^2]; true ones None without truth."""
        if "layered" not in self.avatars:
            return {}
        found, truth, step = {}, self.registered.truth, stride_of(self.span) or 1
        for garment in self.registered.garment_labels:
            shown = {n: self._placed("layered", n)[garment] for n in self.span}
            true = (
                {n: truth.places(garment, n) for n in shown if n in truth}
                if truth and self.registered.mapped[garment]
                else {}
            )
            found[garment] = {
                "acceleration_mm": second_difference(shown, step),
                "true_acceleration_mm": second_difference(true, step),
                "jitter_mm": second_difference({n: shown[n] - true[n] for n in true}, step),
            }
        return found

    def _self_pairs(self):
        """{garment: pairs of its own triangles that intersect}, mean over the span: cloth does not meet itself."""
        faces = {layer.name: layer.faces for layer in self.layering.garments}
        placed = [self._placed("layered", n) for n in self.span]
        return {
            name: float(np.mean([len(self_intersections(V[name], F)) for V in placed])) for name, F in faces.items()
        }

    def _intersections(self):
        """Triangle pairs of garments and what lies under them, over the span."""
        if not self.intersections:
            return None
        before, left = np.sum(list(self.intersections.values()), axis=0)
        return {"before": int(before), "left": int(left), "frames": len(self.intersections)}


def _draw_errors(draws, layered):
    """Errors of the baseline over draws of its code, over the pictures that show all; "zero" is the Gaussian's mean, which no
    sample is."""
    sampled = [found for name, found in draws.items() if name != "baseline 0"]
    return {
        "mse": [found["mse"] for found in sampled],
        "mse_mean": float(np.mean([found["mse"] for found in sampled])),
        "ssim_mean": float(np.mean([found["ssim"] for found in sampled])),
        "zero_mse": draws["baseline 0"]["mse"],
        "zero_ssim": draws["baseline 0"]["ssim"],
        "layered_mse": layered["mse"],
    }
