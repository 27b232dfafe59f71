"""Held-out frames driven by poses and facial keypoints alone: of a frame no code, no texture and no pixel is used.

Garments by the temporal model's codes, or as cloth that hangs (docs/method/drape.md), then out of the body; the single-layer
baseline by each of `driving_codes`. What is stated for it is the strongest on these very frames.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...frame_numbers import stride_of
from ...kernels import self_intersections
from ...measure.truth import second_difference
from ..drive.draping import Draping, doubts, outdated, relieved, worn_cloths
from ..drive.driver import hardly_foretold, load_driver, run_track
from ..model.checkpoint import load_avatar
from .driving_codes import MEAN, OWN, TEMPORAL, UNIT, ZERO, driving_codes, kind_of, rivals
from .heldout import VIEW, HeldOut

LED = (TEMPORAL, MEAN, ZERO)  # rows of every picture; those drawn at random are of some
COMPARED = 7  # every which picture shows all rows; prime, so that few numbers of cameras see some of them only
ASIDE = 15.0  # mm, of an opening from where it is registered, in the mean of the frames: no error of single poses
STATED = (
    "mse", "ssim", "band_mse", "garment_mse", "body_mse", "silhouette_mse", "ms_ssim", "gradient_similarity", "legibility",
)  # fmt: skip


class Driven(HeldOut):
    """HeldOut's avatars by what drives them: "layered", and a row each of the baseline's `driving_codes`."""

    def __init__(self, folder, frames=None, run=None, physics=False):
        super().__init__(folder, frames, run)
        run = self.registered.run
        self.span = [n for n in run.ok if self.frames[0] <= n <= self.frames[-1]]
        layers = self.avatars["layered"].layers if "layered" in self.avatars else ()
        cloths = worn_cloths(folder, layers, physics)
        self.warnings += doubts(cloths) + outdated(folder, layers, physics)
        lead = max((cloth.asked.lead for cloth in cloths.values()), default=0)
        self.led = [n for n in run.ok if n < self.frames[0]][-lead:] if lead else []
        self.latents, self.driver, self.measured, self.draping, self.shown = {}, None, {}, None, {}
        self.less = {}  # {frame: share of cloth in what is shown}, where it is not all
        self._steering = {}  # {frame: what steers it}, which every view and row asks for
        if "layered" in self.avatars:
            avatar, self.shown["layered"] = self.avatars["layered"], "layered"
            self.latents["layered"] = self._garment_codes(folder, avatar)
            if cloths:
                self.draping = self._draping(cloths)
        if "baseline" in self.avatars:
            self._baseline_codes(run)
        self.decoded = {name: {} for name in self.shown}

    def _garment_codes(self, folder, avatar):
        """{frame: {garment: (1,Z)}} from the poses up to each frame, those between the pictured ones included."""
        if not any(layer.kind == "garment" for layer in avatar.layers) or avatar.settings.data.window:
            return {n: {} for n in self.led + self.span}
        self.driver, stride, self.measured = load_driver(folder)
        self.warnings += hardly_foretold(self.measured)
        track = run_track(avatar, self.registered.run, stride)
        with torch.no_grad():
            codes = {name: z.to(self.device) for name, z in self.driver.latents(track).items()}
        at = {n: i for i, n in enumerate(track.frames.tolist())}
        return {n: {name: z[at[n]][None] for name, z in codes.items()} for n in self.led + self.span}

    def _draping(self, cloths):
        """Cloth of the layered avatar over the span, begun some frames before it."""
        frames, run = self.led + self.span, self.registered.run
        times, rotations = np.array(frames) / run.scene.fps, np.stack([run.pose.at(n)[0] for n in frames])
        decoded = lambda k: (self._posed("layered", frames[k]), self._steered(frames[k]))
        layered = self.avatars["layered"]
        readers = dict.fromkeys(cloths, layered)
        return Draping(layered, cloths, self.layering, times, rotations, decoded, readers)

    def _posed(self, name, frame):
        """{layer: Decoded} of a frame by its codes alone, without textures."""
        batch = self._steered(frame) | {"T_camera_world": torch.eye(4, device=self.device)[None]}
        return self.avatars[self.shown[name]].decode(batch, self.latents[name][frame], texture=False)

    def _baseline_codes(self, run):
        avatar = load_avatar(self.folders["baseline"])  # codes are of the CPU
        surface = avatar.layers[0].name
        for row, codes in driving_codes(self.folders["baseline"], avatar, run, self.span).items():
            self.shown[row] = "baseline"
            self.latents[row] = {n: {surface: z.to(self.device)} for n, z in codes.items()}

    def shown_in(self, i):
        return self.shown if i % COMPARED == 0 else {n: of for n, of in self.shown.items() if n in ("layered", *LED)}

    def sources(self, errors):
        rows = [row for row in LED if row in self.shown]
        error = lambda row: np.inf if (mse := errors.measures(row)["mse"]) is None else mse  # None: no foreground
        strongest = min(rows, key=error, default=None)
        return {name: strongest if name == "baseline" else name for name in self.avatars}

    def _decode(self, name, sample):
        frame = int(sample["frame"])
        batch = self._steered(frame) | {key: sample[key][None].to(self.device) for key in VIEW}
        decoded = self.avatars[self.shown[name]].decode(batch, self.latents[name][frame])
        placed = self._placed(name, frame)
        return {layer: replace(one, vertices=self._tensor(placed[layer])) for layer, one in decoded.items()}

    def _steered(self, frame):
        """Pose and face of a registered frame as `Avatar.decode` takes them."""
        if frame not in self._steering:
            self._steering[frame] = self._read_steering(frame)
        return self._steering[frame]

    def _read_steering(self, frame):
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
            self._keep(name, frame, self._posed(name, frame), self._steered(frame))
        return self._vertices(name, frame)

    def _asked_again(self, name):
        return name == "layered" or (name in LED and super()._asked_again(name))

    def cleared(self, frame, decoded, pose):
        if not self.draping:
            return super().cleared(frame, decoded, pose)
        found, share = self.draping.clear((self.led + self.span).index(frame), decoded, pose)
        if share < 1:
            self.less[frame] = share
        return found

    def summary(self, errors):
        """What evaluation says of what drives the avatars, beside its usual measures."""
        rows = self._rows(errors) if "baseline" in self.avatars else None
        return {
            "temporal": self.driver
            and {"model": self.driver.settings.model, "window": self.driver.settings.window} | self.measured,
            "motion": self._motion(),
            "aside_mm": self._aside(),
            "physics": self.draping and self._physics(),
            "baseline_by": self.sources(errors).get("baseline"),
            "baseline_rows": rows,
            "rivals": rows and rivals(rows),
        }

    def _rows(self, errors):
        """{row: STATED} over the pictures that show all rows: of a Gaussian the medians over its draws, with the least and the
        largest `mse`, and "layered" over the same. change: of the layered avatar against the row, the mean over its draws.
        "pictures": how many."""
        common = set.intersection(*(set(errors.pictures[name]) for name in self.shown))
        found = {}
        for row in dict.fromkeys(map(kind_of, self.shown)):
            names = [name for name in self.shown if kind_of(name) == row]
            each = [errors.measures(name, pictures=common) for name in names]
            found[row] = {m: _median([one[m] for one in each]) for m in STATED}
            if row != "layered" and "layered" in self.shown:
                found[row]["change"] = errors.change("layered", names, common)
            if row in (UNIT, OWN):
                mse = [one["mse"] for one in each]
                found[row] |= {"draws": len(mse), "least_mse": min(mse), "largest_mse": max(mse)}
        return {"pictures": len(common)} | found

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

    @torch.no_grad()
    def _aside(self):
        """{garment: {opening: distance from the registered one [mm], in the mean of its vertices and of the frames, unposed}}: large
        where cloth slipped and stayed, which no pose tells."""
        if "layered" not in self.avatars:
            return {}
        avatar, run, found = self.avatars["layered"], self.registered.run, {}
        for name in self.registered.garment_labels:
            off = []
            for n in self.frames:
                R, t = avatar.transforms(self._steered(n))
                both = np.stack([self._placed("layered", n)[name], run.garments[name].at(n)])
                both = self._tensor(both)[0]
                shown, registered = avatar.model(name).skin.unpose(both, R.expand(2, -1, -1, -1), t.expand(2, -1, -1))
                off.append((shown - registered).cpu().numpy())
            mean, loops = 1e3 * np.mean(off, axis=0), run.garments[name].loops
            found[name] = {opening: float(np.linalg.norm(mean[loop].mean(0))) for opening, loop in loops.items()}
        self.warnings += aside(found)
        return found

    def _physics(self):
        """strain of the most stretched edge, {frame: the share of cloth, where codes had to help}, the cloth's own pairs, and {garment: what
        was missed where its frames were left out [mm]}."""
        self.warnings += relieved(self.less, self.draping.strain)
        cloths = self.draping.cloths.items()
        missed = {n: {of: 1e3 * m for of, m in cloth.residual.missed.items()} for n, cloth in cloths}
        own = self._self_pairs()
        return {"strain": self.draping.strain, "shares": self.less, "self_pairs": own, "missed_mm": missed}

    def _self_pairs(self):
        """{garment: pairs of its own triangles that intersect}, mean over the span: cloth does not meet itself."""
        faces = {layer.name: layer.faces for layer in self.layering.garments}
        placed = [self._placed("layered", n) for n in self.span]
        return {
            name: float(np.mean([len(self_intersections(V[name], F)) for V in placed])) for name, F in faces.items()
        }


def aside(found):
    """What to warn of openings that lie aside, {garment: {opening: [mm]}}."""
    return [
        f"{garment}: opening {opening} is driven {mm:.0f} mm beside the registered one in the mean of all frames: it slipped and "
        "stayed, which no pose tells, or these poses are not those that taught it"
        for garment, openings in found.items()
        for opening, mm in openings.items()
        if mm > ASIDE
    ]


def _median(values):
    return None if None in values else float(np.median(values))
