"""From pictures to a scan: depth maps of all cameras, the points they agree on, a surface through these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .. import kernels
from ..config.stereo import StereoSettings
from ..errors import RoomError, UserError
from ..kernels.arrays import Anything
from ..kernels.stereo import HOLES, memory_of
from ..scene import Camera, Mesh
from ..surface.poisson import keep_vertices, large_pieces, poisson
from ..vision.ideal import ideal, reduced

GIB = 2**30
FEWEST = 100  # points that a surface is sought through


@dataclass(frozen=True)
class Scanned:
    """What pictures of one instant gave. `holes` {reason: share of the masks' pixels}; `depth` is the share that has one."""

    scan: Mesh
    points: kernels.stereo.Points
    depth: float
    holes: dict[str, float]


def scan(
    images: Mapping[str, Anything],
    masks: Mapping[str, Anything],
    cameras: Mapping[str, Camera],
    settings: StereoSettings,
    room: int | None = None,
) -> Scanned:
    """The surface that pictures show. `images` {camera: (H,W,3) uint8}, `masks` {camera: (H,W) bool}.
    The scan has a confidence (n,) from 0 to 1 a vertex: 0 where
    nothing supports it, at the borders of holes. Nothing is kept between calls; no randomness but the settings' seed.

    Raises UserError where fewer than two cameras have a picture with a mask, or no surface is found; RoomError where the depth
    maps would take more than `room` bytes.
    """
    views = [
        view
        for name, image in images.items()
        if name in masks and (view := ideal(cameras[name], image, masks[name], settings.margin))
    ]
    if len(views) < 2:
        raise UserError(f"masks: {len(views)} pictures have one that is not empty; depth needs two")
    seen, pictures, cut = zip(*(reduced(*view, settings.reduction) for view in views))
    _check_room(seen, cut, settings.reduction, room)
    maps = kernels.StereoSolver(seen, **settings.match.model_dump()).solve(pictures, cut)
    fuse = settings.fuse.model_dump() | {"min_views": min(settings.fuse.min_views, len(views))}
    points = _sure(kernels.fuse_depths(seen, *maps, **fuse), settings.surface.least_confidence)
    if len(points.points) < FEWEST:
        raise UserError(f"the pictures agree on {len(points.points)} points: no surface is found")
    pixel = np.nanmedian([np.nanmedian(z) / c.K[0, 0] for z, c in zip(maps.depth, seen) if np.isfinite(z).any()])
    shares = _shares(maps.hole, cut)
    del maps  # the surface needs the room
    return Scanned(_surface(points, seen, cut, pixel, settings.surface), points, *shares)


def _check_room(cameras, masks, reduction, room):
    need = memory_of(cameras, masks)
    if room is not None and need > room:
        raise RoomError(
            f"stereo.reduction = {reduction}: depth maps of {len(cameras)} pictures take {need / GIB:.1f} GiB, {room / GIB:.1f} are "
            "free: twice the reduction takes a quarter"
        )


def _sure(points, least):
    sure = points.confidence >= least
    return type(points)(*(values[sure] for values in points))


def _surface(points, cameras, masks, pixel, settings):
    """The Poisson surface where points support it and no masks speak against it; `pixel` [m]."""
    from scipy.spatial import cKDTree

    V, F = poisson(points.points, points.normals, settings.cell * pixel, settings.largest_depth)
    reach = settings.reach * pixel
    distance, nearest = cKDTree(points.points).query(V, settings.neighbours, distance_upper_bound=4 * reach)
    distance, nearest = distance.reshape(len(V), -1), nearest.reshape(len(V), -1)
    keep = (distance[:, 0] < reach) & (_denials(V, cameras, masks, settings.border) < settings.outside)
    weight = np.where(np.isfinite(distance), 1 / (distance + 0.5 * pixel), 0)
    confidence = np.append(points.confidence, 0)[nearest]
    confidence = (weight * confidence).sum(1) / np.maximum(weight.sum(1), 1e-12)
    confidence *= np.clip(1 - distance[:, 0] / reach, 0, 1)
    V, F, old = keep_vertices(V, F, keep)
    if len(F):
        V, F, part = keep_vertices(V, F, large_pieces(F, len(V), settings.least_part))
        old = old[part]
    if len(F) == 0:
        raise UserError("no surface is found: masks and points contradict one another")
    return Mesh(V, F, confidence=confidence[old])


def _denials(V, cameras, masks, border):
    """How many masks each vertex (n,3) lies outside of, by more than `border` pixels."""
    from scipy.ndimage import binary_dilation

    reach = np.arange(-int(border), int(border) + 1)
    disc = reach**2 + reach[:, None] ** 2 <= border**2
    count = np.zeros(len(V), int)
    for camera, mask in zip(cameras, masks):
        outside = ~binary_dilation(mask, disc)
        uv, depth = camera.project(V)
        u, v = np.floor(uv).astype(int).T
        shown = (depth > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        count[shown] += outside[v[shown], u[shown]]
    return count


def _shares(hole, masks):
    """Share of the masks' pixels that have a depth, and {reason: share} of those that have none."""
    of = np.concatenate([reasons[: mask.shape[0], : mask.shape[1]][mask] for reasons, mask in zip(hole, masks)])
    share = np.bincount(of, minlength=len(HOLES)) / max(len(of), 1)
    return float(share[0]), {name: float(value) for name, value in zip(HOLES[1:], share[1:])}
