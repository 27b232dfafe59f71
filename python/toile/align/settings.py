"""Settings of the alignment."""

from ..config import PrintSettings, setting


class AlignSettings(PrintSettings):
    """Lengths on the garment's rest shape; colours as differences of logarithms. A finished run is given more time than
    `register` takes."""

    follow_steps: tuple[int, ...] = setting((5, 3, 2), "count", "Gauss-Newton steps where a slide was found before")
    anchor_frames: int = setting(10, "count", "of the first chunk that make the reference, at most", ge=1)
    sample_frames: int = setting(10, "count", "spread over the run that join it", ge=0)
    mean_rounds: int = setting(2, "count", "of laying them upon their mean", ge=0)
    margin: float = setting(0.002, "m", "off what lies under, where cloth has come to meet it", gt=0)
