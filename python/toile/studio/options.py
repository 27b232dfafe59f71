"""What to capture."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import ValidationError, model_validator

from ..config import Settings, setting
from ..errors import UserError
from .cameras import VISIBLE
from .cut import CUTS
from .garment import SIZES
from .motion_file import ENDINGS
from .motions import JOIN, MOTIONS
from .truth import STRAIN_P99
from .truths import PARTS, Hard, chosen

TEMPLATES = ("other", "scan", "settled")


class StudioOptions(Settings):
    """What to capture. UserError names the option that is out of range."""

    frames: int = setting(20, "count", "simulated, 30 a second", ge=1)
    cameras: int = setting(8, "count", "in a ring about the stage", ge=1)
    size: int = setting(512, "px", "width and height of the pictures", ge=32, le=8192)
    seed: int = setting(0, "count", "same seed, same bits", ge=0)
    renderer: Literal["raster", "mitsuba"] = setting(
        "raster", "name", "raster: the own rasteriser; mitsuba: path tracing"
    )
    pixel_paths: int = setting(64, "count", "light paths a pixel, mitsuba only", ge=1)
    subject: str = setting("fitted", "name", "fitted, logo, loose, child, tall or heavy: who wears what print and size")
    motion: str = setting(
        "walk",
        "name",
        "walk, rom, talk, hands-on-cloth, fast, sit, several joined by +, or a file: .bvh, or .npz of AMASS (SMPL, SMPL-H, SMPL-X)",
    )
    image_step: int = setting(1, "count", "every which simulated frame is pictured", ge=1)
    between: bool = setting(False, "switch", "those between the pictured ones are captured too, by keypoints alone")
    span: float = setting(VISIBLE, "m", "height that the pictures span at the middle of the stage", ge=0.1, le=10)
    scan_noise: float = setting(0.001, "m", "standard deviation of the scans' points", ge=0)
    hole_share: float = setting(0.05, "1", "of the scan's area that is cut out", ge=0, le=0.9)
    keypoint_noise: float = setting(2.0, "px", "standard deviation of the keypoints", ge=0)
    keypoint_outlier_share: float = setting(0.05, "1", "of the keypoints, half of them swaps", ge=0, le=0.9)
    label_error_share: float = setting(0.10, "1", "of the foreground pixels", ge=0, le=0.9)
    scan_faces: int = setting(60_000, "count", "triangles of a scan before holes", ge=1)
    garment: str | None = setting(
        "newton", "name", "newton, cut (from the body), or the path of a shirt as .obj; empty: the bare body"
    )
    truth: str = setting("hard", "name", "plain, hard, or parts of it joined by +: names of the settings hard.*")
    template: str = setting(
        "other",
        "name",
        "other: a cut of its own; scan: cut from the first frame; settled: the true garment; or an .obj",
    )
    pairs: int = setting(
        0, "count", "intersecting triangles of a garment and what is under it that a frame may keep", ge=0
    )
    strain: float = setting(
        STRAIN_P99, "1", "change of length over rest length that 99 % of a garment's edges may have in a frame", gt=0
    )
    trousers: bool = setting(False, "switch", "a garment of their own, cut from the body, under the shirt")
    wear: str = setting("", "name", "garments joined by +, inner to outer, instead of garment and trousers")
    hard: Hard = Hard()

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            first = error.errors()[0]
            name = ".".join(map(str, first["loc"]))
            what = first["msg"].replace("Input should be", "expected").replace("Value error, ", "")
            raise UserError(f"studio: {name} is {first['input']!r}, {what}" if name else what) from None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.subject not in SIZES:
            raise UserError(f"studio: subject is {self.subject!r}, expected one of {', '.join(SIZES)}")
        parts = self.truth.split("+")
        if self.truth not in ("plain", "hard") and not set(parts) <= set(PARTS):
            known = f'plain, hard, or some of {", ".join(PARTS)} joined by "+"'
            raise UserError(f"studio: truth is {self.truth!r}, expected {known}")
        idle = [name for name in PARTS if name not in parts and getattr(self.hard, name) != getattr(Hard(), name)]
        if idle and self.truth != "hard":
            raise UserError(
                f"studio: hard.{idle[0]} is changed, but truth is {self.truth!r}, which leaves that part out"
            )
        worn = self.wear.split("+") if self.wear else []
        if not set(worn) <= set(CUTS) or len(set(worn)) < len(worn):
            raise UserError(
                f'studio: wear is {self.wear!r}, expected some of {", ".join(CUTS)} joined by "+", each once'
            )
        if self.template not in TEMPLATES and not self.template.lower().endswith(".obj"):
            raise UserError(f"studio: template is {self.template!r}, expected {', '.join(TEMPLATES)} or an .obj")
        self._check_motion()
        return self

    def _check_motion(self) -> None:
        if self.motion.lower().endswith(ENDINGS):
            return
        parts = self.motion.split("+")
        if not set(parts) <= set(MOTIONS):
            known = f'{", ".join(MOTIONS)}, some joined by "+", or a .bvh or .npz file'
            raise UserError(f"studio: motion is {self.motion!r}, expected {known}")
        if len(parts) > 1 and self.frames < len(parts) * JOIN:
            raise UserError(f"studio: frames is {self.frames}, {self.motion} needs at least {len(parts) * JOIN}")

    @property
    def garments(self):
        """Name and source of each garment, inner to outer."""
        if self.wear:
            return tuple(
                (name, self.garment if name == "tshirt" and self.garment else "cut") for name in self.wear.split("+")
            )
        worn = (("trousers", "cut" if self.trousers else None), ("tshirt", self.garment))
        return tuple((name, source) for name, source in worn if source)

    @property
    def amounts(self) -> Hard:
        """How hard each part of the truth is."""
        return chosen(self.truth, self.hard)

    @property
    def pictured(self):
        """Numbers of the frames that have pictures."""
        return range(0, self.frames, self.image_step)

    @property
    def captured(self):
        """Numbers of the frames that have anything."""
        return range(self.pictured[-1] + 1) if self.between else self.pictured
