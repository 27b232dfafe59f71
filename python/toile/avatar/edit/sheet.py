"""How an edit keeps to its garment: layered and baseline beside each other in frames of the run, and how far the edited
region's border lies from the garment's.

The garment's border is that of its labels (the truth's where there is one) with the rest of the foreground; the edited
region's is what an avatar shows as the garment, the baseline what was marked on it. Both avatars encode the frame itself;
garments are moved out of what lies under them, as an animation does.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch.utils.data import default_collate

from ...frame_numbers import evenly
from ...io.files import called
from ...io.image import write_image
from ..drive.layering import GarmentLayering
from ..measure.heldout import CROP, SAMPLES, HeldOut
from ..measure.sheet import GAP, PAPER, TILE, text_line, tiles
from ..model.checkpoint import read_facts
from ..render.renderer import Surface, render

MEASURED, SHOWN = 8, 4  # frames
FAR = 0.95  # share of the border that keeps within the larger of the distances stated
ABOUT = 0.15  # about the garment in a tile, a share of its size
TITLES = {"layered": "layered", "baseline": "single layer"}


@dataclass
class BorderErrors:
    """Distances of the borders, and pixels of region and garment, added over pictures."""

    distances: list = field(default_factory=list)  # arrays [mm]
    wrong: int = 0
    garment: int = 0

    def add(self, other):
        self.distances += other.distances
        self.wrong += other.wrong
        self.garment += other.garment
        return self

    def measures(self):
        """border_mm: from either border to the other, the mean; border95_mm: 95 % of it keeps within; area_share: pixels in
        one of the two regions alone over the garment's. None where no picture has both borders, or the garment."""
        far = np.concatenate(self.distances) if self.distances else np.zeros(0)
        return {
            "border_mm": float(far.mean()) if len(far) else None,
            "border95_mm": float(np.quantile(far, FAR)) if len(far) else None,
            "area_share": self.wrong / self.garment if self.garment else None,
        }


def compare(folder, source, layer, made, marked, frames, run, progress=lambda *_: None):
    """Measures and draws FOLDER/edit.png of an avatar just edited: {"frames", "labels", "mm_per_pixel", "layered",
    "baseline": measures or None, "per_frame"}. `source`: the avatar that was edited, which errors name; `made`: the garment's
    Edit; `marked`: the baseline's; `frames`: numbers, by default a spread of all that have pictures."""
    facts = read_facts(folder)
    known = sorted({*facts["frames"], *facts["holdout"]})
    asked = known if frames is None else list(frames)
    with called(folder, source):
        held = HeldOut(folder, evenly(asked, MEASURED) if frames is None else asked, run)
    shows = ShownGarment(held, layer, made, marked)
    found = {}  # (frame, camera): {avatar: BorderErrors}
    for i in range(held.count):
        found[shows.data.samples[i]] = shows.off(i)
        progress("compare", i + 1, held.count)
    per_frame = []
    for number in held.frames:
        views = [found[shows.data.samples[i]] for i in shows.data.rows_of(number)]
        off = {name: total(view[name] for view in views).measures() for name in held.avatars}
        per_frame.append({"frame": number} | off)
    everything = {name: None for name in TITLES}
    everything |= {name: total(off[name] for off in found.values()).measures() for name in held.avatars}
    camera = shows.data.samples[max(shows.data.rows_of(held.frames[0]), key=shows.visible)][1]
    chosen = evenly(range(len(held.frames)), SHOWN)
    pictures = [(per_frame[f], *shows.pictures(shows.picture_of(held.frames[f], camera))) for f in chosen]
    image = sheet(pictures, shows.camera_name(camera))
    write_image(folder / "edit.png", image)
    for cache in (folder / "evaluation", folder / "baseline" / "evaluation"):
        shutil.rmtree(cache, ignore_errors=True)
    labels = {"labels": "truth" if held.truth else "captured", "mm_per_pixel": float(np.mean(shows.spacing))}
    return {"frames": held.frames} | labels | everything | {"per_frame": per_frame}


