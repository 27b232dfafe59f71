"""The labels that the network of a capture's scene gives, for pictures that have no label image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...errors import UserError
from ...io.capture import Capture
from ...io.scene_file import network_files
from ..threads import parallel_map
from .limbs import limbs_of
from .network import Segmenter


def labelled(capture: Capture, frame: Any) -> Any:
    """The Frame with labels, and how sure they are, of all its pictures; itself where the scene names no network."""
    missing = [name for name in frame.images if name not in frame.labels]
    if not capture.scene.segmenter or not capture.scene.garments or not missing:
        return frame
    return labelled_by(scene_segmenter(capture), frame, missing)


def labelled_by(segmenter: Segmenter, frame: Any, names: Sequence[str]) -> Any:
    """The Frame with a network's labels, and how sure they are, of the pictures of these cameras; where these have keypoints
    and no mask, keypoints help to find the person."""
    keypoints = frame.keypoints
    points = keypoints.points if keypoints is not None else {}
    limbs = {name: limbs_of(keypoints.names, rows) for name, rows in points.items()}
    found = parallel_map(
        lambda name: segmenter.label(frame.images[name], frame.masks.get(name), limbs.get(name)), names
    )
    labels = {name: label for name, (label, _) in zip(names, found)}
    sure = {name: certainty for name, (_, certainty) in zip(names, found)}
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
