"""The page of an inspection: one line a problem, then what the cameras see, with what the others say drawn over it."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...io.files import write_text
from ...scene import Frame
from ..page import cards, document, figure, table
from . import Inspection
from .rays import SURE

WIDE = 320  # pixels of a picture on the page
DETECTED, SAID, OUTLINE = (215, 40, 40), (40, 200, 90), (255, 200, 0)


def write_inspection(found: Inspection, out: Path, title: str) -> Path:
    """Writes one self-contained HTML page."""
    lines = "".join(
        f"<li class='{'why' if f.serious else ''}'>{'<b>stops:</b> ' if f.serious else ''}{html.escape(f.text)}</li>"
        for f in found.findings
    )
    body = f"<ul>{lines}</ul>" if lines else "<p>Nothing was found to be wrong.</p>"
    parts = [cards(found.facts), "<h2>What is wrong</h2>", body]
    if found.frames:
        parts.append(
            "<h2>What the cameras see</h2><p class='soft'>Detected keypoints are red, where the other cameras say they are "
            "green; the mask's outline is yellow.</p>"
        )
        parts += [_row(found, frame) for frame in found.frames[:3]]
    if found.doubted and found.capture is not None:
        parts.append(f"<h2>What the labels say</h2><p class='soft'>{_legend(found.capture.scene.labels)}</p>")
        parts += [_labels_row(found.capture.scene.labels, frame) for frame in found.doubted]
    if found.lines is not None and found.sighting is not None:
        names = [camera.name for camera in found.sighting.cameras]
        rows = [[name, *(None if np.isnan(v) else float(v) for v in row)] for name, row in zip(names, found.lines)]
        parts.append(
            "<h2>Distance from epipolar lines [px]</h2><p class='soft'>A row's detections against a column's.</p>"
        )
        parts.append(f"<div class='sheet'>{table(['camera', *names], rows)}</div>")
    if found.hulls:
        rows = [[name, 100 * whole, 100 * rest] for name, (whole, rest) in found.hulls.items()]
        parts.append("<h2>Visual hull</h2>")
        parts.append(table(["camera", "its mask covered %", "others' masks covered without it %"], rows))
    if any(found.labels.values()):
        cameras = list(dict.fromkeys(camera for seen in found.labels.values() for camera in seen))
        rows = [[name, *(seen.get(camera) for camera in cameras)] for name, seen in found.labels.items()]
        parts.append(f"<h2>Labels seen, of {len(found.frames)} frames</h2>")
        parts.append(f"<div class='sheet'>{table(['label', *cameras], rows)}</div>")
    write_text(out, document(f"Inspection of {title}", "".join(parts)))
    return out


def _row(found: Inspection, frame: Frame) -> str:
    figures = "".join(figure(_overlay(found, frame, name, image), name) for name, image in frame.images.items())
    return f"<div class='frame'><h3>frame {frame.number}</h3><div class='row'>{figures}</div></div>"


def _legend(labels: Mapping[str, int]) -> str:
    """The labels' names in their colours."""
    named = (
        f"<span style='border-left: 1em solid rgb{_colour(labels, number)}; padding: 0 1em 0 .4em'>{html.escape(name)}</span>"
        for name, number in labels.items()
    )
    return "".join(named)


def _labels_row(labels: Mapping[str, int], frame: Frame) -> str:
    figures = "".join(figure(_painted(labels, frame, name), name) for name in frame.labels)
    return f"<div class='frame'><h3>frame {frame.number}</h3><div class='row'>{figures}</div></div>"


def _painted(labels: Mapping[str, int], frame: Frame, name: str) -> Any:
    """A picture (h,WIDE,3), or grey without one, in the colours of its labels."""
    import cv2

    given = frame.labels[name]
    image = frame.images.get(name, np.full((*given.shape, 3), 128, np.uint8))
    table = np.zeros((256, 3), np.uint8)
    for number in labels.values():
        table[number] = _colour(labels, number)
    shown = np.where(given[..., None] > 0, image // 2 + table[given] // 2, image // 3)
    return cv2.resize(shown, None, fx=WIDE / shown.shape[1], fy=WIDE / shown.shape[1], interpolation=cv2.INTER_AREA)


def _colour(labels: Mapping[str, int], number: int) -> tuple[int, int, int]:
    """Of a label, evenly round the wheel."""
    import colorsys

    order = sorted(set(labels.values()))
    r, g, b = colorsys.hsv_to_rgb(order.index(number) / len(order), 0.75, 1.0)
    return int(255 * r), int(255 * g), int(255 * b)


def _overlay(found: Inspection, frame: Frame, name: str, image: Any) -> Any:
    """A picture (h,WIDE,3) with its mask's outline and its points."""
    import cv2

    scale = WIDE / image.shape[1]
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if name in frame.masks:
        contours, _ = cv2.findContours(frame.masks[name].astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.polylines(small, [np.round(c * scale).astype(np.int32) for c in contours], True, OUTLINE, 1)
    if found.sighting is None or found.meeting is None:
        return small
    index = {camera.name: i for i, camera in enumerate(found.sighting.cameras)}.get(name)
    t = frame.number - found.first
    if index is None or not 0 <= t < found.sighting.uv.shape[1] or found.sighting.names == ("middle",):
        return small
    uv, seen = found.sighting.uv[index, t], found.sighting.weight[index, t] > SURE
    said = uv - found.meeting.residual[index, t]
    for point in said[seen & np.isfinite(said).all(1)]:
        cv2.circle(small, _pixel(point, scale), 3, SAID, 1, cv2.LINE_AA)
    for point in uv[seen]:
        cv2.circle(small, _pixel(point, scale), 2, DETECTED, -1, cv2.LINE_AA)
    return small


def _pixel(point: Any, scale: float) -> tuple[int, int]:
    return int(np.clip(point[0] * scale, -1e4, 1e4)), int(np.clip(point[1] * scale, -1e4, 1e4))
