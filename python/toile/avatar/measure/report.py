"""The page of an avatar: its errors beside the baseline's, frame by frame, and the picture sheets."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from ...io.files import output_file, write_text
from ...measure.page import document, figure, flatten, plot, table
from .evaluation import NAMES, evaluate_avatar, sheets_folder

MEASURES = {  # name in the JSON: what it says, in the order of the table
    "mse": "mean squared error (0\u2013255), foreground",
    "band_mse": "\u2026 within 10 px of the garment's border",
    "garment_mse": "\u2026 on garments",
    "body_mse": "\u2026 on the body, outside that band",
    "face_mse": "\u2026 on the face",
    "silhouette_mse": "\u2026 within 5 px of the silhouette",
    "ssim": "SSIM, foreground",
    "band_ssim": "\u2026 within 10 px of the garment's border",
    "psnr": "PSNR [dB], foreground",
    "ms_ssim": "SSIM at five scales, foreground",
    "gradient_similarity": "likeness of edges, foreground",
    "legibility": "correlation of prints after the best shift of up to 1 cm",
}
TITLES = {"layered": "layered", "baseline": "single layer"}
PLOTTED = ("mse", "band_mse")


def write_avatar_report(folder, out=None, **options):
    """Evaluates an avatar (`evaluation.evaluate_avatar`, also for the options) and writes AVATAR/report.html; returns its path."""
    folder = Path(folder)
    path = output_file(out or folder / "report.html")
    write_text(path, document(f"Avatar {folder.name}", section(folder, evaluate_avatar(folder, **options))))
    return path


def section(folder, result):
    """HTML of an evaluation's result and of the sheets that it drew."""
    everything = result["all"]
    how = "driven by poses and face" if everything["driven"] else "reconstructed"
    distance = everything["pose_distance_deg"]
    apart = "" if distance is None else f"; distance of poses to the nearest trained one {distance:.1f}\u00b0 a joint"
    intro = f"Frames held out: {everything['frames']}{apart}; pixels of {everything['mm_per_pixel']:.1f} mm; borders from {everything['labels']} labels."
    warnings = "".join(f"<p class='why'>{html.escape(w)}</p>" for w in result["warnings"])
    return (
        f"<h2>Avatar on pictures it was not trained on, {how}</h2><p class='soft'>{html.escape(intro)}</p>{warnings}"
        f"{_errors(everything)}{_geometry(everything)}{_driven(everything)}{_photometric(everything)}"
        f"<div class='plots' style='margin-top:1rem'>{_plots(result)}</div>{_sheets(sheets_folder(folder, everything['driven']))}"
    )


def _errors(everything):
    there = [name for name in NAMES if everything[name]]
    rows = []
    for measure, words in MEASURES.items():
        values = [everything[name][measure] for name in there]
        if any(value is not None for value in values):
            rows.append([words, *values, *([_change(everything["change"].get(measure))] if len(values) == 2 else [])])
    return table(["", *(TITLES[name] for name in there), *(["change"] if len(there) == 2 else [])], rows)


def _change(found):
    """How the layered avatar's error differs from the baseline's, in words, with its interval; only for squared errors."""
    if not found:
        return ""
    return f"{100 * found['change']:+.1f} % [{100 * found['low']:+.1f}, {100 * found['high']:+.1f}]"


def _geometry(everything):
    """Distances of the decoded layers to the truth."""
    there = {
        name: flatten(everything[name]["geometry"])
        for name in NAMES
        if everything[name] and everything[name]["geometry"]
    }
    measures = dict.fromkeys(measure for flat in there.values() for measure in flat)
    rows = [[measure.replace("_mm", ""), *(flat.get(measure) for flat in there.values())] for measure in measures]
    head = ["", *(TITLES[name] for name in there)]
    return f"<h2>Decoded geometry against the truth [mm]</h2>{table(head, rows)}" if rows else ""


def _driven(everything):
    """How the garment moves, what was untangled, and how much the drawn code matters to the baseline."""
    flat = flatten(everything["driven"] or {})
    return f"<h2>Driven</h2>{table(['', ''], [[measure, value] for measure, value in flat.items()])}" if flat else ""


def _photometric(everything):
    checks = {n: v for n, v in (everything["photometric"] or {}).items() if v}
    if not checks:
        return ""
    rows = [
        [measure, *(check[measure] for check in checks.values())] for measure in ("mse", "ssim", "psnr", "band_mse")
    ]
    return (
        "<h2>Registration: a camera's picture from the texture of the others</h2>"
        f"{table(['', *('layers' if n == 'layered' else 'tracked surface' for n in checks)], rows)}"
    )


def _plots(result):
    plots = []
    for name in NAMES:
        for measure in PLOTTED:
            points = [
                (f["frame"], f[name][measure]) for f in result["per_frame"] if f[name] and f[name][measure] is not None
            ]
            if len(points) > 1:
                plots.append(plot(f"{name} {measure.replace('_', ' ')}", points))
    return "".join(plots)


def _sheets(folder):
    from PIL import Image

    paths = sorted(folder.glob("*.png"))
    return "".join(
        f"<div class='sheet'>{figure(np.asarray(Image.open(p).convert('RGB')), p.stem)}</div>" for p in paths
    )
