"""Settings of segmentation, and of the evidence that pictures give."""

from __future__ import annotations

from .kernels import MrfSettings
from .settings import Rising, Settings, setting


class EvidenceSettings(Settings):
    """What pictures say of a point in space."""

    depth_step: float = setting(
        0.03, "m", "a step of depth this high parts two surfaces, whose colours mix beside it", gt=0
    )
    depth_border: int = setting(1, "px", "so wide a border of such a step is not read", ge=0)
    picture_margin: float = setting(0.06, "m", "pictures are read this far beyond the surface's outline", gt=0)
    max_log_odds: float = setting(
        4.0, "1", "one picture's log likelihood ratio counts up to this: it may be wrong", gt=0
    )
    given_weight: float = setting(0.5, "1", "of the given labels' log odds: their errors are alike in all views", ge=0)
    floating_distance: float = setting(0.02, "m", "a point this far before the surface floats", gt=0)
    behind_share: float = setting(
        0.5, "1", "a label that fills more of the picture behind a floating point says nothing of it", ge=0, le=1
    )
    off_scan_distance: float = setting(0.005, "m", "a point this far from the scan is off it", gt=0)
    empty_blur: float = setting(1.0, "px", "uncertainty of the silhouette", gt=0)
    empty_share: float = setting(0.6, "1", "background about a pixel from which on it speaks against cloth", ge=0, le=1)
    outside_share: float = setting(
        0.9, "1", "background about a point from which on a picture shows it outside", ge=0, le=1
    )
    outside_views: int = setting(2, "count", "pictures that show an opening's point outside, for it to be none", ge=1)
    outside_cloth: float = setting(
        0.1, "1", "of a garment's scan outside, from which on pictures and scan disagree and openings stay", ge=0, le=1
    )
    outside_loop: float = setting(
        0.5, "1", "of a loop outside, from which on masks lack the cloth and it stays", ge=0, le=1
    )
    empty_ramp: float = setting(0.35, "1", "by so much more background it speaks fully", gt=0)
    edge_flank: float = setting(
        0.55, "1", "share of a colour profile's half length beyond which its end colours are read", gt=0, lt=1
    )
    edge_contrast: float = setting(0.1, "1", "difference of RGB (0..1) that makes an edge worth reading", gt=0)
    edge_disorder: float = setting(
        0.1, "1", "share of that difference which prints and folds may add to a profile that is believed", gt=0
    )
    edge_shift: float = setting(0.6, "1", "largest shift of an edge, as a share of the profile's half length", gt=0)


class OpeningSettings(Settings):
    """A garment's border, searched along strips of the surface about it."""

    reach: float = setting(0.030, "m", "search range to either side", gt=0)
    step: float = setting(0.002, "m", "of the search", gt=0)
    spacing: float = setting(0.004, "m", "of samples along the border", gt=0)
    min_length: float = setting(0.02, "m", "shorter borders are specks of labels", ge=0)
    presmoothing: float = setting(3.0, "count", "Gaussian along the border before the search, in samples", gt=0)
    stiffness: float = setting(0.15, "1", "cost of a unit step of the border between neighbouring samples", ge=0)
    stay_cost: float = setting(0.02, "1", "of a unit step away: stay where nothing speaks", ge=0)
    evidence_length: float = setting(0.004, "m", "of a strip whose log odds count once: nearer points are alike", gt=0)
    flank: float = setting(0.012, "m", "of the strip on either side that is asked whether an opening is seen", gt=0)
    smoothing: float = setting(0.012, "m", "Gaussian along the border that was found", gt=0)
    depth: Rising = setting((-0.003, 0.012), "m", "layers searched, from below to above the scan")
    layer: float = setting(0.003, "m", "between layers", gt=0)
    layer_steps: int = setting(6, "count", "search steps to either side in those layers", ge=1)
    rounding: float = setting(0.003, "m", "by which the rounded step of a scan lies under the opening of cloth")
    lift: float = setting(0.5, "1", "cost of the first layer off that; it grows with the square", ge=0)
    layer_stiffness: float = setting(40.0, "1", "cost of a change of layer against a unit step along the surface", ge=0)
    min_log_odds: float = setting(0.05, "1", "least log odds on either side of an opening that is seen", ge=0)
    edge_reach: float = setting(0.016, "m", "half length of the colour profiles that place it within a pixel", gt=0)
    edge_prior: float = setting(0.03, "1", "weight of no shift against the profiles'", ge=0)
    ramp: float = setting(0.012, "m", "half width of the probability's ramp about the border", gt=0)


