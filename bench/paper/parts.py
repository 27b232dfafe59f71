"""Tables of what each part of an avatar is worth, and of what drives it, from what lies in a study's folder."""

from __future__ import annotations

import numpy as np

from .cells import Table, percent, relative
from .results import ALIGNED, DAMPED, FULL, SWITCHES, UNALIGNED, driven_of, slug


def ablations(found):
    """The full avatar and each without one part."""
    rows = []
    for name, subject in found.items():
        there = subject["ablations"]
        named = {
            row: there[slug(row)] for row in (*SWITCHES, UNALIGNED, ALIGNED) if "driven" in there.get(slug(row), {})
        }
        if not named:
            continue
        for row, one in {FULL: full_of(subject), **named}.items():
            if "driven" in one:
                rows.append([name, row, *_errors(one["driven"]["all"])])
    head = (
        "subject", "avatar", "MSE", "SSIM", "garments", "band", "near the silhouette", "garment's surface [mm]",
        "correspondence [mm]", "jitter",
    )  # fmt: skip
    note = "Jitter: mean second difference of the error of the garment's vertices [mm a frame²]."
    return Table("Ablations, driven", head, rows, note)


def full_of(subject):
    """The avatar that ablations are compared with: one of their steps, or that of the seed that was ablated."""
    return subject["ablations"].get(FULL) or subject["seeds"].get((subject["ablated"] or {}).get("seed"), {})


def _errors(everything):
    layered = everything["layered"]
    garments = list(((layered["geometry"] or {}).get("garment") or {}).values())
    motion = list(everything["driven"]["motion"].values())
    mean = lambda values: float(np.mean(values)) if values and None not in values else None
    return [
        *(layered[m] for m in ("mse", "ssim", "garment_mse", "band_mse", "silhouette_mse")),
        mean([g["surface_mm"] for g in garments]), mean([g["correspondence_mm"] for g in garments]),
        mean([m["jitter_mm"] for m in motion]),
    ]  # fmt: skip


def windows(found):
    """Lengths of the window, and the damped model."""
    rows = []
    for name, subject in found.items():
        there = subject["ablations"]
        lengths = sorted((int(row[1:]), row) for row in there if row[0] == "L" and row[1:].isdigit())
        for row in [*(row for _, row in lengths), DAMPED]:
            if "driven" not in there.get(row, {}):
                continue
            everything, temporal = there[row]["driven"]["all"], there[row]["temporal"]
            layered = everything["layered"]
            for garment, motion in everything["driven"]["motion"].items():
                rows.append([
                    name, garment, row, layered["mse"], layered["ssim"], layered["garment_mse"], temporal["code_error"],
                    temporal.get("held_out"), motion["acceleration_mm"], motion["true_acceleration_mm"], motion["jitter_mm"],
                ])  # fmt: skip
    head = (
        "subject", "garment", "model", "MSE", "SSIM", "MSE on garments", "codes' error, trained", "held out", "acceleration",
        "true", "jitter",
    )  # fmt: skip
    note = (
        "L: poses that the window model sees; damped: the second-order model; none of them with kriging, which the full avatar has beside "
        "its window model. Codes' error over their variance in training. "
        "Acceleration: mean second difference of the garment's vertices [mm a frame²]; jitter: the same of their error."
    )
    return Table("Temporal models", head, rows, note)


def alignment(found):
    """What aligning did to unwrapped textures."""
    rows = []
    for name, subject in found.items():
        for garment, one in (subject["aligned"] or {}).get("garments", {}).items():
            for measure, words in (
                ("texture_std", "standard deviation"),
                ("anchor_error", "error to the anchors' mean"),
            ):
                before, after = one["before"][measure], one["after"][measure]
                rows.append([name, garment, words, before, after, percent(relative(after, before))])
    return Table("Texture alignment", ("subject", "garment", "unwrapped texture", "before", "after", "change"), rows)


def intersections(found):
    """Triangle pairs of garments and what lies under them, as driven by codes and as moved out, and what that took of the skin."""
    rows = []
    for name, seed, driven in driven_of(found):
        pairs = driven["intersections"]
        if pairs:
            before, frames = pairs["before"], pairs["frames"]
            rows.append([name, seed, frames, before, before / frames, pairs["left"], pairs.get("dent_mm")])
    head = ("subject", "seed", "frames", "pairs as decoded", "a frame", "pairs left", "skin gave way by [mm]")
    return Table("Intersections", head, rows)


def qualities(found):
    """Quality presets after the same time of training."""
    rows = []
    for name, subject in found.items():
        for row, one in subject["ablations"].items():
            if row.startswith("quality ") and {"trained", "driven", "speed"} <= one.keys():
                everything, speed, trained = one["driven"]["all"], one["speed"], one["trained"]
                layered, steps = everything["layered"], " + ".join(str(n) for n in trained["steps"].values())
                rows.append([
                    name, row.removeprefix("quality "), trained["minutes"], steps, everything["mm_per_pixel"], layered["mse"],
                    layered["ssim"], speed["size"], speed["frames_per_second"], speed["frames_per_second_with_occlusion"],
                    speed["rays"],
                ])  # fmt: skip
    head = (
        "subject", "quality", "minutes of training", "steps", "mm a pixel", "MSE", "SSIM", "pixels", "frames a second",
        "with occlusion", "rays",
    )  # fmt: skip
    note = "Errors are of each preset's own window: compare them only where a pixel is as large."
    return Table("Quality presets", head, rows, note if rows else "")
