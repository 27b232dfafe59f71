"""Scans, pictures and label images against the masks of the frames before and after: whether they, or single cameras, were taken at
another moment."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from statistics import mean, median, median_low
from typing import NamedTuple

import numpy as np

from ...errors import UserError
from ...frame_numbers import evenly
from ...io.capture import Capture
from ...kernels.arrays import Anything
from ...scene import Frame
from ...vision.thin_pictures import thin_camera, thin_picture
from ...vision.visibility import DepthView
from ..evidence import overlap
from .cameras import Finding
from .masks import overlap_aside
from .outlines import clearness, outline

STEPS = 3  # frames that scans or cameras may be late or early, of those that have masks
FRAMES, VIEWS = 5, 8  # whose scans are looked at, and cameras of each
SIDE = 256  # px, longer side, to which masks are thinned for this
BETTER = 0.008  # of overlap, by which the masks of another frame must fit better
PICTURED, OUTLINES = 3, 512  # frames whose pictures are looked at, and px, longer side, to which those are thinned
CLEARER = 0.02  # share of the contrast across outlines, by which that of another frame's masks must be larger


def out_of_step(capture: Capture, frames: Sequence[Frame], among: Sequence[int] | None = None) -> list[Finding]:
    """Scans that the masks of other frames fit better than those of their own, all of them by as many frame numbers; or else single
    cameras whose masks of other frames do, also where a scan that lies aside is moved upon them. `among`: rising numbers of the
    frames whose masks may be read, by default all."""
    masked = [number for number in (capture.frames if among is None else among) if len(capture.masked(number)) > 1]
    scanned = [frame for frame in frames if frame.scan is not None and frame.number in masked]
    views = [_views(capture, frame, masked) for frame in evenly(scanned, FRAMES)] if scanned else []
    fits = [{name: _fits(view, overlap) for name, view in of.items()} for of in views]
    if step := _better([_together(of) for of in fits]):
        text = f"scans: they fit the masks of {step.words} better ({step.other:.3f}) than their own ({step.own:.3f})"
        return [Finding(f"{text}: are they {step.many} {'late' if step.frames < 0 else 'early'}?", serious=False)]
    found = []
    for name in sorted({name for of in fits for name in of}):
        step = _better([of[name] for of in fits if name in of])
        aside = _better([_fits(of[name], overlap_aside) for of in views if name in of]) if step else None
        if step and aside and aside.frames == step.frames:
            text = f"{name}: its masks of {step.words} fit the scans better ({step.other:.3f}) than its own ({step.own:.3f})"
            ask = f"is it {step.many} {'ahead' if step.frames < 0 else 'late'}?"
            found.append(Finding(f"{text}: {ask} If so import with --offset {name}={step.frames}", serious=False))
    return found


def pictures_out_of_step(capture: Capture, frames: Sequence[Frame]) -> list[Finding]:
    """Images and label images that the masks of other frames fit better than those of their own, in all cameras and frames that are
    looked at by as many frame numbers."""
    masked = [number for number in capture.frames if len(capture.masked(number)) > 1]
    looked = [frame for frame in frames if frame.number in masked]
    looked = evenly(looked, PICTURED) if looked else []
    masks = {frame.number: _masks(capture, frame, masked, VIEWS, OUTLINES) for frame in looked}
    found = []
    for kind, fits, least in (("label images", _labels_fit, BETTER), ("images", _outlines_fit, CLEARER)):
        told = [
            {name: fit for name, of in masks[frame.number].items() if (fit := fits(frame, name, of))}
            for frame in looked
        ]
        if step := _better([_together(of) for of in told if of], least):
            text = f"{kind}: the masks of {step.words} fit them better than their own"
            ask = f"are they {step.many} {'late' if step.frames < 0 else 'early'}?"
            found.append(Finding(f"{text}: {ask}", serious=False))
    return found


class Lag(NamedTuple):
    """Masks of `frames` numbers later (earlier: negative) overlap scans by `other`, those of their own frames by `own`, in the median."""

    frames: int
    own: float
    other: float

    @property
    def many(self) -> str:
        return f"{abs(self.frames)} frame{'s' if abs(self.frames) > 1 else ''}"

    @property
    def words(self) -> str:
        return f"{self.many} {'earlier' if self.frames < 0 else 'later'}"


def _better(fits: Sequence[Mapping[int, float]], least: float = BETTER) -> Lag | None:
    """The step by which the masks fit better than a frame's own, by more than `least`, in all of several frames {step: overlap} that
    know it, at least 0."""
    best, gained = 0, least
    for step in sorted({step for of in fits for step in of}):
        gains = [of[step] - of[0] for of in fits if step in of]
        if len(gains) > 1 and min(gains) >= 0 and median(gains) > gained:
            best, gained = step, median(gains)
    if not best:
        return None
    own, other = (median(of[step] for of in fits if best in of) for step in (0, best))
    return Lag(best, own, other)


def _together(fits: Mapping[str, Mapping[int, float]]) -> dict[int, float]:
    """{step: mean overlap over the cameras} of {camera: {step: overlap}}, where all of them know it."""
    common = set.intersection(*(set(of) for of in fits.values())) if fits else set()
    return {step: mean(of[step] for of in fits.values()) for step in common}


class Compared(NamedTuple):
    """A scan's silhouette in a camera (H,W), and {step: the camera's mask of the frame whose number is by so much higher}."""

    shown: Anything
    masks: dict[int, Anything]


def _views(capture: Capture, frame: Frame, masked: list[int]) -> dict[str, Compared]:
    """{camera: Compared} of some of the cameras that show the person in the frame."""
    assert frame.scan is not None
    found = {}
    for name, masks in _masks(capture, frame, masked, VIEWS, SIDE).items():
        shown = DepthView(thin_camera(capture.cameras[name], SIDE), frame.scan.vertices, frame.scan.faces).face >= 0
        found[name] = Compared(shown, masks)
    return found


def _masks(capture: Capture, frame: Frame, masked: list[int], views: int, most: int) -> dict[str, dict[int, Anything]]:
    """{camera: {step: its mask of the frame whose number is by so much higher}}, thinned to a side of `most` [px], of some of the cameras
    that show the person in the frame; masks that cannot be read are left out."""
    apart = median_low([later - number for number, later in pairwise(masked)] or [1])
    steps = [k * apart for k in range(-STEPS, STEPS + 1) if frame.number + k * apart in masked]
    found = {}
    for name in evenly(sorted(capture.masked(frame.number)), views):
        masks = {step: _mask(capture, frame.number + step, name, most) for step in steps}
        if masks[0] is not None:
            found[name] = {step: mask for step, mask in masks.items() if mask is not None}
    return found


def _labels_fit(frame: Frame, name: str, masks: Mapping[int, Anything]) -> dict[int, float]:
    """{step: overlap of what a camera's label image shows with that mask}; {} where it shows nothing."""
    if name not in frame.labels or not frame.labels[name].any():
        return {}
    shown = thin_picture(frame.labels[name] > 0, OUTLINES)
    return {step: float(overlap(shown, mask)) for step, mask in masks.items()}


def _outlines_fit(frame: Frame, name: str, masks: Mapping[int, Anything]) -> dict[int, float]:
    """{step: logarithm of how many times the contrast of a camera's image across the mask's outline is that beside it}."""
    if name not in frame.images:
        return {}
    image = thin_picture(frame.images[name], OUTLINES)
    lines = {step: outline(mask) for step, mask in masks.items() if mask.shape == image.shape[:2]}
    lines = {step: line for step, line in lines.items() if line is not None}
    if 0 not in lines:
        return {}
    clear = np.log(np.maximum(clearness(image, [*lines.values()]), 1e-6))
    return {step: float(value) for step, value in zip(lines, clear)}


def _fits(view: Compared, overlap: Callable[[Anything, Anything], float]) -> dict[int, float]:
    """{step: overlap of the silhouette with that mask}."""
    return {step: float(overlap(view.shown, mask)) for step, mask in view.masks.items()}


def _mask(capture: Capture, number: int, name: str, most: int) -> Anything | None:
    """A camera's thinned mask of a frame; None where there is none that can be read."""
    try:
        path = capture.picture_files(number, "masks").get(name)
        mask = None if path is None else capture.picture("masks", name, path) > 127
    except UserError:
        return None
    return thin_picture(mask, most) if mask is not None and mask.any() else None
