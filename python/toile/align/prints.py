"""Prints of a registered run's garments, as its pictures show them."""

from __future__ import annotations

import numpy as np

from ..errors import UserError
from ..prints.colours import Places, unwrapped
from ..surface.layers import registered_surface
from ..vision.unwrapping import Unwrapper


class PrintReader:
    """Reads frames of a run: `layers` inner to outer, body first; `places` {layer name: Places or UvMap}, those to be read."""

    def __init__(self, run, layers, places):
        self.run, self.capture, self.names = run, run.capture, list(places)
        self.layers = layers
        nothing = np.zeros(0, np.int64), np.zeros((0, 3))
        maps = [places.get(layer.name) or Places(layer, *nothing) for layer in layers]
        self.unwrapper = Unwrapper(maps, [layer.label for layer in layers if layer.kind == "garment"])

    def vertices(self, number, name):
        """Registered vertices of a garment (g,3)."""
        return self.run.garments[name].at(number)

    def views(self, number, moved=None):
        """{name: [Unwrapped a camera]} of a frame; `moved` {garment: vertices} in the place of the run's."""
        frame = self.capture.pictures(number)
        if not frame.images:
            raise UserError(f"{self.capture.root}/frames/{number:06d}: no images")
        surfaces = [registered_surface(self.run, layer) for layer in self.layers]
        V, confidence = [s.at(number) for s in surfaces], [s.confidence.at(number) for s in surfaces]
        V = [(moved or {}).get(layer.name, v) for layer, v in zip(self.layers, V)]
        self.unwrapper.frame(V, confidence)
        views = unwrapped(self.unwrapper, frame, self.capture.cameras)
        return {layer.name: seen for layer, seen in zip(self.layers, views) if layer.name in self.names}
