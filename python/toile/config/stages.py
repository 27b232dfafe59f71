"""Settings of the stages of `toile register`: one small model each."""

from __future__ import annotations

from pydantic import model_validator

from .kernels import (
    BiharmonicSettings,
    InnerSolverSettings,
    MrfSettings,
    NricpSettings,
    SkeletonSettings,
    UntangleSettings,
)
from .settings import Settings, setting
from .stereo import StereoSettings
from .triangulation import ReconstructSettings


class SearchSettings(Settings):
    """Quick fits of the body to a scan from many headings, where no frame before gives a start."""

    reach: float = setting(0.15, "m", "closest points farther than this do not count", gt=0)
    surface_samples: int = setting(800, "count", "vertices that look for the scan", ge=1)
    max_iterations: int = setting(12, "count", "Levenberg-Marquardt steps of each, at most", ge=1)
    astray: float = setting(
        0.02,
        "1",
        "share of the scan and of the body, both, that lie 5 cm from one another: beyond, the body is not where the scan is",
        ge=0,
        le=1,
    )
    farther: float = setting(
        1.5, "1", "times the last frame's distance: farther from the scan than this a frame is lost", gt=1
    )
    stride: float = setting(0.5, "rad", "of either leg, forwards and backwards, in mid-stride", ge=0)
    strides: int = setting(2, "count", "best headings that are tried in mid-stride too", ge=0)
    as_close: float = setting(
        1.25, "1", "times another frame's distance: as close in its heading, none else is tried", gt=0
    )
    upright: float = setting(0.5, "rad", "a scan whose long axis leans more than this may be of one who lies", ge=0)


class StartsSettings(Settings):
    """Other starts of a frame's pose than the pose of the frame before, see surface/starts.py."""

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
    starts: StartsSettings = StartsSettings()
    search: SearchSettings = SearchSettings()
    skeleton: SkeletonSettings = SkeletonSettings()


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
    depth: tuple[float, float] = setting((-0.003, 0.012), "m", "layers searched, from below to above the scan")
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


class LoopSettings(Settings):
    """A template's loops, laid on the openings that a frame shows."""

    reach: float = setting(0.10, "m", "an opening of the scan farther than this from a loop is not its own", gt=0)
    final_reach: float = setting(0.3, "1", "share of that reach in the last step", gt=0, le=1)
    matched_distance: float = setting(0.015, "m", "an opening this close to a loop that was laid is seen there", gt=0)
    claimed_distance: float = setting(0.02, "m", "openings farther than this from every loop belong to none", gt=0)
    min_cosine: float = setting(0.4, "1", "least agreement of directions of loop and opening", ge=-1, le=1)
    turn: float = setting(0.05, "m", "distance that a difference of one in unit direction is worth", ge=0)
    spacing: float = setting(0.002, "m", "of samples along the openings", gt=0)
    min_length: float = setting(0.02, "m", "shorter openings are specks of labels", ge=0)
    steps: int = setting(8, "count", "of matching", ge=1)
    bending: float = setting(30.0, "1", "cost of bending a loop's displacement against its distance, at first", ge=0)
    bending_decades: float = setting(2.0, "1", "powers of ten by which it falls to the last step", ge=0)
    slide: float = setting(
        0.3, "1", "weight of a residual along the loop against one across it: loops slide", ge=0, le=1
    )
    stretch: float = setting(0.05, "1", "cost of stretching a loop's edge against its distance", ge=0)
    stretch_share: float = setting(1e-3, "1", "of the bending's cost that is added to it", ge=0)
    max_slant: float = setting(
        0.5, "1", "way along the loop that a match may lie off, as a share of its distance", ge=0
    )
    max_slide: float = setting(0.3, "1", "the same as a share of the loop's edge; the larger counts", ge=0)
    smoothing: float = setting(0.008, "m", "Gaussian along a loop before pictures are searched beside it", gt=0)
    min_log_odds: float = setting(0.3, "1", "log odds on either side of an opening that count as seen", ge=0)
    min_observed: float = setting(0.25, "1", "least observed share of a loop that is drawn to its opening", ge=0, le=1)
    background_way: float = setting(
        0.01, "m", "way that a loop follows background alone: a strip that leaves the cloth meets it too", ge=0
    )
    stay_weight: float = setting(0.05, "1", "of staying, where no opening is seen, against a seen one", ge=0)
    near: float = setting(
        0.03, "m", "a posed loop nearer than this to the scan's opening waits for pictures to lay it", ge=0
    )
    whole_share: float = setting(
        0.75, "1", "observed share of a loop from which on it is laid on the scan's opening all the same", ge=0
    )


