"""Cameras that a trial was not shown, as witnesses of what it registered."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from ...errors import UserError
from ...io.capture import Capture
from ...io.run import Run
from ...measure.evidence import overlap
from ...measure.rendering import joined
from ...vision.visibility import DepthView

LEAST = 5  # cameras, from which on some can be spared
EVERY = 4  # one of so many is held out


def witnesses(capture: Capture, number: int) -> tuple[str, ...]:
    """Cameras to hold out: every fourth of those that have labels or a mask of this frame; none of few."""
    telling = [name for name in capture.cameras if name in {*capture.labelled(number), *capture.masked(number)}]
    return tuple(telling[1::EVERY]) if len(telling) >= LEAST else ()


def agreement(run: Run, capture: Capture, cameras: Sequence[str]) -> dict[str, float]:
    """Intersection over union {"silhouette" or a garment's label: mean over frames and held-out cameras} of the registered
    layers and the label images; where there are none, of the silhouette and the masks."""
    found = defaultdict(list)
    for number in run.ok:
        try:
            shown = capture.pictures(number)
        except (
            UserError
        ):  # of a camera that the trial did not see; in the one that did this frame failed, which is told
            continue
        layers = [(run.body.at(number), run.body.faces, 0)]
        layers += [(garment.at(number), garment.faces, garment.label) for garment in run.garments.values()]
        for name in cameras:
            drawn = drawn_labels(capture.cameras[name], layers)
            labels, mask = shown.labels.get(name), shown.masks.get(name)
            if labels is not None:
                found["silhouette"].append(overlap(drawn >= 0, labels > 0))
                for garment in run.garments.values():
                    found[garment.name].append(overlap(drawn == garment.label, labels == garment.label))
            elif mask is not None:
                found["silhouette"].append(overlap(drawn >= 0, mask))
    return {name: float(np.mean(values)) for name, values in found.items()}


def drawn_labels(camera, layers) -> np.ndarray:
    """What a camera sees (H,W) of layers [(V, F, label)]: the label in front, -1 where there is nothing."""
    V, F, layer = joined([layer[:2] for layer in layers])
    labels = np.array([label for _, _, label in layers])
    return np.append(labels[layer], -1)[DepthView(camera, V, F).face]
