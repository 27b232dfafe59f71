"""An avatar measured on pictures that it was not trained on, beside its single-layer baseline.

Reconstruction: each avatar encodes the frame itself, decodes the mean of its code, and is compared with the captured
picture in the crop that it was trained on, drawn over what is seen beside the person there. Driven: poses and facial
keypoints alone, see `driven.py`. Errors are taken over the captured foreground; outside, both pictures are the captured one.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...frame_numbers import evenly
from ...measure.truth import mean_measures
from ..model.poses import joints_apart
from .intervals import mean_change
from .metrics import ErrorSums, errors_over, pixel_sets, squared_error, ssim_map
from .perception import SeenSums, seen
from .sheet import write_sheets

SHOWN = 3  # frames whose pictures are drawn
NAMES = ("layered", "baseline")
COUNTED = {  # squared errors and the pixels that each is a mean over
    "mse": "pixels", "band_mse": "band_pixels", "garment_mse": "garment_pixels", "body_mse": "body_pixels",
    "face_mse": "face_pixels", "silhouette_mse": "silhouette_pixels",
}  # fmt: skip


class PictureErrors:
    """Errors of pictures, by avatar, frame and camera. `garments`: label ids; of several with `names`, each by itself too."""

    def __init__(self, garments, names=()):
        self.garments, self.pictures, self.seen = tuple(garments), defaultdict(dict), defaultdict(dict)
        self.each = dict(zip(names, self.garments)) if len(self.garments) > 1 else {}

    def add(self, picture):
        mask = picture.mask[..., None]
        captured = picture.captured
        sets = pixel_sets(picture.mask, picture.labels, self.garments, face=picture.face)
        sets |= {("garment", name): picture.mask & (picture.labels == label) for name, label in self.each.items()}
        for name, image in picture.rendered.items():
            if not np.isfinite(image).all():
                raise UserError(
                    f"frame {picture.frame}, camera {picture.camera}: the {name} avatar's picture is not finite"
                )
            image = np.where(mask, np.clip(image, 0, 1), captured)
            maps = squared_error(image, captured), ssim_map(image, captured)
            sums = {pixels: errors_over(*maps, where) for pixels, where in sets.items()}
            key = picture.frame, picture.camera
            self.pictures[name][key] = sums
            self.seen[name][key] = seen(image, captured, sets["all"], sets["garment"], picture.mm_per_pixel)

    def measures(self, name, frame=None, pictures=None):
        """Over all frames or one, and under "cameras" over each camera's pictures of them; `pictures`: of these alone."""
        chosen = [
            key for key in self.pictures[name] if frame in (None, key[0]) and (pictures is None or key in pictures)
        ]
        by_camera = {c: self._measures(name, [k for k in chosen if k[1] == c]) for c in sorted({c for _, c in chosen})}
        return self._measures(name, chosen) | {"cameras": by_camera}

    def _measures(self, name, keys):
        total = SeenSums()
        for key in keys:
            total.add(self.seen[name][key])
        return _measures(self.pictures[name][key] for key in keys) | total.measures

    def change(self, name, others, pictures=None):
        """{measure: {change, low, high}} of an avatar's squared errors against those of `others`, the mean over these, see
        `mean_change`; None where no frame has such pixels. `pictures`: over these alone."""
        frames = sorted({frame for frame, _ in (self.pictures[name] if pictures is None else pictures)})
        of = {row: [self.measures(row, frame, pictures) for frame in frames] for row in (name, *others)}
        found = {}
        for measure, pixels in COUNTED.items():
            there = [i for i, one in enumerate(of[name]) if one[pixels]]
            sums = {row: np.array([each[i][measure] * each[i][pixels] for i in there]) for row, each in of.items()}
            found[measure] = mean_change([[(sums[name], sums[other]) for other in others]]) if there else None
        return found


def _measures(pictures):
    """mse, ssim, psnr over the foreground, the same as band_*, garment_mse, body_mse; None where there is no pixel."""
    total = defaultdict(ErrorSums)
    for sums in pictures:
        for pixels, value in sums.items():
            total[pixels].add(value)
    whole, band = total["all"], total["band"]
    each = {pixels[1]: value.mse for pixels, value in total.items() if isinstance(pixels, tuple)}
    return {
        "mse": whole.mse, "ssim": whole.ssim, "psnr": whole.psnr,
        "band_mse": band.mse, "band_ssim": band.ssim, "band_psnr": band.psnr,
        "garment_mse": total["garment"].mse, "body_mse": total["body"].mse, "silhouette_mse": total["silhouette"].mse,
        "face_mse": total["face"].mse, "face_ssim": total["face"].ssim, "face_pixels": total["face"].pixels,
        "pixels": whole.pixels, "band_pixels": band.pixels, "garment_pixels": total["garment"].pixels,
        "body_pixels": total["body"].pixels, "silhouette_pixels": total["silhouette"].pixels,
    } | ({"garments": each} if each else {})  # fmt: skip


