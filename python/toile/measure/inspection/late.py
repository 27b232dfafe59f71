"""Scans against the masks of the frames before and after: whether they were taken at another moment than the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from ...errors import UserError
from ...io.capture import Capture
from ...kernels.arrays import Anything
from ...scene import Frame
from ...surface.sampling import evenly
from ...vision.thin_pictures import thin_camera, thin_picture
from ...vision.visibility import DepthView
from ..evidence import overlap
from .cameras import Finding

STEPS = 3  # frames that scans may be late or early
FRAMES, VIEWS = 5, 3  # whose scans are looked at, and cameras of each
SIDE = 256  # px, longer side, to which masks are thinned for this
BETTER = 0.008  # of overlap, by which the masks of another frame must fit better


def out_of_step(capture: Capture, frames: Sequence[Frame], among: Sequence[int] | None = None) -> list[Finding]:
    """Scans that the masks of other frames fit better than those of their own, all of them by the same number of frames that have masks.
    `among`: rising numbers of those whose masks may be read, by default all."""
    masked = [number for number in among or capture.frames if len(capture.masked(number)) > 1]
    scanned = [frame for frame in frames if frame.scan is not None and frame.number in masked]
    fits = [_fits(capture, frame, masked) for frame in evenly(scanned, FRAMES)] if scanned else []
    best, gained = 0, BETTER
    for step in range(-STEPS, STEPS + 1):
        gains = [of[step] - of[0] for of in fits if step in of and 0 in of]
        if len(gains) > 1 and min(gains) > 0 and median(gains) > gained:
            best, gained = step, median(gains)
    if not best:
        return []
    own, other = (median(of[step] for of in fits if best in of and 0 in of) for step in (0, best))
    many = f"{abs(best)} frame{'s' if abs(best) > 1 else ''}"
    text = f"scans: they fit the masks of {many} {'earlier' if best < 0 else 'later'} better ({other:.3f}) than their own ({own:.3f})"
    return [Finding(f"{text}: are they {many} {'late' if best < 0 else 'early'}?", serious=False)]


def _fits(capture: Capture, frame: Frame, masked: list[int]) -> dict[int, float]:
    """{step: mean overlap of a scan's silhouette with the masks of the frame so many frames on in `masked`}, where all are there."""
    assert frame.scan is not None
    names = evenly(sorted(capture.masked(frame.number)), VIEWS)
    cameras = [thin_camera(capture.cameras[name], SIDE) for name in names]
    shown = [DepthView(camera, frame.scan.vertices, frame.scan.faces).face >= 0 for camera in cameras]
    found, own = {}, masked.index(frame.number)
    for step in range(max(-STEPS, -own), min(STEPS, len(masked) - 1 - own) + 1):
        masks = [_mask(capture, masked[own + step], name) for name in names]
        if all(mask is not None for mask in masks):
            found[step] = sum(overlap(one, mask) for one, mask in zip(shown, masks)) / len(names)
    return found


def _mask(capture: Capture, number: int, name: str) -> Anything | None:
    """A camera's thinned mask of a frame; None where there is none that can be read."""
    try:
        path = capture.picture_files(number, "masks").get(name)
        mask = None if path is None else capture.picture("masks", name, path) > 127
    except UserError:
        return None
    return thin_picture(mask, SIDE) if mask is not None and mask.any() else None