class SegmentSettings(Settings):
    """Labels from pictures, votes and colours."""

    views: int = setting(0, "count", "pictures a frame that are read, spread about the person; 0: all", ge=0)
    refine_border: bool = setting(
        False,
        "switch",
        "place a garment's border between scan vertices by the pictures' edges in every frame, though they place its "
        "openings later; in the frames that make its template, and without pictures, that is done anyway",
    )
    label_error_share: float = setting(0.15, "1", "of the given labels, taken to be wrong", gt=0, lt=1)
    skin_colour: float = setting(
        0.08,
        "1",
        "of chroma over lightness: legs that a network calls skin, and whose colours are farther from those of head and hands, are "
        "what the scene says covers them; bare limbs of one person differ by up to 0.075. 0: its word is taken",
        ge=0,
    )
    completion_rounds: int = setting(
        1, "count", "in which label images that the sampled frames lack are told from the others, and count", ge=0
    )
    sure_share: float = setting(
        0.8, "1", "least probability of a pixel's label where no label image is given; below it has none", gt=0, le=1
    )
    coarse_pixel: float = setting(0.012, "m", "width at the person from which on pictures are warned of", gt=0)
    label_blur: float = setting(3.0, "px", "uncertainty of a given border", gt=0)
    colour_pixels: int = setting(400_000, "count", "drawn from the samples for the colour models", ge=1)
    colour_iterations: int = setting(4, "count", "of expectation maximisation", ge=0)
    prior_floor: float = setting(
        0.03, "1", "least probability of a label at a place on the tracked surface", gt=0, lt=1
    )
    depth_tolerance: float = setting(
        0.012, "m", "of the depth test: farther behind the surface a point is hidden", gt=0
    )
    min_cosine: float = setting(0.15, "1", "views more grazing than this see nothing", ge=0, lt=1)
    colour_weight: float = setting(1.5, "1", "of what colours say", ge=0)
    label_weight: float = setting(1.0, "1", "of what given labels say", ge=0)
    prior_weight: float = setting(0.5, "1", "of how often a place carried a label in the sampled frames", ge=0)
    previous_weight: float = setting(0.3, "1", "cost of leaving the previous frame's label", ge=0)
    vote_weight: float = setting(100.0, "1", "of a label that votes.json prefers or forbids at a place", ge=0)
    smoothness: float = setting(2.0, "1", "Potts cost of an edge of mean length on flat colour", ge=0)
    smoothness_floor: float = setting(0.1, "1", "added for every edge, so that no label flickers along a print", ge=0)
    max_edge_ratio: float = setting(
        2.0, "1", "edges longer than so many mean ones cost no more: one web is no wall", gt=0
    )
    colour_contrast: float = setting(
        0.08, "1", "difference of RGB (0..1) between neighbours that halves that cost", gt=0
    )
    tracked_smoothness: float = setting(
        0.5, "1", "share of it on the tracked surface, whose labels come smoothed", ge=0
    )
    near_weight: float = setting(4.0, "1", "of the scan's log probability at a tracked vertex near it", ge=0)
    near_floor: float = setting(1e-3, "1", "probability that is added there: no label is impossible", gt=0)
    unseen_weight: float = setting(2.0, "1", "the same where no picture shows the vertex", ge=0)
    unseen_floor: float = setting(0.02, "1", "probability that is added there", gt=0)
    min_region: float = setting(0.004, "m^2", "smaller islands of a label are dissolved", ge=0)
    doubted_region: float = setting(
        0.025, "m^2", "islands up to this are dissolved where their colours are rather those around them", ge=0
    )
    seed: int = setting(0, "count", "of the drawn pixels", ge=0)
    evidence: EvidenceSettings = EvidenceSettings()
    opening: OpeningSettings = OpeningSettings()
    mrf: MrfSettings = MrfSettings()
