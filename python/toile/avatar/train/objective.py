"""What a phase minimises: the terms of docs/method/avatars.md on a batch of (frame, camera) samples."""

from __future__ import annotations

import torch
from torch.utils.data import default_collate

from ...frame_numbers import evenly
from ..model.layer_model import Decoded
from . import losses

GUESSED = 0.1  # weight of a vertex of confidence 0: what nothing has seen is still held where the registration put it
OCCLUSION_SAMPLES = 16  # spread over the training frames, whose mean ambient occlusion shadows are relative to


class Objective(torch.nn.Module):
    """The avatar with its losses, all of them in float32; `half`: its networks are multiplied in bfloat16."""

    def __init__(self, avatar, settings, half=False):
        super().__init__()
        self.avatar, self.settings, self.half = avatar, settings, half
        self.kinds = {layer.name: layer.kind for layer in avatar.layers}
        self.labels = {layer.name: layer.label for layer in avatar.layers}
        self.open_sky = {}  # {frame: {layer: (n,)}}

    @torch.no_grad()
    def prepare(self, data, to_device):
        """Sets what networks' inputs are relative to, before the first step: of ambient occlusion, and of windows of poses."""
        rows = evenly(range(len(data)), OCCLUSION_SAMPLES)
        found = [self.occlusion(to_device(default_collate([data[row]]))) for row in rows]
        self.avatar.fit_projection(data)
        self.avatar.set_mean_ao({name: torch.cat([one[name] for one in found]).mean(0) for name in self.kinds})

    @torch.no_grad()
    def occlusion(self, batch):
        """{layer: (B,n)} openness of each vertex amid the registered layers. Those that are decoded lie near them, and theirs
        would cost a third of each step; these are found once a frame."""
        for b, frame in enumerate(batch["frame"].tolist()):
            if frame not in self.open_sky:
                posed = {name: batch[f"vertices.{name}"][b : b + 1] for name in self.kinds}
                found = self.avatar.ambient_occlusion({name: Decoded(v, v) for name, v in posed.items()})
                self.open_sky[frame] = {name: values[0].cpu() for name, values in found.items()}
        frames, device = [self.open_sky[frame] for frame in batch["frame"].tolist()], batch["frame"].device
        return {name: torch.stack([frame[name] for frame in frames]).to(device) for name in self.kinds}

    def forward(self, batch, phase, share):
        """{term: value} of a phase; `share` of it that is over, 0 to 1, anneals c."""
        with torch.autocast(batch["image"].device.type, torch.bfloat16, enabled=self.half):
            return self._terms(batch, phase, share)

    def _terms(self, batch, phase, share):
        avatar, names = self.avatar, [name for name, kind in self.kinds.items() if kind in phase.kinds]
        batch = avatar.with_unposed(batch, names)
        codes = avatar.encode(batch, names)
        together = "image" in phase.terms
        decoded = avatar.decode(batch, avatar.sample(codes), names)
        with torch.autocast(batch["image"].device.type, enabled=False):
            terms = self._apart(batch, decoded, phase.terms)
            if "kl" in phase.terms and codes:
                terms["kl"] = sum(losses.kl(*code) for code in codes.values())
            if together:
                terms |= self._together(batch, decoded, phase.terms, share)
        if "impute" in phase.terms and codes:
            terms["impute"] = self._impute(batch, codes, names)
        return terms

    def _apart(self, batch, decoded, asked):
        """The terms that need no picture, summed over the layers."""
        terms = {}
        for name, layer in decoded.items():
            registered = self.avatar.unposed(batch, name)
            weight = GUESSED + (1 - GUESSED) * batch[f"confidence.{name}"]
            values = {
                "geometry": lambda: losses.geometry(layer.unposed, registered, weight),
                "laplacian": lambda: losses.laplacian(self.avatar.laplacian[name], layer.unposed, registered, weight),
                "texture": lambda: losses.texture(
                    self.avatar.colour(layer.texture, batch["camera"]),
                    batch[f"texture.{name}"],
                    batch[f"texel_weight.{name}"],
                ),
            }
            for term in asked:
                if term in values:
                    terms[term] = terms.get(term, 0) + values[term]()
        return terms

    def _together(self, batch, decoded, asked, share):
        """The terms of inverse rendering, means over the batch."""
        several = len(decoded) > 1 and "visibility" in asked and self.settings.weights.visibility > 0
        if self.settings.network.shadow:
            decoded = self.avatar.shade(decoded, self.occlusion(batch))
        size = batch["image"].shape[-2:]
        rendered = self.avatar.compose(decoded, batch, size, layer_depth=several, shadow=False)
        image, mask = (torch.stack([getattr(view, part) for view in rendered]) for part in ("image", "mask"))
        terms = {
            "image": losses.image_l1(image, batch["image"], batch["mask"]),
            "mask": losses.mask_l1(mask, batch["mask"]),
        }
        if several:
            first, last = self.settings.visibility_widths
            c, labels = first + (last - first) * share, [self.labels[name] for name in decoded]
            seen = [losses.soft_visibility(view.depth, l, labels, c) for view, l in zip(rendered, batch["labels"])]
            terms["visibility"] = torch.stack(seen).mean()
        return terms

    def _impute(self, batch, codes, names):
        """The baseline's geometry under codes that are not this sample's: what the pose decides may not depend on them."""
        decoded = self.avatar.decode(batch, self.avatar.impute(codes), names, texture=False)
        with torch.autocast(batch["image"].device.type, enabled=False):
            return sum(
                losses.impute(self.avatar.anchors[name], layer.vertices, batch[f"vertices.{name}"])
                for name, layer in decoded.items()
            )

    @torch.no_grad()
    def picture(self, batch):
        """(3,H,2W) 0..1: the first sample captured, and rendered with the mean of its code."""
        avatar = self.avatar
        decoded = avatar.decode(batch, avatar.encoded(batch))
        rendered = avatar.compose(decoded, batch, batch["image"].shape[-2:])[0].image
        return torch.cat([batch["image"][0], rendered.float()], dim=-1).clamp(0, 1).cpu()
