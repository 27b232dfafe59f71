"""Colours of a picture whose faces are known."""

from collections.abc import Sequence

from .. import _core
from .arrays import Array, Pixels, as_face_ids, as_faces, as_floats, as_indices, as_pixels, as_vertices


def paint(
    face: Array,
    vertices_camera: Array,
    F: Array,
    uv: Array,
    face_uv: Array,
    K: Array,
    textures: Sequence[Array],
    first_face: Array = (0,),
    edge_on: float = 1e-3,
) -> Pixels:
    """The picture (C,H,W) float32 of textured layers whose faces `raster` found, 0 where `face` (H,W) is -1.

    vertices_camera: (n,3) float64 [m] in the OpenCV camera's frame; F: (m,3) int; uv: (t,2), v up; face_uv: (m,3) int;
    K: (3,3) intrinsics, no distortion; textures: one (T,T,C) a layer, all of one C; first_face: (L,) the face where
    each layer begins, ascending from 0. Texel (r, c) has its centre at u = (c + .5)/T, v = 1 - (r + .5)/T.

    UVs are interpolated with perspective, textures bilinearly; beyond its outermost texel centres a texture is constant.
    Of a face that is seen at an angle whose sine is at most `edge_on` all points count as its middle. Bits do not depend on
    the number of threads. InputError: empty mesh, NaN or infinity in places, index out of range, K not a camera matrix,
    textures that are not square or differ in C. Colours may be anything.
    """
    faces = as_face_ids("paint", "face", face)
    picture = _core.paint(
        faces,
        as_vertices("paint", "vertices_camera", vertices_camera),
        as_faces("paint", "F", F),
        as_floats("paint", "uv", uv, (None, 2)),
        as_faces("paint", "face_uv", face_uv),
        as_floats("paint", "K", K, (3, 3)),
        as_indices("paint", "first_face", first_face),
        [as_pixels("paint", f"textures[{k}]", texture) for k, texture in enumerate(textures)],
        edge_on,
    )
    return picture.reshape(len(picture), *faces.shape)
