"""Colours of faces: whether red and blue are exchanged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import UserError
from ...io.capture import Capture
from ...kernels.arrays import Floats
from ...scene import Frame
from .cameras import Finding
from .rays import SURE

POINTS = 5  # of a face that a picture must show
PICTURES = 3  # that must show one
BLUE, BLUER = -0.03, -0.1  # (R - B) / (R + B) of every face, and of most: skin has +0.1 to +0.3


def blue_faces(capture: Capture, frames: Sequence[Frame]) -> list[Finding]:
    """Pictures all of whose faces, where keypoints show them, are bluer than red, as those saved in the order BGR are."""
    found = []
    for frame in frames:
        try:
            keypoints = capture.keypoints(frame.number)
        except UserError:  # told where keypoints are looked at
            continue
        face = [k for k, name in enumerate(keypoints.names) if name.startswith("face.")] if keypoints else []
        for name in frame.images.keys() & keypoints.points.keys() if face else ():
            u, v, confidence = keypoints.points[name][face].T
            height, width = frame.images[name].shape[:2]
            seen = (confidence > SURE) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
            if seen.sum() >= POINTS:
                found.append(_redness(frame.images[name][v[seen].astype(int), u[seen].astype(int)]))
    if len(found) < PICTURES or max(found) > BLUE or np.median(found) > BLUER:
        return []
    text = f"images: faces are bluer than red in all {len(found)} pictures that show one"
    return [Finding(f"{text}: are red and blue exchanged (BGR saved as RGB), or is the light blue?", serious=False)]


def _redness(colours: Floats) -> float:
    """Median of (R - B) / (R + B) over colours (k,3)."""
    red, _, blue = colours.astype(float).T
    return float(np.median((red - blue) / np.maximum(red + blue, 1)))
