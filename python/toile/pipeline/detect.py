"""Keypoints and masks of a capture's pictures: what `toile detect` does."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config import ReconstructSettings
from ..frame_numbers import frame_ranges
from ..io.capture import Capture
from ..io.files import write_text
from ..io.image import write_image
from ..measure.inspection.files import upended
from ..scene import Keypoints
from ..stages.reconstruct import agreement, triangulate
from ..vision.detectors import Detection
from .workers import Workers, check_workers, everywhere

AGREED = 0.5  # share of a view's detections that the other views confirm, at least, for it to show the same person
DECIMALS = 2


@dataclass(frozen=True)
class Detected:
    """Numbers of the frames whose keypoints were written, and of those that had theirs; and what is said of them."""

    written: tuple[int, ...]
    kept: tuple[int, ...]
    warnings: tuple[str, ...]


def detect(
    capture: Capture,
    detector: Any,
    frames: Sequence[int],
    again: bool = False,
    progress: Any = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> Detected:
    """Writes keypoints.json and masks/CAMERA.png into the frames of a capture, each frame whole or not at all.

    `detector`: see toile.vision.detectors. `workers`, `scheduler`: see `Workers`; each call of the detector is one's. Frames that have keypoints.json are left alone, unless `again`; masks that are
    there always are. Where views see different people, or a picture of nobody makes the detector invent one, the views that
    disagree with the others get confidence 0, and that is said.
    """
    check_workers(workers, scheduler)
    capture = replace(capture, root=everywhere(capture.root, scheduler))
    there = {number for number in frames if (capture.folder(number) / "keypoints.json").exists()}
    asked = [number for number in frames if again or number not in there]
    for number in asked:
        capture.check_pictures(number)
    calls = [asked[first : first + detector.at_once] for first in range(0, len(asked), detector.at_once)]
    warnings = {}
    with Workers(min(workers, max(len(calls), 1)), _prepared, capture, detector, scheduler=scheduler) as pool:
        for done, (number, found) in enumerate(pool.each(_detect, calls), 1):
            warnings[number] = [f"frame {number}: {warning}" for warning in found]
            if progress is not None:
                progress("detect", done, len(asked))
    said = [*_beforehand(capture, asked), *(line for number in asked for line in warnings[number])]
    return Detected(tuple(asked), tuple(sorted(there - set(asked))), tuple(said))


def _prepared(capture: Capture, detector: Any) -> tuple[Capture, Any]:
    return capture, detector


def _detect(prepared: tuple[Capture, Any], numbers: Sequence[int]) -> Iterator[tuple[int, list[str]]]:
    """Writes what one call of the detector finds; yields each frame's number and what is said of it."""
    capture, detector = prepared
    folders = [capture.folder(number) / "images" for number in numbers]
    for number, detection in zip(numbers, detector.detect(folders, capture.cameras), strict=True):
        keypoints, warnings = confirmed(detection.keypoints, capture.cameras)
        _write(capture.folder(number), replace(detection, keypoints=keypoints))
        yield number, warnings


def _beforehand(capture: Capture, asked: Sequence[int]) -> list[str]:
    """What is to be said whatever will be detected."""
    placed = [number for number in asked if (capture.folder(number) / "keypoints3d.json").exists()]
    said = (
        [f"frames {frame_ranges(placed)}: keypoints3d.json is there: `toile register` takes its points"]
        if placed
        else []
    )
    said += [finding.text for finding in upended(capture)] if asked else []
    return said + (
        ["one camera: no other view confirms what is detected"] if len(capture.cameras) == 1 and asked else []
    )


def confirmed(keypoints: Keypoints, cameras: Any) -> tuple[Keypoints, list[str]]:
    """Keypoints of one instant, those of views that disagree with the others without confidence; and what is said of it."""
    settings = ReconstructSettings()
    seen = [name for name, rows in keypoints.points.items() if (rows[:, 2] >= settings.min_confidence).any()]
    if not seen:
        return keypoints, ["nobody was found in any picture"]
    if len(cameras) < 2:
        return keypoints, []
    if len(seen) < 2:
        shares = dict.fromkeys(seen, 0.0)
    else:
        shares = agreement(keypoints, triangulate(keypoints, cameras, settings), cameras, settings)
    astray = {name: share for name, share in shares.items() if share < AGREED}
    points = {name: rows * [1, 1, name not in astray] for name, rows in keypoints.points.items()}
    warnings = [
        f"{name}: other views confirm {100 * share:.0f} % of what was detected: it shows somebody else, nobody, or its "
        "calibration is wrong; none of it is used"
        for name, share in astray.items()
    ]
    return Keypoints(keypoints.names, points), warnings


def _write(folder: Path, detection: Detection) -> None:
    for name, mask in detection.masks.items():
        path = folder / "masks" / f"{name}.png"
        if not path.exists():
            write_image(path, 255 * mask.astype(np.uint8))
    points = {name: np.round(rows, DECIMALS).tolist() for name, rows in detection.keypoints.points.items()}
    write_text(folder / "keypoints.json", json.dumps({"names": list(detection.keypoints.names), "points": points}))
