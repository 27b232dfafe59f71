"""Settings: what decides the results of a command, as small models that presets, files and options fill alike."""

from .changes import changed, from_options, read_config, read_set
from .kernels import NricpSettings
from .presets import QUALITIES, configured, preset
from .settings import Settings, listed, setting
from .stages import (
    Config,
    DressSettings,
    EvidenceSettings,
    InnerSettings,
    LoopSettings,
    OpeningSettings,
    PlacementSettings,
    PrintSettings,
    SegmentSettings,
    TrackSettings,
    VerdictSettings,
)
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
