"""What a camera sees of points beside a surface, and what its picture says there."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import _core
from .._core import InputError
from .arrays import Array, Floats, Pixels, as_floats, as_indices, as_pixels, as_vertices


def undistorted_view(points: Array, K: Array, distortion: Array, T_camera_world: Array) -> Floats:
    """World points (n,3) [m] in a camera's frame (n,3), moved across the view so that a camera without distortion sees each
    where this one does: the lens' picture of a mesh, up to the bend inside one triangle. Camera as for `visibility`.
    InputError for NaN."""
    return _core.undistorted_view(
        as_vertices("undistorted_view", "points", points),
        as_floats("undistorted_view", "K", K, (3, 3)),
        as_floats("undistorted_view", "distortion", distortion, (5,)),
        as_floats("undistorted_view", "T_camera_world", T_camera_world, (4, 4)),
    )


def visibility(
    points: Array,
    normals: Array,
    K: Array,
    distortion: Array,
    T_camera_world: Array,
    depth: Array,
    tolerance: float,
    min_cosine: float,
) -> tuple[Floats, Floats, Floats]:
    """Pixels (n,2) of points (n,3) [m] with normals (n,3); weights (n,): the cosine to the view where the point is visible,
    else 0; and clearance (n,) [m]: by how far it lies before the surface, +inf where the picture shows none, -inf outside.

    K (3,3), distortion (5,) k1 k2 p1 p2 k3, T_camera_world (4,4): an OpenCV camera, pixel (0,0) with its centre at
    (0.5, 0.5). depth (H,W) [m] as `raster` gives it. Visible is what faces the camera by more than `min_cosine` and lies
    at most tolerance / cosine [m] behind the surface. InputError for NaN.
    """
    return _core.visibility(
        as_vertices("visibility", "points", points),
        as_vertices("visibility", "normals", normals),
        as_floats("visibility", "K", K, (3, 3)),
        as_floats("visibility", "distortion", distortion, (5,)),
        as_floats("visibility", "T_camera_world", T_camera_world, (4, 4)),
        as_floats("visibility", "depth", depth, (None, None)),
        tolerance,
        min_cosine,
    )


def bilinear(image: Array, uv: Array) -> Pixels:
    """Bilinear values (n,C) float32 of an image (H,W,C) at pixels (n,2); pixel (0,0) has its centre at (0.5, 0.5), and
    beyond the outermost centres their values go on; at what is no number any value. InputError for fewer than 2 x 2
    pixels."""
    return _core.bilinear(as_pixels("bilinear", "image", image), as_floats("bilinear", "uv", uv, (None, 2)))


def soft_labels(image: Array, ids: Array, blur: float) -> Pixels:
    """Blurred indicator (H,W,L) float32 of each of the labels `ids` (L,) in a picture (H,W) uint8 of label ids; `blur` [px] is
    the Gaussian's sigma, cut at four of them. Beyond its border the picture is mirrored. InputError: no pixel, no id,
    an id beyond 255, a blur of 0 or beyond 1000."""
    return _core.soft_labels(_as_bytes("soft_labels", "image", image), _as_ids("soft_labels", ids), blur)


def evidence_picture(
    labels: Array, ids: Array, clear: Array, likelihood: Array | None, rgb: Array | None, blur: float, empty_blur: float
) -> Pixels:
    """A picture (H,W,2L+4) float32 as `view_odds` reads it, of labels (H,W) uint8.

    likelihood (k,L): the labels' log likelihoods by colour at the k pixels that are `clear` (H,W), row by row; rgb (H,W,3)
    uint8; what is None is zero. `blur` and `empty_blur` [px] are of the labels' shares and of label 0, which is none; see
    `soft_labels`. InputError for sizes that differ, and as there."""
    name = "evidence_picture"
    return _core.evidence_picture(
        _as_bytes(name, "labels", labels),
        _as_ids(name, ids),
        np.ascontiguousarray(clear, bool),
        None if likelihood is None else np.ascontiguousarray(likelihood, np.float32),
        None if rgb is None else _as_bytes(name, "rgb", rgb),
        blur,
        empty_blur,
    )


def _as_bytes(kernel: str, name: str, values: Array) -> Any:
    values = np.asarray(values)
    if values.dtype != np.uint8:
        raise InputError(f"{kernel}: {name} has dtype {values.dtype}, expected uint8")
    return np.ascontiguousarray(values)


def _as_ids(kernel: str, ids: Array) -> list[int]:
    """Label ids, which pictures hold as uint8."""
    found = as_indices(kernel, "ids", ids).tolist()
    for i, label in enumerate(found):
        if not 0 <= label <= 255:
            raise InputError(f"{kernel}: ids[{i}] is {label}, expected 0 to 255")
    return found


class View:
    """One camera of a frame: K (3,3), distortion (5,), T_camera_world (4,4), the depth (H,W) [m] of the surface it sees, and
    its picture (h,w,C) float32 from pixel `corner` (column, row) on."""

    def __init__(
        self, K: Array, distortion: Array, T_camera_world: Array, depth: Array, picture: Array, corner: Array = (0, 0)
    ) -> None:
        self._view = _core.View(
            as_floats("View", "K", K, (3, 3)),
            as_floats("View", "distortion", distortion, (5,)),
            as_floats("View", "T_camera_world", T_camera_world, (4, 4)),
            as_floats("View", "depth", depth, (None, None)),
            as_pixels("View", "picture", picture),
            as_floats("View", "corner", corner, (2,)),
        )


def view_odds(
    views: Sequence[View], points: Array, normals: Array, labels: int, column: int, rival: Array, **options: Any
) -> Floats:
    """What views say of points (n,3) with normals (n,3), of label `column` against each point's `rival` (n,): (n,5).

    Columns: the log likelihood ratios by colour, summed with the views' weights; the sum of those; the shares of the labels
    given, `column`'s and of what speaks against it, summed likewise; and of a floating point how empty the emptiest picture
    is, else 0. A picture's 2 `labels` + 4 channels are the labels' log likelihoods by colour, their shares about the
    pixel, RGB, and emptiness.

    Options: tolerance, min_cosine as of `visibility`; floating [m], behind: a point so far before the surface floats, and a
    picture whose share of `column` is larger there says nothing of it; most: bound of one picture's log likelihood ratio;
    free: points may float, and every other label speaks against `column`, not the rival's alone. InputError for NaN.
    """
    return _core.view_odds(
        [view._view for view in views],
        as_vertices("view_odds", "points", points),
        as_vertices("view_odds", "normals", normals),
        labels,
        column,
        as_indices("view_odds", "rival", rival),
        **options,
    )


def view_edges(views: Sequence[View], points: Array, normals: Array, labels: int, s: Array, **options: Any) -> Floats:
    """Colour edges along profiles of m points each, points and normals (k m,3), from outside in at places s (m,) [m] about
    0: (k,2), sums over the views of weight * shift [m] from 0 and of the weights. Pictures are as for `view_odds`.

    Each view's profile is read as a mix of its two ends' colours; the edge lies where a sharp one would cover the same
    length. Options: tolerance, min_cosine as of `visibility`; flank: share of the half length beyond which the ends'
    colours are read; contrast: difference of RGB that makes an edge worth reading; disorder: share of it that prints and
    folds may add; shift: largest one, as a share of the half length. InputError for NaN.
    """
    return _core.view_edges(
        [view._view for view in views],
        as_vertices("view_edges", "points", points),
        as_vertices("view_edges", "normals", normals),
        labels,
        as_floats("view_edges", "s", s, (None,)),
        **options,
    )
