"""How well a tracked surface explains what its frame shows, with or without truth: the scan, the keypoints, the masks."""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..scene import OBSERVED
from ..vision.visibility import DepthView

UNSEEN = 0.1  # a keypoint of less confidence counts as unseen


def evidence(frame, cameras, model, vertices, joints, confidence, outside):
    """The measures of one frame; None where the frame lacks what a measure compares with.

    vertices (n,3) tracked, joints (K,3), confidence (n,) as tracked, outside (n,) bool: what can be seen from without.
    observed: share of the outside vertices that the tracking found on the scan. surface_to_scan_mm: all outside vertices,
    hidden ones and those over the scan's holes too, to the scan's surface. scan_to_surface_mm: the scan's vertices, clutter
    too, to the tracked skin. keypoint_px: the model's keypoints to those detected, over all cameras together.
    silhouette_iou: of the tracked skin and the masks, mean over the cameras that have one and see her by either.
    """
    out = nothing() | {"observed": float((confidence[outside] == OBSERVED).mean())}
    if frame.scan is not None:
        scan, skin = frame.scan, kernels.SurfaceIndex(vertices, model.skin_faces)
        out["surface_to_scan_mm"] = _spread(1e3 * scan.index.closest(vertices[outside])[3], "mean")
        out["scan_to_surface_mm"] = _spread(1e3 * skin.closest(scan.vertices[np.unique(scan.faces)])[3], "mean")
    if frame.keypoints is not None:
        found = frame.keypoints
        pixels, _ = keypoint_errors(found.names, found.points, cameras, model, vertices, joints)
        out["keypoint_px"] = _spread(pixels, "median")
    if frame.masks:
        shown = {name: DepthView(cameras[name], vertices, model.skin_faces).face >= 0 for name in frame.masks}
        told = [overlap(shown[n], mask) for n, mask in frame.masks.items() if mask.any() or shown[n].any()]
        out["silhouette_iou"] = float(np.mean(told)) if told else None
    return out


def nothing():
    """The measures of a frame, none of them known."""
    return {
        "observed": None,
        "scan_to_surface_mm": {"mean": None, "p95": None},
        "surface_to_scan_mm": {"mean": None, "p95": None},
        "keypoint_px": {"median": None, "p95": None},
        "silhouette_iou": None,
    }


def _spread(values, middle):
    """The mean or the median of values (k,), and what 95 % of them stay below; None of none."""
    if len(values) == 0:
        return {middle: None, "p95": None}
    return {middle: float(getattr(np, middle)(values)), "p95": float(np.percentile(values, 95))}


def keypoint_errors(names, views, cameras, model, vertices, joints):
    """Distances (k,) between the model's keypoints and those of the same name that were seen, over all `views`
    {camera: (len(names),3)}: in pixels, and in millimetres at the keypoints' depth."""
    places = dict(zip(model.keypoint_names, model.keypoints(vertices, joints)))
    known = [i for i, name in enumerate(names) if name in places]
    points = np.array([places[names[i]] for i in known]).reshape(-1, 3)
    pixels, millimetres = [np.zeros(0)], [np.zeros(0)]
    for name, found in views.items():
        at, depth = cameras[name].project(points)
        seen = (found[known, 2] > UNSEEN) & (depth > 0)
        off = np.linalg.norm(at - found[known, :2], axis=1)[seen]
        pixels.append(off)
        millimetres.append(1e3 * off * depth[seen] / cameras[name].K[0, 0])
    return np.concatenate(pixels), np.concatenate(millimetres)


def parted(a, b, side, area):
    """How far [m] from mask b (H,W) lies what mask a has beyond it: as far as `area` [m^2] of it lies or farther. `side`: of
    a pixel [m]. 0 where that is no more than a pixel, as borders are uncertain, and where b is empty."""
    from scipy.ndimage import distance_transform_edt

    rank = int(np.ceil(area / side**2))
    if not b.any() or (a & ~_grown(b)).sum() < rank:
        return 0.0
    rows, columns = (np.flatnonzero((a | b).any(axis)) for axis in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    far = distance_transform_edt(~b[window])[a[window]]
    return float(side * np.partition(far, -rank)[-rank])


def _grown(mask):
    """A mask (H,W) with the pixels beside it, diagonal ones too."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    wide = tall.copy()
    wide[:, 1:] |= tall[:, :-1]
    wide[:, :-1] |= tall[:, 1:]
    return wide


def overlap(a, b):
    """Intersection over union of two masks (H,W)."""
    return (a & b).sum() / max((a | b).sum(), 1)
