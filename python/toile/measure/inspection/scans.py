"""Scans against themselves and against what the cameras see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...frame_numbers import evenly
from ...kernels import SurfaceIndex
from ...kernels.arrays import Anything
from ...kernels.geometry import face_normals
from ...scene import Camera, Frame, Mesh
from .cameras import Finding
from .masks import covered, within

PROBED = 2000  # faces of a scan
NEAR = 1e-3  # m, from a face, where a ray begins
TOLD = 0.5  # share of its faces that must have the scan on one side alone: of a scan from the front nothing is told
INWARDS = 0.3  # share of faces that look inwards; noise and webs leave less
# share of the masks that a scan covers, and of the scan that lies on them; floors and clutter lie off
COVERED, ON = 0.99, 0.9
SHORT = 1.0  # m: scans of a whole person are longer, even of one who sits
APART = 0.8  # of the masks: a scan that covers less is elsewhere


def inside_out(frames: Sequence[Frame]) -> list[Finding]:
    """Scans whose faces look inwards, as the worst of some frames shows it."""
    shares = {frame.number: inward_share(frame.scan) for frame in frames if frame.scan is not None}
    worst = max(shares, key=lambda number: shares[number], default=None)
    if worst is None or shares[worst] <= INWARDS:
        return []
    whole = shares[worst] > 1 - INWARDS
    text = f"scan.ply of frame {worst}: {100 * shares[worst]:.0f} % of its faces look inwards"
    return [Finding(f"{text}: {'turn them' if whole else 'make them look one way'}", serious=whole)]


def short(frames: Sequence[Frame]) -> list[Finding]:
    """Scans that are all so short that they show a part of the person, or a person in other units."""
    found = [frame.scan.vertices for frame in frames if frame.scan is not None]
    long = max((float(np.ptp(vertices, axis=0).max()) for vertices in found), default=np.inf)
    if long >= SHORT:
        return []
    text = f"scans: none of those looked at is longer than {long:.2g} m: is it in metres, and of the whole person?"
    return [Finding(text, serious=False)]


def inward_share(scan: Mesh) -> float:
    """Of the faces that have the scan in front of them on one side alone, those that have it before them; 0 where they are
    few."""
    pick = evenly(range(len(scan.faces)), PROBED)
    normals = face_normals(scan.vertices, scan.faces[pick])
    middles = scan.vertices[scan.faces[pick]].mean(1)
    real = np.linalg.norm(normals, axis=1) > 0.5
    index, middles, normals = SurfaceIndex(scan.vertices, scan.faces), middles[real], normals[real]
    ahead, behind = (index.occluded(middles, way, near=NEAR) for way in (normals, -normals))
    told = ahead != behind
    return float(ahead[told].mean()) if told.mean() > TOLD else 0.0


def astray(cameras: Mapping[str, Camera], frames: Sequence[Frame]) -> list[Finding]:
    """Scans that lie elsewhere than the masks say, as the worst frame shows it: both leave something of the other unexplained, which a
    scan with a hole or with a floor does not."""
    told = {}
    for frame in frames:
        shares = [
            share for name, mask in frame.silhouettes.items() if (share := _shares(cameras[name], mask, frame.scan))
        ]
        if shares:
            told[frame.number] = np.median(shares, axis=0)
    odd = {number: shares for number, shares in told.items() if shares[0] < COVERED and shares[1] < ON}
    if not odd:
        return []
    worst = min(odd, key=lambda number: odd[number][0])
    over, on = odd[worst]
    shown = "masks" if any(frame.masks for frame in frames) else "label images"
    text = f"scan.ply of frame {worst}: it covers {100 * over:.0f} % of the {shown}, and {100 * on:.0f} % of it lies on them"
    ask = "are scans and cameras in the same units and axes, and of the same moment?"
    return [Finding(f"{text}: {ask}", serious=bool(over < APART))]


def _shares(camera: Camera, mask: Anything, scan: Mesh | None) -> tuple[float, float] | None:
    """Share of a mask that a scan covers, and of the scan's vertices in the picture that lie on the mask, 0 where none is there;
    None without either."""
    if scan is None or not mask.any():
        return None
    step = float(np.median(np.linalg.norm(scan.vertices[scan.faces[:, 0]] - scan.vertices[scan.faces[:, 1]], axis=1)))
    uv, depth = camera.project(scan.vertices)
    shown = (depth > 0) & ((uv >= 0) & (uv < mask.shape[::-1])).all(1)
    on = float(within(mask, uv[shown], depth[shown]).mean()) if shown.any() else 0.0
    return covered(camera, mask, uv, depth, depth > 0, step), on
