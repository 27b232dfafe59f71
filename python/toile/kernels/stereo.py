"""Depth and normals from calibrated pictures, and the points that they agree on."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import _core
from .arrays import Anything, Array, Floats, Ints, as_floats

# bytes a pixel: of the result, of a camera's picture at work, of its mask at work
RESULT, PICTURE, MASKED = 26, 17, 44
HOLES = ("none", "masked", "saturated", "untextured", "unmatched", "inconsistent")
# of red, green, blue; the weights of brightness (BT.601) would let a sixth more of their noise through
GREY = np.full(3, 1 / 3, np.float32)


@dataclass(frozen=True)
class StereoResult:
    """Maps of all cameras, of the largest picture's size; NaN in holes. As a tuple `depth, normal, confidence = result`."""

    depth: npt.NDArray[np.float32]  # (C,H,W) z in the camera's frame [m]
    normal: npt.NDArray[np.float32]  # (C,H,W,3) unit, in the world, towards the camera
    confidence: npt.NDArray[np.float32]  # (C,H,W) 0 to 1, 0 in holes
    hole: npt.NDArray[np.uint8]  # (C,H,W) index of HOLES: why there is no depth

    def __iter__(self) -> Iterator[npt.NDArray[np.float32]]:
        return iter((self.depth, self.normal, self.confidence))


class Points(NamedTuple):
    """Fused points."""

    points: Floats  # (n,3) [m]
    normals: Floats  # (n,3) unit
    confidence: Floats  # (n,) 0 to 1
    views: Ints  # (n,) cameras that agree on each


class StereoSolver:
    """Depth maps of cameras that see one object, by multi-view PatchMatch.

    cameras: at least two with `.K` (3,3), `.T_camera_world` (4,4), `.height`, `.width` and, where they have one, a
    `.distortion` of zeros: pictures of other lenses are made ideal first, see `toile.vision.ideal`.

    Options: sources=4 (cameras that a picture is compared with, nearest to a good angle), best=2 (of these count, pixel by
    pixel), max_angle=1.2 (between two cameras [rad]); coarsest=128 (longer side of the coarsest level [px]),
    start_iterations=6, coarse_iterations=3, iterations=2 (of PatchMatch: at first, on the coarse levels, on the finest),
    refinements=2 (of depth and slopes on a surface bent as its neighbours say, two Gauss-Newton steps each); spacing=2.0 (of a window's 6 samples a side [px]), colour=16.0 (difference of grey at
    which a sample counts half), noise=0.5 (of grey values); consistency=0.3 (cost of contradicting another camera's depth),
    contradiction=2.0 [px]; max_cost=0.6 (1 - correlation; beyond there is a hole), agreement=1.0 (disparity up to which
    depths agree [px]), min_views=1 (other cameras that have to agree); seed=0.
    """

    def __init__(self, cameras: Sequence[Any], **options: Any) -> None:
        self._cameras = _core_cameras("stereo", cameras)
        self._core = _core.StereoSolver(self._cameras, **options)

    def solve(
        self, images: Sequence[Anything], masks: Sequence[Anything] | None = None, depth_range: Array | None = None
    ) -> StereoResult:
        """Depth, normals and confidence of every camera's picture.

        images: one a camera, (H,W) or (H,W,3) (its channels' mean counts), values 0 to 255. masks: (H,W), not zero where the object is; None: all is
        looked at. depth_range: (C,2) nearest and farthest depth [m]; None: the masks' visual hull bounds each pixel.

        Memory: 26 bytes a pixel of the result, pictures among them; at work at most 17 more a pixel of a camera's
        picture and 44 more a pixel of its mask; cut pictures to the object first. Bits do not depend on the number of
        threads. InputError: fewer than two cameras, sizes that differ from the camera's, values out of range, a lens that
        is not ideal, neither masks nor depth_range.
        Source: S. Galliani, K. Lasinger, K. Schindler, Massively parallel multiview stereopsis by surface normal
        diffusion, ICCV 2015.
        """
        if masks is None and depth_range is None:
            raise _core.InputError("stereo: neither masks nor depth_range: nothing bounds the depths")
        count = len(self._cameras)
        shape = (count, max(c.height for c in self._cameras), max(c.width for c in self._cameras))
        grey, mask = np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        for name, given in (("images", images), ("masks", masks)):
            if given is not None and len(given) != count:
                raise _core.InputError(f"stereo: {name} has {len(given)} entries for {count} cameras")
        for c, camera in enumerate(self._cameras):
            size = (camera.height, camera.width)
            grey[c, : size[0], : size[1]] = _grey(f"images[{c}]", images[c], size)
            mask[c, : size[0], : size[1]] = 1 if masks is None else _mask(f"masks[{c}]", masks[c], size)
        ranges = (
            np.zeros((count, 2)) if depth_range is None else as_floats("stereo", "depth_range", depth_range, (count, 2))
        )
        return StereoResult(*self._core.solve(grey, mask, ranges))


