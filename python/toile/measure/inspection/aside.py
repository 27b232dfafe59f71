"""Scans against the outlines of masks: whether they lie aside as a whole, or masks are wider or narrower all around."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from ...frame_numbers import evenly
from ...kernels.arrays import Array, Floats
from ...scene import Camera, Frame, Mesh
from ...vision.thin_pictures import thin_camera, thin_picture
from ...vision.visibility import DepthView
from .cameras import Finding
from .outlines import outline

FRAMES, VIEWS = 3, 8  # whose scans are looked at, and cameras of each
FEWEST = 2  # cameras of a frame: one alone does not tell the way along its view
SIDE = 512  # px, longer side, to which masks are thinned for this
REACH = 0.15  # m: what of an outline lies farther from the scan's belongs to something else, or to a hole
NEAR = 0.8  # share of the outlines that must lie within: of a scan of a part nothing is told
SPREAD = 0.005  # m, from which on distances count as outliers do
EXPLAINED = 0.6  # of the mean distance between outlines, that may be left
OFF, ODD = 0.012, 4  # m, and times what is usual of all cameras: a camera whose outlines lie off
ASIDE, WIDE, LARGER = 0.015, 0.025, 0.015  # m, m, 1


class Fit(NamedTuple):
    """How a scan lies against the masks of its frame: moved `aside` (3,) of them [m], larger about its middle by the share `larger`,
    and narrower all around by `wide` [m]; `left`: share of the mean distance between their outlines that this does not explain;
    `off`: {camera: how far outside of the scan's outline its mask's runs in the mean [m]}; a scan of other things too has no part in it."""

    aside: Floats
    larger: float
    wide: float
    left: float
    off: dict[str, float]


def displaced(cameras: Mapping[str, Camera], frames: Sequence[Frame]) -> list[Finding]:
    """Single cameras whose masks (or label images) lie off the scans; or else scans that are larger or smaller than the masks show, or lie
    aside of them, or masks that are wider or narrower than the scans all around, in all of the frames that are looked at alike."""
    scanned = [frame for frame in frames if frame.scan is not None and any(m.any() for m in frame.silhouettes.values())]
    fits = [fit for frame in (evenly(scanned, FRAMES) if scanned else []) if (fit := _fit(cameras, frame)) is not None]
    shown = "masks" if any(frame.masks for frame in scanned) else "label images"
    found = _of_single_cameras(fits, shown)
    if found or not fits or max(fit.left for fit in fits) > EXPLAINED:
        return found
    aside, wide = np.median([fit.aside for fit in fits], axis=0), median(fit.wide for fit in fits)
    far, larger = float(np.linalg.norm(aside)), median(fit.larger for fit in fits)
    if min(fit.larger * np.sign(larger) for fit in fits) > LARGER:
        how = "larger" if larger > 0 else "smaller"
        text = f"scans: they are {100 * abs(larger):.1f} % {how} than the {shown} show"
        return [Finding(f"{text}: are scans and cameras in the same units?", serious=False)]
    if min(float(fit.aside @ aside) for fit in fits) > ASIDE * far:
        where = ", ".join(f"{100 * value:+.1f}" for value in aside)
        text = f"scans: they lie {100 * far:.1f} cm aside of the {shown}, by ({where}) cm along x, y and z"
        found.append(Finding(f"{text}: is the calibration that of the scanner?", serious=False))
    if min(fit.wide * np.sign(wide) for fit in fits) > WIDE:
        text = f"{shown}: they are {'wider' if wide > 0 else 'narrower'} than the scans by {100 * abs(wide):.1f} cm all around"
        found.append(Finding(f"{text}: were they {'dilated' if wide > 0 else 'eroded'}?", serious=False))
    return found


def _of_single_cameras(fits: Sequence[Fit], shown: str) -> list[Finding]:
    """Cameras, of three and more, whose outlines lie off in all frames that show them, farther than is usual of the others."""
    off = {name: [fit.off[name] for fit in fits if name in fit.off] for fit in fits for name in fit.off}
    usual = median(median(of) for of in off.values()) if len(off) > FEWEST else np.inf
    return [
        Finding(
            f"{name}: the outlines of its {shown} run {100 * median(of):.1f} cm outside of the scans' in the mean, {100 * usual:.1f} in "
            "most cameras: are they mirrored, of another camera, or is its calibration off?",
            serious=False,
        )
        for name, of in off.items()
        if min(of) > max(OFF, ODD * usual)
    ]


def _fit(cameras: Mapping[str, Camera], frame: Frame) -> Fit | None:
    """Robust least squares of d = w - n . J (t + s (p - m)) over points p of the masks' outlines, n their normals, m the scan's middle,
    d [m] how far outside of the scan's outline they lie: t, s and w of `Fit`. None where too little of the outlines is near the scan's."""
    from scipy.optimize import least_squares

    assert frame.scan is not None
    masks = {name: mask for name, mask in frame.silhouettes.items() if mask.any()}
    told = {
        name: rows
        for name in evenly(sorted(masks), VIEWS)
        if (rows := _equations(thin_camera(cameras[name], SIDE), thin_picture(masks[name], SIDE), frame.scan))
    }
    if len(told) < FEWEST:
        return None
    A, d = (np.concatenate(part) for part in zip(*told.values()))
    near = np.abs(d) < REACH
    if near.mean() < NEAR:
        return None
    A, d = A[near], d[near]
    x = least_squares(lambda x: A @ x - d, np.zeros(5), lambda x: A, loss="soft_l1", f_scale=SPREAD).x
    left = float(np.abs(A @ x - d).mean() / max(np.abs(d).mean(), 1e-6))
    off = {name: float(np.clip(rows[1], 0, REACH).mean()) for name, rows in told.items()}
    return Fit(x[:3], float(x[3]), float(x[4]), left, off)


def _equations(camera: Camera, mask: Array, scan: Mesh) -> tuple[Floats, Floats] | None:
    """Rows (k,5) and right sides (k,) [m] of points on a mask's outline, at the scan's depth; None where either is not in the picture."""
    import cv2

    view, line = DepthView(camera, scan.vertices, scan.faces), outline(mask)
    scanned = (view.face >= 0).astype(np.uint8)
    if line is None or not scanned.any():
        return None
    at, n = line[0][0], -line[1]  # outwards
    inside, outside = (cv2.distanceTransform(of, cv2.DIST_L2, 5) for of in (scanned, 1 - scanned))
    depth = float(np.median(view.depth[scanned > 0]))
    pixel = depth / camera.K[0, 0]  # m
    x, y = at.astype(int).T
    d = np.where(scanned[y, x] > 0, 1 - inside[y, x], outside[y, x]) * pixel  # outlines run half a pixel outside
    uv = (at + 0.5 - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    R = camera.T_camera_world[:3, :3]
    J = n @ R[:2] - (n * uv).sum(1, keepdims=True) * R[2]
    p = depth * np.c_[uv, np.ones(len(uv))] - camera.to_camera(np.median(scan.vertices, axis=0))
    return np.c_[-J, -(J * (p @ R)).sum(1), np.ones(len(J))], d
