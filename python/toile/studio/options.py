"""What to capture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import UserError
from .cameras import VISIBLE
from .garment import SIZES
from .motions import JOIN

MOTIONS = ("walk", "rom", "talk", "hands-on-cloth")
RENDERERS = ("raster", "mitsuba")


@dataclass(frozen=True)
class StudioOptions:
    """What to capture. Lengths in the unit of the name."""

    frames: int = 20
    cameras: int = 8
    size: int = 512  # px, square pictures
    seed: int = 0
    renderer: str = "raster"  # raster, mitsuba
    samples: int = 64  # paths a pixel, mitsuba
    subject: str = "fitted"  # fitted, logo, loose
    motion: str = "walk"  # walk, rom, talk, hands-on-cloth, several joined by "+", or a .bvh file
    image_step: int = 1  # every which simulated frame is captured
    span: float = VISIBLE  # m of height that the pictures span at the middle of the stage
    noise: float = 1.0  # mm, scan noise
    holes: float = 0.05  # share of the scan's area
    keypoint_noise: float = 2.0  # px
    keypoint_outliers: float = 0.05
    label_errors: float = 0.10  # share of foreground pixels
    scan_faces: int = 60_000
    garment: str | None = "newton"  # newton, cut, the path of a shirt as .obj, or None
    trousers: bool = False  # a garment of their own, under the shirt

    def __post_init__(self):
        positive = ("frames", "cameras", "scan_faces", "samples", "image_step")
        for name in positive:
            if getattr(self, name) < 1:
                raise UserError(f"studio: {name} is {getattr(self, name)}, must be at least 1")
        if not 32 <= self.size <= 8192:
            raise UserError(f"studio: size is {self.size}, must be 32 to 8192 pixels")
        if self.seed < 0:
            raise UserError(f"studio: seed is {self.seed}, must be at least 0")
        for name in ("noise", "keypoint_noise"):
            if not 0 <= getattr(self, name) < np.inf:
                raise UserError(f"studio: {name} is {getattr(self, name)}, must be finite and at least 0")
        for name in ("holes", "keypoint_outliers", "label_errors"):
            if not 0 <= getattr(self, name) <= 0.9:
                raise UserError(f"studio: {name} is {getattr(self, name)}, must be 0 to 0.9")
        if not 0.1 <= self.span <= 10:
            raise UserError(f"studio: span is {self.span}, must be 0.1 to 10 m")
        if self.renderer not in RENDERERS:
            raise UserError(f"studio: renderer is {self.renderer!r}, must be {' or '.join(RENDERERS)}")
        if self.subject not in SIZES:
            raise UserError(f"studio: subject is {self.subject!r}, must be one of {', '.join(SIZES)}")
        self._check_motion()

    def _check_motion(self):
        if self.motion.lower().endswith(".bvh"):
            return
        parts = self.motion.split("+")
        if not set(parts) <= set(MOTIONS):
            known = f'{", ".join(MOTIONS)}, some joined by "+", or a .bvh file'
            raise UserError(f"studio: motion is {self.motion!r}, must be {known}")
        if len(parts) > 1 and self.frames < len(parts) * JOIN:
            raise UserError(f"studio: frames is {self.frames}, {self.motion} needs at least {len(parts) * JOIN}")

    @property
    def garments(self):
        """Name and source of each garment, inner to outer."""
        worn = (("trousers", "cut" if self.trousers else None), ("tshirt", self.garment))
        return tuple((name, source) for name, source in worn if source)

    @property
    def pictured(self):
        """Numbers of the frames that are captured."""
        return range(0, self.frames, self.image_step)
