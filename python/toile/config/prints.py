"""Settings of sliding garments until their prints lie still."""

from __future__ import annotations

from pydantic import model_validator

from .settings import Settings, setting


class PrintSettings(Settings):
    """Garments slid until their prints lie still. Lengths on the garment's rest shape; colours as differences of logarithms."""

    lattice_spacing: float = setting(0.0045, "m", "of the points that prints are read at", gt=0)
    blurs: tuple[float, ...] = setting((0.012, 0.006, 0.003), "m", "of the print, coarse to fine")
    blur_steps: tuple[int, ...] = setting((5, 3, 2), "count", "Gauss-Newton steps at each blur")
    follow_share: float = setting(1.0, "1", "of those steps where a slide follows one found before", gt=0, le=1)
    wide_blurs: tuple[float, ...] = setting(
        (0.048, 0.024), "m", "before those, of a print laid on a template's texture"
    )
    wide_steps: tuple[int, ...] = setting((12, 10), "count", "Gauss-Newton steps at each of them")
    wide_strain: float = setting(0.4, "1", "`slide_strain` there: a template may be of other proportions", gt=0)
    wide_edge_strain: float = setting(0.1, "1", "`edge_strain` there", gt=0)
    shade_blurs: float = setting(4.0, "1", "light varies slower than so many blurs", gt=0)
    lightness_noise: float = setting(0.10, "1", "noise of lightness, of which shading adds more than of colour", gt=0)
    chroma_noise: float = setting(0.05, "1", "noise of colour at equal lightness", gt=0)
    robust_noise: float = setting(2.0, "sigma", "residuals of more noise than this count less and less", gt=0)
    strain_length: float = setting(
        0.02, "m", "distance between two points over which slides and lengths are compared", gt=0
    )
    slide_strain: float = setting(0.10, "1", "slides usually differ by this share of that distance", gt=0)
    edge_strain: float = setting(0.05, "1", "edges usually differ by this share from the template's", gt=0)
    edge_outlier: float = setting(
        0.20, "1", "edges longer or shorter by more count less and less: they are folds", gt=0
    )
    length_steps: int = setting(5, "count", "Gauss-Newton steps by lengths alone", ge=0)
    slide_length: float = setting(0.10, "m", "a slide without any print about it is held to zero this loosely", gt=0)
    step_length: float = setting(0.010, "m", "longest step of an iteration", gt=0)
    hold_loops: bool = setting(False, "switch", "vertices of openings stay, else they slide along their loops")
    anchor_frames: int = setting(10, "count", "of the first chunk that make the reference, at most", ge=1)
    sample_frames: int = setting(10, "count", "spread over the run that join it", ge=0)
    mean_rounds: int = setting(2, "count", "of laying them upon their mean", ge=0)
    slide_time: float = setting(0.05, "s", "slides vary slower than this over time", ge=0)
    drift_time: float = setting(0.003, "s", "where nothing is known they drift away as if so little time went by", ge=0)

    @model_validator(mode="after")
    def _as_many_steps_as_blurs(self) -> PrintSettings:
        if not len(self.blurs) == len(self.blur_steps) > 0:
            raise ValueError("blurs and blur_steps: expected as many of each")
        if len(self.wide_blurs) != len(self.wide_steps):
            raise ValueError("wide_blurs and wide_steps: expected as many of each")
        return self