def memory_of(cameras: Sequence[Any], masks: Sequence[Anything]) -> int:
    """Bytes that `StereoSolver(cameras).solve` takes of pictures with these masks (H,W), at most."""
    largest = max(camera.height for camera in cameras) * max(camera.width for camera in cameras)
    pictures = sum(camera.height * camera.width for camera in cameras)
    shown = sum(int(np.count_nonzero(mask)) for mask in masks)
    return RESULT * len(cameras) * largest + PICTURE * pictures + MASKED * shown


def fuse_depths(cameras: Sequence[Any], depth: Array, normal: Array, confidence: Array, **options: Any) -> Points:
    """Points of depth maps as `StereoSolver` gives them: each the mean of the pixels of several cameras that lie on one
    surface, weighted by their confidence; a pixel that has gone into a point begins none of its own. Of the cameras that face a
    point and have a depth there, at least as many agree as not.

    depth (C,H,W), normal (C,H,W,3), confidence (C,H,W). Options: agreement=1.0 (distance between surfaces up to which pixels
    are of one point, in pixels' sizes there), min_cosine=0.5 (of their normals), min_views=2 (cameras that a point needs).
    The confidence is 1 - the product of its pixels' doubts. InputError for other shapes.
    """
    maps = [np.ascontiguousarray(values, dtype=np.float32) for values in (depth, normal, confidence)]
    return Points(*_core.fuse_depths(_core_cameras("fuse_depths", cameras), *maps, **options))


def _core_cameras(kernel: str, cameras: Sequence[Any]) -> list[Any]:
    for c, camera in enumerate(cameras):
        if np.any(getattr(camera, "distortion", 0)):
            raise _core.InputError(f"{kernel}: cameras[{c}].distortion is not zero: make its pictures ideal first")
    return [
        _core.StereoCamera(
            as_floats(kernel, f"cameras[{c}].K", camera.K, (3, 3)),
            as_floats(kernel, f"cameras[{c}].T_camera_world", camera.T_camera_world, (4, 4)),
            int(camera.height),
            int(camera.width),
        )
        for c, camera in enumerate(cameras)
    ]


def _grey(name: str, image: Anything, size: tuple[int, int]) -> Anything:
    image = np.asarray(image)
    if image.shape not in (size, (*size, 3)) or image.dtype.kind not in "fiu":
        raise _core.InputError(
            f"stereo: {name} has shape {image.shape} of {image.dtype}, expected {size} or {(*size, 3)}"
        )
    return image if image.ndim == 2 else image.astype(np.float32) @ GREY


def _mask(name: str, mask: Anything, size: tuple[int, int]) -> Anything:
    mask = np.asarray(mask)
    if mask.shape != size:
        raise _core.InputError(f"stereo: {name} has shape {mask.shape}, expected {size}")
    return mask != 0
