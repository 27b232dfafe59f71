"""Pictures of one frame: what a camera captured with the registered outline over it, the scan and the layers from two views."""

from __future__ import annotations

import base64
import io
from dataclasses import replace

import numpy as np
from PIL import Image

from ... import kernels
from ...errors import UserError
from ...vision.visibility import DepthView
from ..page import heat
from ..rendering import BODY, CLOTH, facing, joined, render

HEAT_MM = 10.0  # distance at the upper end of the colours
BARE = (186, 184, 180)  # of scans where nothing was registered
LONGEST = 900  # px of a captured picture that is drawn on
TALLEST = 460  # px of the part of it that is shown
MARGIN = 0.08  # about the person, of its extent
OUTLINES = ((70, 235, 255), (255, 64, 190), (255, 225, 40), (120, 255, 90), (255, 150, 60))  # body, then garments


def pictures(run, number, warn=lambda said: None) -> list[tuple[str, bytes]]:
    """[(caption, JPEG)] of a frame; of one that failed only what was captured. What the capture lacks is left out; `warn` hears of
    what can no more be read."""
    registered = number in set(run.ok)
    layers = _layers(run, number) if registered else []
    made = list(_captured(run, number, layers, warn))
    try:
        scan = run.capture.scan(number)
    except UserError as error:
        scan = None
        warn(str(error))
    up = run.scene.up
    angle = facing(run.pose.rotations.at(number)[0], up) if registered else 0.0
    box = np.concatenate([V for V, _, _ in layers]) if layers else None
    seen = [] if scan is None else [(scan.vertices, scan.faces, _distances(scan, layers))]
    for side, turn in (("front", 0.0), ("back", np.pi)):
        if seen:
            made.append((f"scan, {side}", render(seen, angle + turn, up, about=box)))
        if layers:
            made.append((f"registered, {side}", render(layers, angle + turn, up, about=box)))
    return [(caption, jpeg(picture)) for caption, picture in made]


def _layers(run, number):
    """[(V, F, colour)]: the body, under the garments where there are some, and these."""
    body = [(run.body.at(number), run.body_model.skin_faces, BODY)]
    worn = enumerate(run.garments.values())
    return body + [(garment.at(number), garment.faces, CLOTH[i % len(CLOTH)]) for i, garment in worn]


def _distances(scan, layers):
    """Colours (m,3) of the scan's triangles by their distance to the nearest layer."""
    if not layers:
        return BARE
    V, F, _ = joined([layer[:2] for layer in layers])
    distance = kernels.SurfaceIndex(V, F).closest(scan.vertices)[3]
    return heat(distance[scan.faces].mean(1) * 1e3 / HEAT_MM)


def _captured(run, number, layers, warn):
    """(caption, picture) of up to two cameras that see the person largest, from opposite sides if there are such."""
    try:
        capture = run.capture
        files = capture.picture_files(number, "images")
    except UserError as error:
        warn(str(error))
        return
    V = np.concatenate([V for V, _, _ in layers]) if layers else np.zeros((0, 3))
    for name in _telling(capture.cameras, tuple(files), V):
        try:
            picture = capture.picture("images", name, files[name])
        except (UserError, OSError) as error:
            warn(str(error))
            continue
        yield name, _outlined(picture, capture.cameras[name], layers)


def _telling(cameras, names, V):
    """The camera in whose picture the person is largest, and of those that look the other way the one where it is."""
    if not len(V):
        return names[:1]
    size = {name: _area(cameras[name], V) for name in names}
    ranked = sorted((name for name in names if size[name] > 0), key=lambda name: -size[name])
    if not ranked:
        return names[:1]
    ways = {name: V.mean(0) - cameras[name].centre for name in ranked}
    other = [name for name in ranked if ways[name] @ ways[ranked[0]] < 0]
    return [*ranked[:1], *other[:1]]


def _area(camera, V):
    """Share of a picture that the box around the points V covers, 0 where they are behind the camera."""
    at, depth = camera.project(V)
    if (depth <= 0).any():
        return 0.0
    limits = np.array(camera.size[::-1], dtype=np.float64)
    return float(np.prod(np.ptp(np.clip(at, 0, limits), axis=0) / limits))


def _outlined(picture, camera, layers):
    """The part of a captured picture about the person, with the outline of each layer as far as it is seen."""
    step = -(-max(picture.shape[:2]) // LONGEST)
    height, width = (side // step for side in picture.shape[:2])
    small = np.array(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))
    if not layers:
        return small
    V, F, layer = joined([layer[:2] for layer in layers])
    scale = np.array([[width / camera.width], [height / camera.height], [1.0]])
    face = DepthView(replace(camera, K=camera.K * scale, width=width, height=height), V, F).face
    shown = np.where(face >= 0, layer[face], -1)
    for k in range(len(layers)):
        small[_border(shown == k)] = OUTLINES[k % len(OUTLINES)]
    return _cropped(small, shown >= 0)


def _border(inside):
    """Pixels of a mask that have a neighbour outside it, two pixels wide."""
    import cv2

    return inside & (cv2.erode(inside.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) == 0)


def _cropped(picture, covered):
    spans = []
    for axis, size in ((0, picture.shape[0]), (1, picture.shape[1])):
        at = np.flatnonzero(covered.any(1 - axis))
        if not len(at):
            return picture
        margin = int(MARGIN * (at[-1] - at[0]) + 4)
        spans.append(slice(max(at[0] - margin, 0), min(at[-1] + margin + 1, size)))
    return picture[spans[0], spans[1]]


def jpeg(picture) -> bytes:
    """A picture (H,W,3) uint8 as a JPEG, at most TALLEST pixels high."""
    image, out = Image.fromarray(picture), io.BytesIO()
    if image.height > TALLEST:
        image = image.resize((round(image.width * TALLEST / image.height), TALLEST), Image.Resampling.LANCZOS)
    image.save(out, "JPEG", quality=80)
    return out.getvalue()


def as_text(data: bytes) -> str:
    """The base64 of a file."""
    return base64.b64encode(data).decode()
