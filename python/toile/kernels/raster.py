"""Face-id and depth buffers of a mesh in a camera."""

import operator
from typing import Any

from .. import _core
from .._core import RasterResult
from .arrays import Array, as_faces, as_floats, as_vertices


def raster(vertices_camera: Array, F: Array, K: Array, size: tuple[int, int], **options: Any) -> RasterResult:
    """Which face does each pixel see, and how far away?

    vertices_camera: (n,3) float64 [m] in the OpenCV camera's frame (x right, y down, z forward); F: (m,3) int;
    K: (3,3) intrinsics, no distortion; size: (height, width) [px]. Pixel (row i, column j) has its centre at
    (j + 0.5, i + 0.5). Both sides of a face are seen.

    Options: barycentric=False (also return barycentrics); near_plane=1e-9 (what lies nearer is clipped away [m]).

    -> RasterResult:
      .face (H,W) int32, -1 where empty; .depth (H,W) float64 [m], z in the camera's frame, +inf where empty;
      .barycentric (H,W,3) float64, perspective-correct weights of the face's corners, zero where empty; None unless
      asked for.

    Coverage is decided in integers (corners snapped to 1/4096 px, top-left rule), so a shared edge neither cracks
    nor doubles; equal depths go to the lower face index; bits do not depend on the number of threads.
    InputError: empty mesh, NaN or infinity, index out of range, K not a camera matrix, a side not in 1..32768.
    Source: J. Pineda, A parallel algorithm for polygon rasterization, SIGGRAPH 1988.
    """
    try:
        height, width = (operator.index(side) for side in size)
    except (TypeError, ValueError):
        raise _core.InputError(f"raster: size is {size!r}, expected (height, width) as integers") from None
    return _core.raster(
        as_vertices("raster", "vertices_camera", vertices_camera),
        as_faces("raster", "F", F),
        as_floats("raster", "K", K, (3, 3)),
        height,
        width,
        **options,
    )
