"""Label images by a network, written for pictures that have none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..config.triangulation import ReconstructSettings
from ..frame_numbers import evenly
from ..io.body import model_in_capture
from ..io.capture import Capture
from ..io.image import write_image
from ..measure.inspection.clothed import posed_body
from ..scene import BodyModel, Frame
from ..stages.reconstruct import triangulate
from ..vision.evidence import depth_views
from ..vision.limb_colours import LimbCloth, limb_cloth, parts_of, retold
from ..vision.segmenters.asked import labelled_by, scene_segmenter
from ..vision.segmenters.network import Segmenter
from .workers import Workers, check_workers, everywhere

SAMPLED = 3  # frames that tell what the network takes for skin
UNSURE = 0.5  # certainty below which a pixel of the person is said to be unsure


@dataclass(frozen=True)
class Written:
    """How many label images were written and how many were there, the share of the person's pixels in those written that are
    unsure, and what is said of cloth that the network took for skin."""

    written: int
    kept: int
    unsure: float
    taken: str | None


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
    network in a file. Where keypoints pose the body, legs that it calls skin are told again, as `register` does. `workers`,
    `scheduler`: see `Workers`."""
    check_workers(workers, scheduler)
    capture, network = replace(capture, root=everywhere(capture.root, scheduler)), everywhere(Path(network), scheduler)
    busy, counts = min(workers, max(len(frames), 1)), np.zeros(4, np.int64)
    lacking = again or any(set(capture.pictured(number)) - set(capture.labelled(number)) for number in frames)
    # of all frames: the same for a command that was stopped
    cloth = _cloth(capture, network, frames) if lacking else None
    with Workers(busy, Labelling.of, capture, network, again, cloth, scheduler=scheduler) as pool:
        pool.prepared()
        for done, found in enumerate(pool.each(_write_labels, frames), 1):
            counts += found
            if progress is not None:
                progress("labels", done, len(frames))
    written, kept, person, unsure = counts.tolist()
    taken = None if cloth is None else cloth.words(capture.scene)
    return Written(written, kept, unsure / max(person, 1), taken)


@dataclass(frozen=True)
class Labelling:
    """What the frames of a capture are labelled with."""

    capture: Capture
    segmenter: Segmenter
    model: BodyModel
    again: bool
    cloth: LimbCloth | None

    @classmethod
    def of(cls, capture: Capture, network: Path, again: bool, cloth: LimbCloth | None) -> Labelling:
        """As each process makes it."""
        model = model_in_capture(capture.root, capture.scene.body_model, capture.scene.up)
        return cls(capture, scene_segmenter(capture, network), model, again, cloth)

    def views(self, frame: Frame, names: Sequence[str]) -> dict[str, Any]:
        """What these cameras show of the body, as keypoints pose it; none where they do not."""
        if frame.keypoints is None and frame.points3d is None:
            return {}
        points = frame.points3d or triangulate(frame.keypoints, self.capture.cameras, ReconstructSettings())
        fit = posed_body(self.model, frame, points)
        return {} if fit is None else depth_views(names, self.capture.cameras, np.asarray(fit.V), self.model.f)


def _frame(capture: Capture, number: int) -> Frame:
    """A frame without its scan."""
    capture.check_pictures(number)
    told = {"keypoints": capture.keypoints(number), "points3d": capture.points3d(number)}
    return replace(capture.pictures(number), **told)


def _cloth(capture: Capture, network: Path, frames: Sequence[int]) -> LimbCloth | None:
    """What the network takes for skin in some of the frames, whatever label images they have."""
    own = Labelling.of(capture, network, True, None)

    def shown() -> Iterator[tuple[Frame, dict[str, Any]]]:  # asked for only where the scene names what covers the legs
        for number in evenly(frames, SAMPLED):
            frame = replace(_frame(capture, number), labels={})
            if views := own.views(frame, list(frame.images)):
                yield labelled_by(own.segmenter, frame, list(frame.images)), views

    return limb_cloth(capture.scene, parts_of(own.model), own.model.f, shown())


def _write_labels(own: Labelling, number: int) -> Iterator[tuple[int, int, int, int]]:
    """One frame's; yields how many were written and how many were there, and pixels: of the person, and unsure ones."""
    frame = _frame(own.capture, number)
    missing = [name for name in frame.images if own.again or name not in frame.labels]
    frame, person, unsure = labelled_by(own.segmenter, frame, missing), 0, 0
    if own.cloth is not None and missing:
        frame = retold(frame, own.views(frame, missing), own.model.f, own.cloth)
    for name in missing:
        on = frame.labels[name] > 0
        person, unsure = person + int(on.sum()), unsure + int((on & (frame.certainty[name] < 255 * UNSURE)).sum())
        write_image(own.capture.folder(number) / "labels" / f"{name}.png", frame.labels[name])
    yield len(missing), len(frame.images) - len(missing), person, unsure