class PlacementSettings(Settings):
    """A template laid on the body at rest, where the capture shows its garment."""

    lies: float = setting(0.05, "m", "mean distance of a template to where the capture shows it, at most", gt=0)
    near: float = setting(0.06, "m", "a template off by less is left where it is", gt=0)
    clearly: float = setting(1.25, "1", "factor by which one way to lay it is nearer than another", gt=1)
    size: tuple[float, float] = setting((0.5, 2.0), "1", "of a template, and of a rim, against those of the capture")
    same_size: float = setting(1.2, "1", "factor within which a template is of the person's size", gt=1)
    rim_near: float = setting(0.09, "m", "a rim nearer than this to the capture's is left to the frames", gt=0)
    rim_reach: float = setting(0.25, "m", "a rim farther than this from the capture's is of another cut", gt=0)
    limbs_reach: float = setting(
        0.18,
        "m",
        "a hem about two limbs, nearer than this to the rims that the capture shows about each, is theirs",
        gt=0,
    )
    loop: LoopSettings = LoopSettings(reach=0.3)


class DressSettings(Settings):
    """Garments from labelled scans."""

    trace_openings: bool = setting(
        True, "switch", "find openings that hang free of the scan in the pictures, and refine again"
    )
    nricp: NricpSettings = NricpSettings(
        iterations=(0, 2, 0),
        fine_iterations=3,
        relative_fine_length=0.005,
        fine_noise=5.0,
        relative_fine_robust=0.01,
        boundary_weight=0.1,
        border_weight=0.0,
    )
    traced_nricp: NricpSettings = NricpSettings(
        iterations=(0, 0, 0),
        fine_iterations=3,
        relative_fine_length=0.005,
        fine_noise=5.0,
        relative_fine_robust=0.01,
        boundary_weight=1.0,
        border_weight=0.0,
    )
    free_reach: float = setting(
        0.05, "m", "about a loop, cloth that lies off the scan goes on as the cloth on the scan leads", ge=0
    )
    min_faces: int = setting(100, "count", "faces of the scan that carry the garment, else the frame fails", ge=1)
    fit_reach: float = setting(0.04, "m", "reach of the body's shape when a template is carried to the person", gt=0)
    skin_smoothing: int = setting(10, "count", "umbrella steps on transferred skinning weights", ge=0)
    fit_frames: int = setting(6, "count", "sampled frames that personalise the rest shape, 0 for none", ge=0)
    fit_stiffness: float = setting(
        0.3, "1", "smoothness of the personal displacement against one sample's evidence", ge=0
    )
    unseen_weight: float = setting(
        1e-6, "1", "of staying where the body carried the template, against one sample's evidence", gt=0
    )
    covered_weight: float = setting(
        1e-2, "1", "the same of a garment worn under another: what is hidden is no gap, but ends in the dark", gt=0
    )
    observed_distance: float = setting(0.006, "m", "a vertex this close to the labelled scan is observed", gt=0)
    interpolated_distance: float = setting(0.05, "m", "within this of an observed one it is interpolated", ge=0)
    contact: float = setting(0.012, "m", "a hand vertex this close to the garment touches it", ge=0)
    contact_share: float = setting(0.05, "1", "of one hand's vertices that makes an unsupported contact", ge=0, le=1)
    size_tolerance: float = setting(0.15, "1", "loop lengths off by more than this share are reported", ge=0)
    whole_rank: float = setting(
        0.6,
        "1",
        "of the lengths that the sampled frames show of an opening, from the shortest to the longest: the one that counts as "
        "whole; more of them are cut off than run over",
        ge=0,
        le=1,
    )
    whole_opening: float = setting(
        0.85, "1", "an opening shorter than this share of that, or as much longer, is not shown there", gt=0, le=1
    )
    measured_share: float = setting(0.6, "1", "observed share of a loop from which on its length counts", ge=0, le=1)
    placement: PlacementSettings = PlacementSettings()
    loop: LoopSettings = LoopSettings()
    biharmonic: BiharmonicSettings = BiharmonicSettings()


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


class MotionSettings(Settings):
    """Smoothing over consecutive frames."""

    temporal: bool = setting(True, "switch", "smooth pose and surfaces over consecutive frames")
    margin: int = setting(12, "count", "frames read on either side of a block, so that its border shows no seam", ge=2)
    samples: int = setting(1000, "count", "vertices of a surface that tell its noise from its motion", ge=1)
    max_strength: float = setting(10.0, "1", "of second differences against displacements, at most", gt=0)
    turn_share: float = setting(
        0.5, "1", "of the strength found of joint angles: fingers flicker most, legs swing most", ge=0, le=1
    )
    across_share: float = setting(
        0.5, "1", "of the strength found across a surface: folds that pass look like noise there", ge=0, le=1
    )
    interpolated_weight: float = setting(
        0.2, "1", "of an interpolated vertex' place against an observed one's", gt=0, le=1
    )
    hidden_weight: float = setting(0.05, "1", "of a hidden vertex' place against an observed one's", gt=0, le=1)
    outlier: float = setting(
        4.0, "sigma", "a place this far from where its neighbours in time put it counts half", gt=0
    )


