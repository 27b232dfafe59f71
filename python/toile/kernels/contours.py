"""Where pictures of meshes jump, and how they change as those places move."""

from typing import Any

import numpy as np

from .. import _core
from .arrays import Array, Bools, Floats, Ints, as_face_ids, as_faces, as_floats, as_mask, as_pixels, as_vertices


class Contours:
    """The contours of a mesh between pixels that are neighbours in a row or a column: silhouettes and edges that occlude.

    face: (H,W) int, -1 where empty, and depth: (H,W) [m], as `raster` found them; vertices_camera: (n,3) float64 [m] in the
    OpenCV camera's frame; F: (m,3) int; neighbours: (m,3) int by `face_neighbours`; K: (3,3) intrinsics, no distortion. What
    lies nearer than near_plane [m] counts as if it lay there. of: (H,W) bool, only contours beside these pixels are asked for;
    None for all.

    From one pixel's centre the surface that it sees is followed, face by face, towards the other centre. On the way it may
    end at a border or turn back at a fold: there the picture jumps to what lies behind. A surface that goes on to the other
    centre has no contour there, however small its faces are (nor has one of more than 64 within the pixel). Of two surfaces
    that both end, the nearer one's end counts; where neither ends, as where they cross, there is none. Bits do not depend on
    the number of threads. InputError: empty mesh, NaN or infinity in places, index out of range, K not a camera matrix,
    arrays that do not fit.
    """

    def __init__(
        self,
        face: Array,
        depth: Array,
        vertices_camera: Array,
        F: Array,
        neighbours: Array,
        K: Array,
        near_plane: float = 1e-9,
        of: Array | None = None,
    ) -> None:
        ids = as_face_ids("contours", "face", face)
        self._contours = _core.Contours(
            ids,
            as_floats("contours", "depth", depth, (None, None)),
            as_vertices("contours", "vertices_camera", vertices_camera),
            as_faces("contours", "F", F),
            as_faces("contours", "neighbours", neighbours),
            as_floats("contours", "K", K, (3, 3)),
            near_plane,
            np.zeros((0, 0), bool) if of is None else as_mask("contours", "of", of, ids.shape),
        )
        self.size = ids.shape

    def gradient(self, picture: Array, g: Array) -> Floats:
        """The slope (n,3) of a loss by the vertices, through the motion of the contours on the image: of a picture (C,H,W)
        float32 and the loss' slope g (C,H,W) by it.

        As the contour between a and b goes one pixel towards b, the loss grows by the sum of 0.5 (g_a + g_b) (I_a - I_b) over
        the channels; a difference that is not finite, as of depth beside emptiness, counts as 0. InputError: other shapes.
        Source: S. Pidhorskyi et al., Rasterized edge gradients, ECCV 2024, of contours in place of pixels.
        """
        planes = []
        for name, values in (("picture", picture), ("g", g)):
            array = as_pixels("contours", name, values)
            if array.shape[1:] != self.size:
                raise _core.InputError(
                    f"contours: {name} has shape {array.shape}, expected (C, {', '.join(map(str, self.size))})"
                )
            planes.append(array.reshape(len(array), -1))
        return self._contours.gradient(*planes)

    @property
    def a(self) -> Ints:
        """(e,) the one pixel, row * W + column, of each contour."""
        return self._contours.a

    @property
    def b(self) -> Ints:
        """(e,) the other, to the right of a, or below."""
        return self._contours.b

    @property
    def below(self) -> Bools:
        """(e,) does b lie below?"""
        return self._contours.below

    @property
    def edge(self) -> Ints:
        """(e,2) the mesh's edge (i, j) that lies between."""
        return np.stack([self._contours.i, self._contours.j], 1)

    @property
    def share(self) -> Floats:
        """(e,) of j, in the point (1 - share) v_i + share v_j between the pixels."""
        return self._contours.share

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError("Contours does not pickle: send the view and find them where they are needed")
