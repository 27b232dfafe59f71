"""Scans against masks, read another way than they are given: mirrored, turned by half a turn, or through lenses of another
distortion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from statistics import median

import numpy as np

from ...frame_numbers import evenly
from ...io.capture import Capture
from ...kernels.arrays import Anything, Array
from ...scene import Camera, Frame, Mesh
from ...surface.thinning import thinned
from ...vision.thin_pictures import thin_camera, thin_picture
from ...vision.visibility import DepthView
from .cameras import Finding
from .masks import overlap_aside

FRAMES, VIEWS = 3, 4  # that are looked at, and cameras of each
SIDE = 256  # px, longer side, to which masks are thinned for this
DENSE = 200_000  # faces: a scan of more is thinned
SPACING = 0.005  # m, of what is left of it: a pixel shows about a centimetre
NEAR = 0.03  # of a mask's height, about it: farther away floors and clutter are no part of the person
BENDS = (-0.5, -0.4, -0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3, 0.4, 0.5)  # added to k1
ZOOMS = (0.96, 0.97, 0.98, 0.99, 1.0, 1.01, 1.02, 1.03, 1.04)  # of the focal length, as narrow or wide masks ask for
DISTORTED = 0.0065  # of overlap, by which another distortion must fit better than any focal length
PLACED = 0.02  # of overlap, by which the mirrored or turned scan must fit better
FITS = 0.8  # of overlap, that another reading must reach: a scan that lies aside fits none

Reading = tuple[str, float]  # what is read otherwise, and how
Fits = list[dict[Reading, float]]  # overlaps, a frame each
AS_GIVEN: Reading = ("bend", 0.0)
SHARES = (0.0, 1.0)  # of the way from the origin to the scan's own middle, about which it is mirrored or turned
MIRRORS: list[Reading] = [(f"mirrored along {axis}", share) for axis in "xyz" for share in SHARES]
TURNS: list[Reading] = [(f"turned by 180 degrees about {axis}", share) for axis in "xyz" for share in SHARES]


def misread(cameras: Mapping[str, Camera], frames: Sequence[Frame]) -> list[Finding]:
    """Scans that the masks (or label images) of all frames looked at fit clearly better if they are mirrored or turned by half a
    turn, which stops, or if the lenses have another distortion. Nothing of what is its own image, nor where scans or masks are missing."""
    seen = scanned([frame for frame in frames if any(mask.any() for mask in frame.silhouettes.values())])
    fits = [_fits(cameras, frame) for frame in seen]
    if not fits:
        return []
    shown = "masks" if any(frame.masks for frame in seen) else "label images"
    return _placed_scans(fits, shown) or _bent_lenses(fits, shown)


def scanned(frames: Sequence[Frame]) -> list[Frame]:
    """Those that are looked at, of the frames with scans."""
    found = [frame for frame in frames if frame.scan is not None]
    return evenly(found, FRAMES) if found else []


def with_outlines(capture: Capture, frame: Frame, most: int) -> Frame:
    """The frame with VIEWS of its masks, or where it has none of its label images, read and thinned as `thin_pictures` does."""
    kind, above = ("masks", 127) if capture.masked(frame.number) else ("labels", 0)
    files = capture.picture_files(frame.number, kind)
    read = lambda name: thin_picture(capture.picture(kind, name, files[name]) > above, most)
    return replace(frame, **{kind: {name: read(name) for name in (evenly(sorted(files), VIEWS) if files else ())}})


def _placed_scans(fits: Fits, shown: str) -> list[Finding]:
    """Scans that fit mirrored, or turned by half a turn; both are said where they fit alike, as of a pose that is its own mirror image."""
    gained = lambda reading: min(_gains(fits, reading))
    first, second = sorted((max(of, key=gained) for of in (MIRRORS, TURNS)), key=gained, reverse=True)
    own, better = (median(of[reading] for of in fits) for reading in (AS_GIVEN, first))
    if gained(first) <= PLACED or better <= FITS:
        return []
    alike = gained(first) - gained(second) <= PLACED
    how = f"{first[0]} or {second[0]}" if alike else first[0]
    text = f"scans: {how} they fit the {shown} better ({better:.3f}) than as they are ({own:.3f})"
    return [Finding(f"{text}: are scans and cameras in the same axes?")]


def _bent_lenses(fits: Fits, shown: str) -> list[Finding]:
    """The distortion must be the best of those on either side of it, and better than any focal length."""
    bend = max(BENDS, key=lambda k: median(_gains(fits, ("bend", k))))
    own, better = (median(of[reading] for of in fits) for reading in (AS_GIVEN, ("bend", bend)))
    beyond = [of["bend", bend] - max(of["zoom", zoom] for zoom in ZOOMS) for of in fits]
    if bend in (BENDS[0], BENDS[-1]) or min(beyond) <= 0 or median(beyond) <= DISTORTED or better <= FITS:
        return []
    text = f"scans: they fit the {shown} better ({better:.3f}) if k1 of the lenses' distortion is {bend:+.1f} more than in cameras.json ({own:.3f})"
    why = "is it left out there?" if bend < 0 else "were these pictures undistorted?"
    return [Finding(f"{text}: {why}", serious=False)]


def _gains(fits: Fits, reading: Reading) -> list[float]:
    """By how much each frame's masks are fitted better than as scan and cameras are given."""
    return [of[reading] - of[AS_GIVEN] for of in fits]


