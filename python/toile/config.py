"""Settings of the stages: one small model each; the presets and the command line fill the same objects."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """An unknown field is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ReconstructSettings(Settings):
    """Triangulation of 2D keypoints."""

    pixel_sigma: float = 2.0  # noise of a keypoint [px]
    inlier_pixels: float = 8.0  # reprojection error of an inlier [px]
    min_confidence: float = 0.1  # below, a keypoint counts as unseen
    min_views: int = 2  # inlier views that a point needs; one more where four or more views saw it
    min_angle: float = 0.03  # between the rays of a pair [rad]
    exhaustive_views: int = 16  # up to here all pairs are tried
    pairs: int = 120  # beyond, this many drawn pairs
    iterations: int = 5  # of Gauss-Newton
    seed: int = 0
