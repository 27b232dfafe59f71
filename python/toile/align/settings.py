"""Settings of the alignment."""

from ..config import PrintSettings, setting


class AlignSettings(PrintSettings):
    """Lengths on the garment's rest shape; colours as differences of logarithms."""

    margin: float = setting(0.002, "m", "off what lies under, where cloth has come to meet it", gt=0)
