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
    silhouette_iou: of the tracked skin and the masks, mean over the cameras that have one.
    """
    out = nothing() | {"observed": float((confidence[outside] == OBSERVED).mean())}
    if frame.scan is not None:
        scan, skin = frame.scan, kernels.SurfaceIndex(vertices, model.skin_faces)
        out["surface_to_scan_mm"] = _spread(1e3 * scan.index.closest(vertices[outside])[3], "mean")
        out["scan_to_surface_mm"] = _spread(1e3 * skin.closest(scan.vertices[np.unique(scan.faces)])[3], "mean")
    if frame.keypoints is not None:
        out["keypoint_px"] = _spread(_reprojection(frame.keypoints, cameras, model, vertices, joints), "median")
    if frame.masks:
        found = [_iou(cameras[name], mask, vertices, model.skin_faces) for name, mask in frame.masks.items()]
        out["silhouette_iou"] = float(np.mean(found))
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


def _reprojection(keypoints, cameras, model, vertices, joints):
    """Distances (k,) [px] between the model's keypoints and those of the same name that were seen."""
    places = dict(zip(model.keypoint_names, model.keypoints(vertices, joints)))
    known = [i for i, name in enumerate(keypoints.names) if name in places]
    points = np.array([places[keypoints.names[i]] for i in known]).reshape(-1, 3)
    distances = [np.zeros(0)]
    for name, found in keypoints.points.items():
        seen = found[known, 2] > UNSEEN
        distances.append(np.linalg.norm(cameras[name].project(points)[0] - found[known, :2], axis=1)[seen])
    return np.concatenate(distances)


def _iou(camera, mask, V, F):
    """Intersection over union of a mask (H,W) and the surface's silhouette in the same picture."""
    covered = DepthView(camera, V, F).face >= 0
    return (covered & mask).sum() / max((covered | mask).sum(), 1)
