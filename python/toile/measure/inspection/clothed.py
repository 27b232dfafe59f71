"""The body of a frame, posed by its keypoints and its scan, in the templates of its garments, and what label images say of it:
a few tenths of a second in place of the preparation of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import kernels
from ...io.capture import Capture
from ...kernels.arrays import Array, Bools, Floats
from ...kinematics import blended_by
from ...scene import BodyModel, Camera, Frame, Points3D
from ...surface.transfer import move_with_body, transfer_skin
from ...vision.visibility import DepthView

ENOUGH = 8  # keypoints that pose a body
SIGMA = 0.02  # m, of keypoints beside a scan
MISSED = 0.08  # m, root mean square: a body that misses its keypoints by more is not posed
NEAR = 0.1  # m: mean distance of a template that lies on the body at rest
SMOOTHED = 5  # rounds, of a template's skinning weights
REACH = 0.04  # m, over which a template goes with the person's shape
RIM = 0.04  # m: so near to its openings nothing is asked of a template, cloth hangs another way
TOLERANCE = 0.02  # m, behind what a camera sees
FACING = 0.2  # cosine to the view


@dataclass(frozen=True)
class Clothed:
    """`vertices` (n,3), `normals` (n,3), `faces` of the body and, after it, of the templates; `worn` (n,): index of the
    garment, -1 on the body; `areas` (n,) [m^2]; `inner` (n,): away from the openings; `joint` (b,) of the body's vertices."""

    vertices: Floats
    normals: Floats
    faces: Array
    worn: Array
    areas: Floats
    inner: Bools
    joint: Array


def clothed(capture: Capture, model: BodyModel, frame: Frame, points: Points3D) -> Clothed | None:
    """A frame's Clothed; None where its keypoints do not pose the body. Templates that do not lie on the body at rest, by
    their units or axes, are left out."""
    fit = posed_body(model, frame, points)
    if fit is None:
        return None
    rest, J = model.rest(np.asarray(fit.shape))
    R, x = model.joint_transforms(J, np.asarray(fit.rotations), np.asarray(fit.translation))
    layers = [_body(model, np.asarray(fit.V))]
    for i, garment in enumerate(capture.scene.garments):
        mesh = capture.templates.get(garment.name)
        if mesh is None or kernels.SurfaceIndex(model.v_template, model.f).closest(mesh.vertices)[3].mean() > NEAR:
            continue
        worn = move_with_body(mesh.vertices, model.v_template, rest, REACH)
        A, b = blended_by(transfer_skin(model, mesh.vertices, mesh.faces, SMOOTHED), J, R, x)
        layers.append((np.einsum("gij,gj->gi", A, worn) + b, mesh.faces, i))
    return _joined(layers, model)


def bare(model: BodyModel, vertices: Floats) -> Clothed:
    """The Clothed of a body whose vertices (n,3) [m] are known, without templates."""
    return _joined([_body(model, vertices)], model)


def _body(model: BodyModel, vertices: Floats) -> tuple[Floats, Array, int]:
    return vertices, model.skin_faces, -1


def posed_body(model: BodyModel, frame: Frame, points: Points3D) -> Any:
    """The SkeletonResult of a frame, None where too few keypoints are seen, or the body misses them."""
    seen = np.isfinite(points.points).all(1) & np.isin(points.names, model.keypoint_names)
    if seen.sum() < ENOUGH:
        return None
    solver = kernels.SkeletonSolver(model)
    fit = solver.solve(keypoints=points)
    if frame.scan is not None and fit.stop != "unmatched":
        beside = Points3D(points.names, points.points, np.full(len(points.points), SIGMA), points.views)
        fit = solver.solve(frame.scan.vertices, frame.scan.faces, keypoints=beside, start=fit)
    return fit if fit.stop != "unmatched" and fit.keypoint_rms < MISSED else None


def _joined(layers: list[tuple[Floats, Array, int]], model: BodyModel) -> Clothed:
    from scipy.spatial import cKDTree

    first = np.cumsum([0, *(len(V) for V, _, _ in layers)])
    inner, areas = [], []
    for V, F, i in layers:
        loops = kernels.boundary_loops(F) if i >= 0 else []
        far = cKDTree(V[np.concatenate(loops)]).query(V)[0] > RIM if len(loops) else np.ones(len(V), bool)
        inner.append(far)
        areas.append(np.bincount(F.ravel(), np.repeat(kernels.face_areas(V, F) / 3, 3), minlength=len(V)))
    return Clothed(
        np.concatenate([V for V, _, _ in layers]),
        np.concatenate([kernels.vertex_normals(V, F) for V, F, _ in layers]),
        np.concatenate([F + k for (_, F, _), k in zip(layers, first)]),
        np.concatenate([np.full(len(V), i) for V, _, i in layers]),
        np.concatenate(areas),
        np.concatenate(inner),
        model.mover,
    )


@dataclass(frozen=True)
class Reading:
    """What C cameras show at n vertices: `labels` (C,n), -1 where one is not seen or its picture shows the background;
    `pixels` (C,n,2) column and row."""

    cameras: tuple[str, ...]
    labels: Array
    pixels: Array


def read_labels(cameras: Mapping[str, Camera], labels: Mapping[str, Any], clothed: Clothed) -> Reading:
    """The Reading of label images at the vertices of what is worn, which hides some of them from some cameras."""
    names = tuple(name for name in labels if name in cameras)
    V, F = clothed.vertices, clothed.faces
    found = np.full((len(names), len(V)), -1, np.int16)
    pixels = np.zeros((*found.shape, 2), np.int64)
    for i, name in enumerate(names):
        uv, weight, _ = DepthView(cameras[name], V, F).visibility(V, clothed.normals, TOLERANCE, FACING)
        seen, size = np.flatnonzero(weight > 0), labels[name].shape
        pixels[i, seen] = np.clip(np.floor(uv[seen]), 0, [size[1] - 1, size[0] - 1]).astype(np.int64)
        given = labels[name][pixels[i, seen, 1], pixels[i, seen, 0]].astype(np.int16)
        found[i, seen] = np.where(given > 0, given, -1)
    return Reading(names, found, pixels)
