"""The settings of `toile register` by quality, and with what a caller changes of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import UserError
from .changes import changed
from .stages import Config

QUALITIES = ("draft", "standard", "fine")
PRESETS: dict[str, dict[str, Any]] = {
    "draft": {
        "preparation_frames": 5,
        "track.surface_samples": 2000,
        "track.refinement.steps": 3,
        "segment.views": 4,
        "segment.refine_border": False,
        "dress.trace_openings": False,
        "dress.fit_frames": 3,
        "dress.refinement.steps": 3,
        "inner.tolerance": 1e-3,
    },
    "standard": {},
    "fine": {"preparation_frames": 16, "dress.fit_frames": 10},
}


def preset(quality: str) -> Config:
    """The settings of a quality. Draft reads four pictures a frame, leaves openings where the labels put them, and fits
    pose and surfaces in fewer steps to fewer points. ValueError: no such quality."""
    if quality not in QUALITIES:
        raise ValueError(f"--quality {quality}: expected one of {', '.join(QUALITIES)}")
    return changed(Config(), PRESETS[quality], {"quality": quality})


def configured(
    quality: str | None, *changes: Mapping[str, Any], source: str = "", also: tuple[str, ...] = ()
) -> Config:
    """The preset of a quality with changes, a later one winning. Without a quality the last one that the changes name
    chooses the preset, "standard" where none does."""
    named = [change["quality"] for change in changes if "quality" in change]
    chosen = quality or (named[-1] if named else "standard")
    rest = [{name: value for name, value in change.items() if name != "quality"} for change in changes]
    try:
        base = preset(chosen)
    except (ValueError, TypeError) as error:
        raise UserError(str(error)) from None
    return changed(base, *rest, source=source, also=also)