class InnerSettings(Settings):
    """The body under the garments, and the garments out of it."""

    tolerance: float = setting(2e-4, "m", "a frame's fit ends when no vertex moves by more", gt=0)
    spike: float = setting(
        1.0,
        "1",
        "the run warns where the fused body's displacement parts the ends of an edge by more, over its length",
        gt=0,
    )
    spike_length: float = setting(0.008, "m", "edges count as at least this long there", gt=0)
    solver: InnerSolverSettings = InnerSolverSettings()
    untangle: UntangleSettings = UntangleSettings()
    layering_rounds: int = setting(
        3, "count", "of pushing garments out, at most: a push out of one layer may lead into another, or stall", ge=1
    )


class VerdictSettings(Settings):
    """From where on a frame is doubtful, and from where on it is wrong, by what it shows of its layers; see
    measure/verdicts.py. The worst measure decides. Calibrated by bench/verdicts.py."""

    two_sided_mm: tuple[float, float] = setting(
        (12.0, 30.0), "mm", "the tracked surface and the scan, mean distance from the side that is nearer"
    )
    scan_edge_mm: tuple[float, float] = setting((50.0, 200.0), "mm", "median length of the edges of the frame's scan")
    apart: tuple[float, float] = setting(
        (0.02, 0.1), "1", "share of the scan and of the tracked surface, both, that lie 2 cm from one another"
    )
    astray: tuple[float, float] = setting(
        (0.05, 0.15), "1", "share of the scan and of the posed body, both, that lie 5 cm from one another"
    )
    pose_mm: tuple[float, float] = setting(
        (40.0, 60.0), "mm", "the posed body and the scan, mean distance of both sides"
    )
    moved_mm: tuple[float, float] = setting(
        (20.0, 50.0), "mm", "by how much the posed body was bent to the scan, mean over its outside"
    )
    keypoint_mm: tuple[float, float] = setting((50.0, 80.0), "mm", "keypoints to those detected, median")
    silhouette_iou: tuple[float, float] = setting((0.93, 0.85), "1", "overlap of silhouette and masks, at least")
    observed: tuple[float, float] = setting(
        (0.4, 0.1), "1", "share of the body's surface found on the scan, at least, where nothing else shows the body"
    )
    garment_observed: tuple[float, float] = setting(
        (0.3, 0.1), "1", "share of a garment's vertices found on the labelled scan, at least"
    )
    garment_mm: tuple[float, float] = setting(
        (10.0, 30.0), "mm", "a garment and the labelled scan, mean distance from the side that is nearer"
    )
    loop_mm: tuple[float, float] = setting((20.0, 40.0), "mm", "a loop to the opening that was seen, the worst")
    loop_length: tuple[float, float] = setting(
        (1.5, 3.0),
        "1",
        "length of a loop against its opening's in the frames of the preparation, or the other way round",
    )
    unclaimed_opening_mm: tuple[float, float] = setting((1200.0, 5000.0), "mm", "openings that belong to no loop")
    edge_stretch: tuple[float, float] = setting(
        (0.35, 0.6), "1", "|log of the stretch| of a garment's edges, what 95 % stay below"
    )
    stretch_p95: tuple[float, float] = setting(
        (2.0, 3.0), "1", "stretch of a garment, what 95 % of its area stay below"
    )
    pairs_left: tuple[float, float] = setting(
        (0.0, 1000.0), "count", "pairs of a garment's triangles and of those under it that go through one another"
    )
    flipped_share: tuple[float, float] = setting((0.05, 0.15), "1", "of a garment's area, turned over by the fit")


class Config(Settings):
    """All settings of a run, as RUN/config.toml keeps them."""

    quality: str = setting("standard", "name", "draft or standard: the preset that the others start from")
    preparation_frames: int = setting(
        6, "count", "spread over the run, that make the person, the colours and the templates", ge=1
    )
    scan_spacing: float = setting(
        0.014,
        "m",
        "labels and garments see scans thinned to vertices about this far apart; 0: as they are",
        ge=0,
        le=0.1,
    )
    picture_side: int = setting(
        2048, "px", "labels and garments see pictures thinned until no side is longer", ge=64, le=65536
    )
    template_from_scan: tuple[str, ...] = setting(
        (), "name", "garments whose template is cut from the tracked surface of those frames, by their labels"
    )
    make_scans: bool = setting(
        True, "switch", "make scans from the pictures of frames that bring none, as `toile reconstruct` does"
    )
    least_depth: float = setting(
        0.2, "1", "share of the person's pixels that must have a depth; below, a frame goes without a scan", ge=0, le=1
    )
    stereo: StereoSettings = StereoSettings()
    reconstruct: ReconstructSettings = ReconstructSettings()
    track: TrackSettings = TrackSettings()
    segment: SegmentSettings = SegmentSettings()
    dress: DressSettings = DressSettings()
    prints: PrintSettings = PrintSettings(
        lattice_spacing=0.006,
        blurs=(0.012, 0.006),
        blur_steps=(4, 3),
        follow_share=0.4,
        anchor_frames=4,
        sample_frames=4,
        mean_rounds=1,
        hold_loops=True,
    )
    motion: MotionSettings = MotionSettings()
    inner: InnerSettings = InnerSettings()
    verdict: VerdictSettings = VerdictSettings()
