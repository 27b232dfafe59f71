"""Settings of keypoints in space."""

from __future__ import annotations

from .settings import Rising, Settings, setting


class ReconstructSettings(Settings):
    """Triangulation of 2D keypoints."""

    pixel_sigma: float = setting(2.0, "px", "noise of a keypoint", gt=0)
    inlier_share: float = setting(
        1 / 64,
        "1",
        "reprojection error of an inlier at first, as a share of a picture's longer side: 8 px of 512",
        gt=0,
    )
    inlier_sigmas: float = setting(4.0, "sigma", "the same in multiples of the noise that a frame shows", gt=0)
    inlier_range: Rising = setting(
        (0.75, 3.0), "1", "how far the frame's noise may narrow and widen it, times what it was at first"
    )
    inlier_near: float = setting(0.35, "1", "a change by less than this share of it is not worth another fit", ge=0)
    min_confidence: float = setting(0.1, "1", "below, a keypoint counts as unseen", ge=0, le=1)
    min_views: int = setting(2, "count", "inlier views that a point needs; one more where four or more saw it", ge=2)
    min_angle: float = setting(0.03, "rad", "between the rays of a pair: flatter ones cross anywhere", gt=0)
    exhaustive_views: int = setting(16, "count", "up to so many views all pairs are tried", ge=2)
    drawn_pairs: int = setting(120, "count", "beyond, this many drawn pairs", ge=1)
    gauss_newton_steps: int = setting(5, "count", "on the reprojection error of the inliers", ge=1)
    apart: float = setting(
        0.12, "m", "half of a frame's points farther than this from a whole scan: cameras and scans do not agree", gt=0
    )
    whole: float = setting(0.8, "1", "a scan this share as long as the points are is a whole one", gt=0)
    seed: int = setting(0, "count", "of the drawn pairs", ge=0)
