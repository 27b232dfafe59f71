"""What pictures show of places on the layers: colours at a lattice's points or a map's texels, a camera at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernels.arrays import Anything, Array, Bools, Floats
from ..scene import Camera, Frame
from ..vision.unwrapping import Unwrapped, Unwrapper, pinhole, undistorted

Views = Mapping[str, Sequence[Unwrapped]]  # of a layer, an Unwrapped a camera


@dataclass(frozen=True)
class Places:
    """Points on a layer, in the form that an Unwrapper reads."""

    layer: Any  # its `name`, `label` (-1: the body's), `rest` (n,3) and `faces` (m,3)
    face: Anything  # (N,)
    bary: Floats  # (N,3)

    @staticmethod
    def none(layer: Any) -> Places:
        """Of a layer that only hides others."""
        return Places(layer, np.zeros(0, np.int64), np.zeros((0, 3)))

    @property
    def valid(self) -> Bools:
        return np.ones(len(self.face), bool)


class PrintViews:
    """Unwraps a frame's pictures at the `places` {layer name: Places or UvMap} on some of the `layers`, inner to outer and body
    first, which hide one another."""

    def __init__(self, layers: Sequence[Any], places: Mapping[str, Any], cameras: Mapping[str, Camera]):
        self.names, self.places, self.cameras = [layer.name for layer in layers], places, cameras
        maps = [places.get(layer.name) or Places.none(layer) for layer in layers]
        self.unwrapper = Unwrapper(maps, [layer.label for layer in layers if layer.label >= 0])

    def of(
        self, frame: Frame, vertices: Sequence[Floats], confidence: Sequence[Anything], covered: Array = ()
    ) -> Views:
        """Of the layers' vertices (n,3) and confidence (n,) uint8 in that frame; faces `covered` of the body hide nothing.
        Without labels and masks all of a picture counts; a camera without a picture sees nothing."""
        self.unwrapper.frame(vertices, confidence, covered)
        views = zip(*(self._view(frame, name, camera) for name, camera in self.cameras.items()))
        return {name: seen for name, seen in zip(self.names, views) if name in self.places}

    def _view(self, frame, name, camera):
        image, labels = frame.images.get(name), frame.labels.get(name)
        mask = frame.silhouette(name)
        if image is None:  # a view that shows nothing
            image, mask = np.zeros((*camera.size, 3), np.uint8), np.zeros(camera.size, bool)
        elif mask is None:
            mask = np.ones(camera.size, bool)
        flat = None if labels is None else undistorted(camera, labels, True)
        mask = undistorted(camera, mask.astype(np.uint8), True) > 0
        return self.unwrapper.view(pinhole(camera), undistorted(camera, image), mask, flat)
