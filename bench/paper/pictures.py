"""Close-ups of one driven view by several avatars."""

from __future__ import annotations

from dataclasses import replace

import numpy as np


def zooms(full, others, out):
    """OUT/ROW.png: captured, ROW, full and their errors, whole and close up at the garment's loops and the middle of what
    the view shows of it. `others` {ROW: folder}. The view: of the middle held-out frame the one whose garment has the most
    different colours, which is where a print shows."""
    from toile.avatar.measure.driven import Driven
    from toile.avatar.measure.sheet import sheet
    from toile.avatar.model.checkpoint import read_facts
    from toile.io.image import write_image

    held = read_facts(full)["holdout"]
    frame = held[len(held) // 2]
    first = Driven(full, [frame])
    labels = list(first.garment_labels.values())
    view = max(range(first.count), key=lambda i: _colourful(first.data["layered"][i], labels))
    shown = first.picture(view)
    loops = shown.loops | _middle(np.isin(shown.labels, labels) & shown.mask)
    out.mkdir(parents=True, exist_ok=True)
    for row, folder in others.items():
        other = Driven(folder, [frame]).picture(view)
        both = {row: other.rendered["layered"], "full": shown.rendered["layered"]}
        write_image(out / f"{row}.png", sheet(replace(shown, rendered=both, loops=loops), (row, "full")))
    return {"frame": frame, "camera": shown.camera, "rows": sorted(others)}


def _colourful(sample, labels):
    """Sum of squared differences of a garment's pixels from their mean."""
    pixels = sample["image"].permute(1, 2, 0).numpy()[np.isin(sample["labels"].numpy(), labels)]
    return float(((pixels - pixels.mean(0)) ** 2).sum()) if len(pixels) else 0.0


def _middle(garment):
    """{"middle": corners} of the middle half of the box about a garment's pixels (H,W)."""
    rows, columns = np.nonzero(garment)
    if not len(rows):
        return {}
    y, x = (np.quantile(values, (0.25, 0.75)) for values in (rows, columns))
    return {"middle": np.array([[x[0], y[0]], [x[1], y[1]]])}