def evaluate_avatar(
    folder,
    frames=None,
    run=None,
    progress=lambda stage, done, total: None,
    sheets=True,
    driven=False,
    physics=None,
):
    """{"all": {"layered": {...}, "baseline": {...} or None, ...}, "per_frame": [...], "warnings": [...]}.

    frames: numbers, by default those that the training held out. run: where the run is now, if it was moved. sheets:
    draw AVATAR/sheets/*.png, or driven/*.png. driven: by poses and face alone; physics: which garments
    hang as cloth then, see `worn_cloths`; True measures them first. UserError:
    one line that names what is missing.

    Of each avatar: mse (0..255), ssim, psnr [dB] over the captured foreground of all pictures; band_*: within 10 px of a
    garment's border with the rest of the foreground; ms_ssim, gradient_similarity, legibility: what people see of it, see
    `perception`; garment_mse, body_mse: the garments, and the rest outside the
    band; face_*: what is within 3 cm of a facial keypoint; garments: where there are several, the MSE of each; silhouette_mse: within 5 px of the silhouette; cameras; geometry
    against the truth [mm] where the capture has it. pose_distance_deg: from a frame's pose to
    the nearest that was trained on, the mean geodesic angle over the joints below the root. labels: "truth", or
    "captured" where there is none. photometric: without truth, the registration's own texture seen by the other cameras
    of a frame, shown to this one, for layers and for the tracked surface. change: of the layered avatar's squared
    errors against the baseline's, with 95 % intervals over the frames. intersections: pairs of triangles before and after
    `untangle`, of every figure. driven: None, or the temporal model's errors of codes, motion (second differences of garments'
    vertices, decoded and true), `baseline_rows`, the baseline's errors by each of `driving_codes`, `rivals`, the main ones of them by short names, and `baseline_by`, the
    strongest of those shown in every picture, which `baseline` is.
    """
    from ..drive.cloths import ensure_cloths
    from .driven import Driven
    from .heldout import HeldOut

    if physics:
        ensure_cloths(folder, run, progress)
    held = Driven(Path(folder), frames, run, physics) if driven else HeldOut(Path(folder), frames, run)
    errors, spacing, shown = PictureErrors(held.garment_labels.values(), held.garment_labels), [], defaultdict(list)
    for i, picture in enumerate(held.pictures()):
        progress("evaluate", i, held.count)
        errors.add(picture)
        spacing.append(picture.mm_per_pixel)
        if picture.frame in evenly(held.frames, SHOWN):
            shown[picture.frame].append(picture)
    progress("evaluate", held.count, held.count)
    sources = held.sources(errors)
    if sheets:
        middle = evenly(held.frames, SHOWN)[len(shown) // 2]
        drawn = [[_as_stated(picture, sources) for picture in pictures] for pictures in shown.values()]
        write_sheets(sheets_folder(folder, driven), drawn, errors.garments, (middle, held.unseen_views(middle)))
    result = _result(held, errors, sources, float(np.mean(spacing)))
    result["all"]["driven"] = held.summary(errors) if driven else None
    result["all"]["intersections"] = held.intersecting()  # of the frames between the pictures too
    result["warnings"] += held.piercing()
    return result


def sheets_folder(folder, driven):
    return Path(folder) / ("driven" if driven else "sheets")


def _as_stated(picture, sources):
    """The picture with what each avatar's figures are of."""
    return replace(picture, rendered={name: picture.rendered[shown] for name, shown in sources.items()})


def _result(held, errors, sources, mm_per_pixel):
    geometry = {n: held.geometry_errors(n, sources) for n in held.frames} if held.truth else {}
    whole, alone = held.from_training()
    distance = {n: None if np.isnan(d) else float(d) for n, d in zip(held.frames, whole)}

    def of(name, frame=None):
        if name not in held.avatars:
            return None
        found = [g[name] for n, g in geometry.items() if frame in (None, n)]
        return errors.measures(sources[name], frame) | {"geometry": mean_measures(found) if found else None}

    everything = {name: of(name) for name in NAMES} | {
        "parameters": {name: avatar.parameters_count() for name, avatar in held.avatars.items()},
        "frames": len(held.frames),
        "pose_distance_deg": mean_measures(list(distance.values())),
        "mm_per_pixel": mm_per_pixel,
        "change": errors.change(sources["layered"], [sources["baseline"]]) if len(sources) == 2 else None,
        "labels": "truth" if held.truth else "captured",
        "photometric": None if held.truth else held.photometric(),
    }
    per_frame = [
        {"frame": n, "pose_distance_deg": distance[n]} | {name: of(name, n) for name in NAMES} for n in held.frames
    ]
    names = held.registered.run.body_model.joint_names[1:]
    held.warnings += joints_apart(held.frames, alone, names, "the training's poses")
    return {"all": everything, "per_frame": per_frame, "warnings": held.warnings}  # to which driving adds