def total(offs):
    out = BorderErrors()
    for off in offs:
        out.add(off)
    return out


class ShownGarment:
    """What the edited avatars of a HeldOut show of a garment."""

    def __init__(self, held, layer, made, marked):
        self.held, self.label = held, layer.label
        self.first = next(iter(held.data))
        self.data = held.data[self.first]
        self.spacing = []  # of the pixels at the person [mm]
        skin = held.registered.run.body_model.skin_faces
        self.layering = {name: GarmentLayering(avatar, skin) for name, avatar in held.avatars.items()}
        self.vertices = {}  # by avatar and frame, {layer: (1,n,3)}
        self.cover = {layer.name: torch.as_tensor(made.cover[None] / np.float32(255))}
        self.region = {"layered": {layer.name: torch.ones(1, 2, 2)}}
        if marked is not None:
            (surface,) = held.data["baseline"].layers
            self.region["baseline"] = {surface.name: torch.as_tensor(marked.region[None].astype(np.float32))}

    def camera_name(self, camera):
        return self.data.cameras[camera].name

    def picture_of(self, number, camera):
        """The sample of a frame from this camera, from the first that has a picture of it where this has none."""
        rows = self.data.rows_of(number)
        return next((i for i in rows if self.data.samples[i][1] == camera), rows[0])

    def visible(self, i):
        """How much of the edit picture i shows [px]."""
        size = self.data[i]["mask"].shape
        return float(self._drawn("layered", i, self.cover, size)[0].sum())

    def off(self, i):
        """{avatar: BorderErrors} of picture i."""
        sample, garment, person = self._labelled(i)
        T = sample["T_camera_world"].numpy().astype(np.float64)
        body = next(v for key, v in sample.items() if key.startswith("vertices.")).numpy()
        mm = 1e3 * float(np.median(body @ T[2, :3] + T[2, 3])) / float(sample["K"][0, 0])
        self.spacing.append(mm)
        out = {}
        for name in self.held.avatars:
            shown, drawn = (x > 0.5 for x in self._drawn(name, i, self.region[name], person.shape))
            both = person & drawn
            region, there = shown & both, garment & both
            out[name] = BorderErrors(
                [mm * border_distances(region, there, both)], int((region ^ there).sum()), int(there.sum())
            )
        return out

    def _labelled(self, i):
        """Sample i and the pixels (H,W) bool that are labelled as the garment, and as the person."""
        sample = self.data[i]
        K, T = (sample[key].numpy().astype(np.float64) for key in ("K", "T_camera_world"))
        labels = self.held.registered.labels(int(sample["frame"]), K, T, sample["labels"].numpy())
        person = (labels > 0) & (sample["mask"].numpy() > 0.5)
        return sample, (labels == self.label) & person, person

    def _decoded(self, name, i, texture):
        """(avatar, batch, {layer: Decoded}) of picture i, garments out of what lies under them."""
        first, data, avatar = self.data[i], self.held.data[name], self.held.avatars[name]
        sample = data[i] | {key: first[key] for key in CROP}
        batch = {key: value.to(self.held.device) for key, value in default_collate([sample]).items()}
        decoded = avatar.decode(batch, avatar.encoded(batch), texture=texture)
        key = name, int(sample["frame"])
        if key not in self.vertices:  # no camera changes the geometry
            self.vertices[key] = {layer: one.vertices for layer, one in self.layering[name](decoded, batch)[0].items()}
        return (
            avatar,
            batch,
            {layer: replace(one, vertices=self.vertices[key][layer]) for layer, one in decoded.items()},
        )

    @torch.no_grad()
    def _drawn(self, name, i, maps, size):
        """Maps {layer: (1,S,S)}, 0 on other layers, as picture i of an avatar shows them, and where it shows anything: (H,W)."""
        avatar, batch, decoded = self._decoded(name, i, texture=False)
        surfaces = []
        for layer, one in decoded.items():
            m, texture = avatar.model(layer), maps.get(layer, torch.zeros(1, 2, 2)).to(self.held.device)
            surfaces.append(Surface(one.vertices[0], m.faces, m.uv, m.face_uv, texture))
        seen = render(surfaces, batch["K"][0], batch["T_camera_world"][0], size)
        return seen.image[0].cpu().numpy(), seen.mask.cpu().numpy()

    @torch.no_grad()
    def pictures(self, i):
        """{title: (H,W,3) uint8}, captured and each avatar's, about as large as a tile wants them; and the box (left, top,
        right, bottom) of the garment."""
        from PIL import Image

        sample, garment, _ = self._labelled(i)
        box = box_of(garment)
        zoom = max(1, round(TILE / max(box[2] - box[0], box[3] - box[1])))
        height, width = (zoom * side for side in garment.shape)
        person = sample["mask"].numpy()[..., None] > 0.5
        captured = np.where(person, sample["image"].numpy().transpose(1, 2, 0), PAPER / 255)
        captured = Image.fromarray((captured * 255).round().astype(np.uint8))
        out = {"captured": np.array(captured.resize((width, height), Image.Resampling.BICUBIC))}
        for name in self.held.avatars:
            avatar, batch, decoded = self._decoded(name, i, texture=True)
            closer = batch["K"].new_tensor([zoom, zoom, 1.0])[:, None]
            seen = avatar.compose(decoded, batch | {"K": closer * batch["K"]}, (height, width), samples=SAMPLES)[0]
            image = (seen.image + PAPER / 255 * (1 - seen.mask)).clamp(0, 1)
            out[TITLES[name]] = (image * 255).round().to(torch.uint8).cpu().numpy().transpose(1, 2, 0)
        return out, tuple(zoom * side for side in box)


