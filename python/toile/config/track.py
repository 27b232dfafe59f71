"""Settings of tracking."""

from __future__ import annotations

from .kernels import NricpSettings, SkeletonSettings
from .settings import Settings, setting


class StartsSettings(Settings):
    """Other starts of a frame's pose than the pose of the frame before, see surface/starts.py."""

    reach: float = setting(0.15, "m", "closest points farther than this do not count in the coarse fit", gt=0)
    surface_samples: int = setting(800, "count", "vertices that look for the scan in it", ge=1)
    max_iterations: int = setting(12, "count", "Levenberg-Marquardt steps of it, at most", ge=1)
    doubtful: float = setting(
        1.1, "1", "times the usual distance from the scan: where a pose lies farther, other starts are tried", ge=1
    )
    follow_rounds: int = setting(3, "count", "fits in which the last surface follows the scan, at most", ge=1)
    follow_nearer: float = setting(
        0.95, "1", "times the distance before: where a fit comes no nearer than this, the last is kept", gt=0, le=1
    )
    least_match: float = setting(
        0.1, "1", "weight of a vertex' match, below which the pose is told that it was not seen", ge=0, le=1
    )


class SearchSettings(Settings):
    """Quick fits of the body to a scan from many headings and postures, where no frame before gives a start, see
    surface/pose_search.py."""

    reach: float = setting(0.15, "m", "closest points farther than this do not count", gt=0)
    surface_samples: int = setting(500, "count", "vertices that look for the scan", ge=1)
    max_iterations: int = setting(8, "count", "Levenberg-Marquardt steps of each, at most", ge=1)
    astray: float = setting(
        0.02,
        "1",
        "share of the scan and of the body, both, that lie 5 cm from one another: beyond, the body is not where the scan is",
        ge=0,
        le=1,
    )
    sure: float = setting(
        0.005, "1", "the same share of the best first fit, up to which no other than that is kept", ge=0, le=1
    )
    hopeless: float = setting(
        0.25, "1", "the same share of a first fit: beyond, no limb laid elsewhere mends it", ge=0, le=1
    )
    farther: float = setting(
        1.5, "1", "times the last frame's distance: farther from the scan than this a frame is lost", gt=1
    )
    scan_spacing: float = setting(0.02, "m", "between the vertices of the scan as the quick fits see it", ge=0, le=0.1)
    ground_height: float = setting(0.04, "m", "of the slab of a scan that may be its floor", gt=0)
    ground_share: float = setting(
        0.08, "1", "of the scan's area: where more looks straight up in one slab, it is a floor and left out", gt=0
    )
    kept: int = setting(3, "count", "best of the first fits, whose limbs are then laid other ways one by one", ge=1)
    limb_rounds: int = setting(2, "count", "times that all limbs are laid other ways, at most", ge=0)
    nearer: float = setting(
        0.97,
        "1",
        "times the distance before: where all limbs gained less than this, no other round follows",
        gt=0,
        le=1,
    )
    as_close: float = setting(
        1.25, "1", "times another frame's distance: as close in its heading, none else is tried", gt=0
    )
    upright: float = setting(0.5, "rad", "a scan whose long axis leans more than this may be of one who lies", ge=0)


class TrackSettings(Settings):
    """Pose and surface of the single layer."""

    scan_spacing: float = setting(
        0.0, "m", "all stages see scans thinned to vertices about this far apart; 0: as they are", ge=0, le=0.1
    )
    surface_samples: int = setting(
        2500, "count", "vertices of the body that look for the scan when a frame's pose is fitted", ge=1
    )
    nricp: NricpSettings = NricpSettings(
        iterations=(0, 8, 0), fine_iterations=2, fine_sweeps=5, relative_fine_length=0.004, fine_noise=5.0
    )
    rest_smoothing: int = setting(5, "count", "umbrella steps on the personal offsets, which carry scan noise", ge=0)
    min_cosine: float = setting(
        0.3, "1", "least agreement of a vertex' normal with its scan point's: else it is another limb's", ge=-1, le=1
    )
    observed_distance: float = setting(0.004, "m", "a tracked vertex this close to the scan is observed", gt=0)
    interpolated_distance: float = setting(0.02, "m", "within this it is interpolated, beyond hidden", gt=0)
    pose_vertices: int = setting(
        400, "count", "vertices of the fitted surface that the pose is fitted to again, 0 for none", ge=0
    )
    pose_vertex_sigma: float = setting(0.01, "m", "noise of such a vertex against the posed model", gt=0)
    pose_unseen_factor: float = setting(4.0, "1", "times so much where the scan did not show it", ge=1)
    carried_share: float = setting(
        0.7, "1", "of the way off the pose of the frame before, with which a frame's fit starts", ge=0, le=1
    )
    carried_reach: float = setting(0.1, "m", "a vertex that was farther off its pose counts as this far", gt=0)
    headings: int = setting(
        8, "count", "about the up axis, from which a pose is searched where no frame before it gives one; 0: none", ge=0
    )
    keypoint_few_frames: float = setting(
        3.0,
        "count",
        "frames whose offsets of keypoints from the model's count half; more: keypoints are the model's",
        ge=0,
    )
    face_sigma: float = setting(
        0.003,
        "m",
        "noise of the tracked surface at a facial keypoint; pose_unseen_factor times so much where it is interpolated",
        gt=0,
    )
    face_reach: float = setting(
        0.04, "m", "a facial keypoint farther than this from the tracked surface's is none", gt=0
    )
    starts: StartsSettings = StartsSettings()
    search: SearchSettings = SearchSettings()
    skeleton: SkeletonSettings = SkeletonSettings()
