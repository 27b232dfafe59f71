"""The place that `toile.open_capture` had; it is gone with the next release."""

import warnings

from .io.capture import Capture, check_capture, open_capture

__all__ = ["Capture", "check_capture", "open_capture"]

warnings.warn("toile.capture: use toile.open_capture", DeprecationWarning, stacklevel=2)
