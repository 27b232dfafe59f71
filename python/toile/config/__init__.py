"""Settings: what decides the results of a command, as small models that presets, files and options fill alike."""

from .changes import changed, from_options, read_config, read_set
from .dress import DressSettings, LoopSettings, PlacementSettings
from .kernels import NricpSettings
from .presets import QUALITIES, configured, preset
from .prints import PrintSettings
from .segment import EvidenceSettings, OpeningSettings, SegmentSettings
from .settings import PowerOfTwo, Settings, listed, setting
from .stages import Config, InnerSettings, VerdictSettings
from .track import TrackSettings
from .triangulation import ReconstructSettings

__all__ = [
    "QUALITIES",
    "Config",
    "DressSettings",
    "EvidenceSettings",
    "InnerSettings",
    "LoopSettings",
    "NricpSettings",
    "OpeningSettings",
    "PlacementSettings",
    "PowerOfTwo",
    "PrintSettings",
    "ReconstructSettings",
    "SegmentSettings",
    "Settings",
    "TrackSettings",
    "VerdictSettings",
    "changed",
    "configured",
    "from_options",
    "listed",
    "preset",
    "read_config",
    "read_set",
    "setting",
]
