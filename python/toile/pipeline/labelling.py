"""Label images by a network, written for pictures that have none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..io.capture import Capture
from ..io.image import write_image
from ..vision.segmenters.asked import labelled_by, scene_segmenter
from ..vision.segmenters.network import Segmenter
from .workers import Workers, check_workers, everywhere

UNSURE = 0.5  # certainty below which a pixel of the person is said to be unsure


@dataclass(frozen=True)
class Written:
    """How many label images were written and how many were there, and the share of the person's pixels in those written
    that are unsure."""

    written: int
    kept: int
    unsure: float


def write_labels(
    capture: Capture,
    network: str | Path,
    frames: Sequence[int],
    again: bool = False,
    progress: Any = None,
    workers: int = 1,
    scheduler: str | None = None,
) -> Written:
    """Writes labels/CAMERA.png of the pictures that have none, of all with `again`, each file whole or not at all, by the
    network in a file. `workers`, `scheduler`: see `Workers`."""
    check_workers(workers, scheduler)
    capture, network = replace(capture, root=everywhere(capture.root, scheduler)), everywhere(Path(network), scheduler)
    busy, counts = min(workers, max(len(frames), 1)), np.zeros(4, np.int64)
    with Workers(busy, _with_segmenter, capture, network, again, scheduler=scheduler) as pool:
        pool.prepared()
        for done, found in enumerate(pool.each(_write_labels, frames), 1):
            counts += found
            if progress is not None:
                progress("labels", done, len(frames))
    written, kept, person, unsure = counts.tolist()
    return Written(written, kept, unsure / max(person, 1))


def _with_segmenter(capture: Capture, network: Path, again: bool) -> tuple[Capture, Segmenter, bool]:
    return capture, scene_segmenter(capture, network), again


def _write_labels(prepared: tuple[Capture, Segmenter, bool], number: int) -> Iterator[tuple[int, int, int, int]]:
    """One frame's; yields how many were written and how many were there, and pixels: of the person, and unsure ones."""
    capture, segmenter, again = prepared
    capture.check_pictures(number)
    frame = replace(capture.pictures(number), keypoints=capture.keypoints(number))
    missing = [name for name in frame.images if again or name not in frame.labels]
    frame, person, unsure = labelled_by(segmenter, frame, missing), 0, 0
    for name in missing:
        on = frame.labels[name] > 0
        person, unsure = person + int(on.sum()), unsure + int((on & (frame.certainty[name] < 255 * UNSURE)).sum())
        write_image(capture.folder(number) / "labels" / f"{name}.png", frame.labels[name])
    yield len(missing), len(frame.images) - len(missing), person, unsure
