"""Settings of the alignment."""

from ..config import Settings


class AlignSettings(Settings):
    """Lengths in metres on the garment's rest shape; colours as differences of logarithms."""

    spacing: float = 0.0045  # of the points that prints are read at
    blur: tuple[float, ...] = (0.012, 0.006, 0.003)  # of the print, coarse to fine
    iterations: tuple[int, ...] = (5, 3, 2)  # Gauss-Newton steps at each blur
    shade: float = 4.0  # light varies slower than so many blurs
    light: float = 0.10  # noise of lightness
    chroma: float = 0.05  # noise of colour at equal lightness
    robust: float = 2.0  # residuals of more noise than this count less and less
    strain: float = 0.10  # slides usually differ by this share of the distance between two points...
    reach: float = 0.02  # ...so far apart
    stretch: float = 0.05  # edges usually differ by this share from the template's, over the same reach
    torn: float = 0.20  # edges longer or shorter by more count less and less
    settling: int = 5  # Gauss-Newton steps by lengths alone
    slip: float = 0.10  # a slide without any print about it is held to zero this loosely
    stride: float = 0.010  # longest step of an iteration
    anchors: int = 10  # frames of the first chunk that make the reference, at most
    samples: int = 10  # frames spread over the run that join it
    rounds: int = 2  # of laying them upon their mean
    margin: float = 0.002  # off what lies under, where cloth has come to meet it
    steady: float = 0.05  # slides vary slower than this over time [s]...
    still: float = 0.003  # ...and where nothing is known do not drift away [s]
