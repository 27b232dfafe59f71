"""Label images by the scene's network, for pictures that have none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..io.capture import Capture
from ..io.image import write_image
from ..io.scene_file import network_files
from ..vision.segmenters.network import Segmenter
from ..vision.threads import parallel_map
from .workers import Workers, check_workers, everywhere

UNSURE = 0.5  # certainty below which a pixel of the person is said to be unsure


def labelled(capture: Capture, frame: Any) -> Any:
    """The Frame with labels, and how sure they are, of all its pictures; itself where the scene names no network."""
    missing = [name for name in frame.images if name not in frame.labels]
    if not capture.scene.segmenter or not capture.scene.garments or not missing:
        return frame
    return _labelled(frame, missing, scene_segmenter(capture))


def _labelled(frame: Any, missing: Sequence[str], segmenter: Segmenter) -> Any:
    found = parallel_map(lambda name: segmenter.label(frame.images[name], frame.masks.get(name)), missing)
    labels = {name: label for name, (label, _) in zip(missing, found)}
    sure = {name: certainty for name, (_, certainty) in zip(missing, found)}
    return replace(frame, labels=frame.labels | labels, certainty=frame.certainty | sure)


def scene_segmenter(capture: Capture, name: str | Path | None = None) -> Segmenter:
    """The network of this file, or that scene.toml names. UserError: it gives a garment's label to no class."""
    path = capture.root / network_files(capture.root, capture.scene.segmenter)[0] if name is None else Path(name)
    if not capture.scene.labels:
        raise UserError(f"{capture.root / 'scene.toml'}: labels: none that {path.name} could give")
    segmenter = _opened(path, tuple(sorted(capture.scene.labels.items())))
    for garment in capture.scene.garments:
        if capture.scene.labels[garment.label] not in segmenter.about.ids:
            raise UserError(
                f"{path.with_suffix('.toml')}: labels: no class is called '{garment.label}', the label of garment "
                f"{garment.name}"
            )
    return segmenter


@lru_cache(maxsize=2)
def _opened(path: Path, labels: tuple[tuple[str, int], ...]) -> Segmenter:
    return Segmenter(path, dict(labels))


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
    frame = capture.pictures(number)
    missing = [name for name in frame.images if again or name not in frame.labels]
    frame, person, unsure = _labelled(frame, missing, segmenter), 0, 0
    for name in missing:
        on = frame.labels[name] > 0
        person, unsure = person + int(on.sum()), unsure + int((on & (frame.certainty[name] < 255 * UNSURE)).sum())
        write_image(capture.folder(number) / "labels" / f"{name}.png", frame.labels[name])
    yield len(missing), len(frame.images) - len(missing), person, unsure
