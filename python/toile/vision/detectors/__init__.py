"""Detectors: from the pictures of one instant to keypoints and masks of one person.

A detector is an object with `detect(folders, cameras) -> Iterator[Detection]`: each folder holds the pictures of one instant,
one a camera and named by it; a Detection comes for each, in their order. `at_once`: how many it is best given a call. It
pickles: workers are given it. Three kinds: a network in an ONNX file
(`network.Network`), any program that writes files (`program.Program`), and mediapipe, which is such a program
(`holistic.py`, in an environment of its own).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...scene import Keypoints


@dataclass(frozen=True)
class Detection:
    """What was found at one instant: `keypoints` of all cameras, confidence 0 where unseen; `masks` {camera: (H,W) bool}, of
    the cameras where the person was outlined."""

    keypoints: Keypoints
    masks: dict[str, Any] = field(default_factory=dict)
