"""Keypoints by themselves, before anything is compared: those that stand for unseen ones, and cameras that see none."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.arrays import Floats
from ..evidence import UNSEEN
from .cameras import Finding

MANY = 4  # names in a message


def at_origin(cameras: Sequence[str], uv: Floats, weight: Floats) -> list[Finding]:
    """Detections (C,T,K,2) [px] at (0, 0) to the bit, as programs write what they did not find, that have a confidence (C,T,K)."""
    void = (uv == 0).all(-1) & (weight > UNSEEN)
    if not void.any():
        return []
    share = 100 * void.sum() / (weight > UNSEEN).sum()
    text = f"keypoints: {max(1, round(share))} % of those with a confidence lie at (0, 0)"
    names = [name for name, of in zip(cameras, void) if of.any()]
    said = f"{', '.join(names[:MANY])}{', ...' * (len(names) > MANY)}"
    return [Finding(f"{text}, in {said}: give what was not found the confidence 0", serious=False)]


def blind(cameras: Sequence[str], weight: Floats) -> list[Finding]:
    """Cameras none of whose keypoints is seen in any frame, while others' are."""
    none = [name for name, of in zip(cameras, weight) if not (of > UNSEEN).any()]
    if not none or len(none) == len(cameras):
        return []
    said = f"{', '.join(none[:MANY])}{', ...' * (len(none) > MANY)}"
    return [Finding(f"{said}: no keypoint is seen there in any frame: does it show the person?", serious=False)]