def _fits(cameras: Mapping[str, Camera], frame: Frame) -> dict[Reading, float]:
    """{reading: mean overlap of the scan's silhouette with the masks, near these}."""
    assert frame.scan is not None
    masks = {name: mask for name, mask in frame.silhouettes.items() if mask.any()}
    views = [
        (thin_camera(cameras[name], SIDE), thin_picture(masks[name], SIDE)) for name in evenly(sorted(masks), VIEWS)
    ]
    scan = thinned(frame.scan, SPACING if len(frame.scan.faces) > DENSE else 0)
    found: dict[Reading, float] = {}
    for reading, read, change in _readings(scan):
        found[reading] = float(np.mean([_overlap(change(camera), mask, read) for camera, mask in views]))
    return found


def _readings(scan: Mesh) -> Iterator[tuple[Reading, Mesh, Callable[[Camera], Camera]]]:
    """(reading, the scan, what becomes of a camera)."""
    for bend in BENDS:
        yield ("bend", bend), scan, partial(_bent, k=bend)
    for zoom in ZOOMS:
        yield ("zoom", zoom), scan, partial(_zoomed, zoom=zoom)
    for reading in (*MIRRORS, *TURNS):
        yield reading, _placed(scan, reading), lambda camera: camera


def _bent(camera: Camera, k: float) -> Camera:
    return replace(camera, distortion=camera.distortion + k * np.eye(5)[0])


def _zoomed(camera: Camera, zoom: float) -> Camera:
    return replace(camera, K=camera.K * [[zoom, zoom, 1], [zoom, zoom, 1], [1, 1, 1]])


def _placed(scan: Mesh, reading: Reading) -> Mesh:
    """With one axis turned about, or both others, at a share of the way from the origin to the median of its vertices."""
    (words, share), V = reading, scan.vertices.copy()
    mirrored, axes = reading in MIRRORS, np.arange(3) == "xyz".index(words[-1])
    flipped = axes if mirrored else ~axes
    V[:, flipped] = 2 * share * np.median(V[:, flipped], axis=0) - V[:, flipped]
    return Mesh(V, np.ascontiguousarray(scan.faces[:, ::-1]) if mirrored else scan.faces)


def _overlap(camera: Camera, mask: Array, scan: Mesh) -> float:
    """Of a scan's silhouette with a mask, within NEAR of it."""
    import cv2

    reach = max(2, round(NEAR * float(mask.any(1).sum())))
    box = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    near: Anything = cv2.dilate(mask.astype(np.uint8), box) > 0
    shown = DepthView(camera, scan.vertices, scan.faces).face >= 0
    return overlap_aside(shown & near, mask)
