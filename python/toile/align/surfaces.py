"""A registered run's pictures and layers, frame by frame."""

from __future__ import annotations

from ..errors import UserError
from ..surface.layers import registered_surface


def pictures(run, number):
    """The Frame with its pictures. UserError: it has none."""
    frame = run.capture.pictures(number)
    if not frame.images:
        raise UserError(f"{run.capture.root}/frames/{number:06d}: no images")
    return frame


def layers_at(run, layers, number):
    """Registered vertices [(n,3)] and confidence [(n,)] of the `layers` in a frame."""
    surfaces = [registered_surface(run, layer) for layer in layers]
    return [s.at(number) for s in surfaces], [s.confidence.at(number) for s in surfaces]


def garments_at(run, number):
    """{garment: registered vertices (g,3)} of a frame."""
    return {name: garment.at(number) for name, garment in run.garments.items()}
