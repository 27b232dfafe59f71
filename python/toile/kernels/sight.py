"""What a camera sees of points beside a surface, and what its picture says there."""

from .. import _core
from .arrays import Array, Floats, Pixels, as_floats, as_pixels, as_vertices


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
