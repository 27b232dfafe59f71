"""The settings of `toile register` by quality, and with what a caller changes of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import UserError
from .changes import changed
from .stages import Config
from .stereo import SCAN_PRESETS

QUALITIES = ("draft", "standard")
PRESETS: dict[str, dict[str, Any]] = {
    "draft": {
        "preparation_frames": 5,
        "track.scan_spacing": 0.018,
        "scan_spacing": 0.0,
        "track.surface_samples": 2000,
        "track.skeleton.surface_samples": 2000,
        "track.nricp.iterations": (0, 3, 0),
        "track.nricp.fine_iterations": 1,
        "track.nricp.fine_sweeps": 3,
        "dress.fit_frames": 3,
        "dress.nricp.fine_iterations": 1,
        "dress.traced_nricp.fine_iterations": 2,
        "dress.traced_nricp.fine_sweeps": 5,
        "inner.tolerance": 1e-3,
        "inner.solver.tolerance": 1e-3,
    },
    "standard": {},
}


def preset(quality: str) -> Config:
    """The settings of a quality. Draft thins scans before everything, and fits pose and
    surfaces in fewer steps to fewer points; scans that it makes are those of `toile reconstruct --quality draft`. UserError: no such quality."""
    if quality not in QUALITIES:
        finer = "; nothing measured is finer than standard, which --set changes" if quality == "fine" else ""
        raise UserError(f"--quality {quality}: expected one of {', '.join(QUALITIES)}{finer}")
    return changed(Config(), SCAN_PRESETS[quality], PRESETS[quality], {"quality": quality})


def configured(settings: Mapping[str, Any], also: tuple[str, ...] = ()) -> Config:
    """The preset that `quality` among the settings names, "standard" without, changed by the others. `also`: names that
    the message of an unknown one may suggest."""
    rest = dict(settings)
    return changed(preset(str(rest.pop("quality", "standard"))), rest, also=also)