def border_distances(region, garment, foreground):
    """Distances [px] (k,) of each point of the border of `region` to that of `garment`, and back; all (H,W) bool. A border
    runs between neighbouring foreground pixels of which one is inside; (0,) where either has none."""
    import cv2

    a, b = (_border(x, foreground) for x in (region, garment))
    if not (a.any() and b.any()):
        return np.zeros(0)

    def to(border):
        return cv2.distanceTransform((~border).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) / 2

    return np.concatenate([to(b)[a], to(a)[b]])


def _border(inside, foreground):
    """Borders on a grid of twice the resolution, (2H-1, 2W-1) bool, where pixel (r, c) is (2r, 2c)."""
    grid = np.zeros((2 * inside.shape[0] - 1, 2 * inside.shape[1] - 1), bool)
    grid[1::2, ::2] = (inside[1:] != inside[:-1]) & foreground[1:] & foreground[:-1]
    grid[::2, 1::2] = (inside[:, 1:] != inside[:, :-1]) & foreground[:, 1:] & foreground[:, :-1]
    return grid


def box_of(garment):
    """The box about a garment's pixels (H,W), less the few that labels may have wrong; all where there is none."""
    height, width = garment.shape
    if not garment.any():
        return 0, 0, width, height
    (top, left), (bottom, right) = np.quantile(np.argwhere(garment), (0.005, 0.995), axis=0)
    m = ABOUT * max(bottom - top, right - left)
    return max(int(left - m), 0), max(int(top - m), 0), min(int(right + m) + 1, width), min(int(bottom + m) + 1, height)


def sheet(rows, camera):
    """(H,W,3) uint8 of rows (measures of a frame, pictures, box)."""
    lines = []
    for measures, pictures, box in rows:
        words = [f"frame {measures['frame']}, {camera}: captured"]
        for name, title in TITLES.items():
            if title in pictures:
                off = measures[name]["border_mm"]
                words.append(title if off is None else f"{title}: border {off:.1f} mm off")
        lines.append(np.concatenate([text_line(w, TILE + GAP) for w in words], axis=1))
        lines.append(tiles(pictures.values(), box, TILE))
    return np.concatenate(lines)
