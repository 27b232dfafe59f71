"""Settings of the stages: one small model each; the presets and the command line fill the same objects."""

from pydantic import BaseModel, ConfigDict, Field


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


class SegmentSettings(Settings):
    """Labels from pictures, votes and colours."""

    views: int = 0  # pictures a frame that are read, spread about the person; 0: all
    refine_border: bool = True  # place a garment's border between scan vertices by the pictures' edges
    label_error_share: float = 0.15  # of the given labels, taken to be wrong
    label_blur: float = 3.0  # uncertainty of a given border [px]
    colour_pixels: int = 400_000  # drawn from the samples for the colour models
    colour_iterations: int = 4
    prior_floor: float = 0.03  # least probability of a label at a place on the tracked surface
    tolerance: float = 0.012  # depth test [m]
    min_cosine: float = 0.15  # views more grazing than this see nothing
    colour_weight: float = 1.5
    label_weight: float = 1.0
    prior_weight: float = 0.5
    previous_weight: float = 0.3  # cost of leaving the previous frame's label
    smoothness: float = 2.0  # Potts cost of an edge of mean length on flat colour
    contrast: float = 0.08  # difference of RGB (0..1) between neighbours that halves that cost
    opening_reach: float = 0.030  # search range of a garment's border [m]
    opening_step: float = 0.002  # [m]
    opening_stiffness: float = 0.15  # cost of a unit step of the border between samples one spacing apart
    opening_spacing: float = 0.004  # [m]
    opening_smoothing: float = 0.012  # Gaussian along the border [m]
    opening_depth: tuple[float, float] = (-0.003, 0.012)  # layers searched below and above the scan [m]
    opening_layer: float = 0.003  # [m]
    opening_lift: float = 0.5  # cost of the first layer off the scan; grows with the square
    opening_log_odds: float = 0.05  # least log odds on either side of an opening
    edge_reach: float = 0.016  # half length of the colour profiles that place the border within a pixel [m]
    ramp: float = 0.012  # half width of the probability's ramp about the border [m]
    min_region: float = 0.004  # smaller islands of a label are dissolved [m^2]
    seed: int = 0


class DressSettings(Settings):
    """Garments from labelled scans."""

    trace_openings: bool = True  # find openings that hang free of the scan in the pictures, and refine again
    stiffness: float = 0.05  # of a garment's bending against its distance to the scan
    refinement_steps: int = Field(
        6, ge=1, le=6
    )  # of the schedule of falling stiffness; fewer are faster and stop farther from the scan
    fit_reach: float = 0.04  # reach of the body's shape when a template is carried to the person [m]
    skin_smoothing: int = 10  # umbrella steps on transferred skinning weights
    fit_frames: int = 6  # sampled frames that personalise the rest shape, 0 for none
    fit_stiffness: float = 0.3  # smoothness of the personal displacement against one sample's evidence
    loop_reach: float = 0.10  # an opening of the scan farther than this from a template's loop is not its own [m]
    loop_cosine: float = 0.4  # least agreement of directions of loop and opening
    loop_iterations: int = 8
    loop_bending: float = 30.0  # first, then less: cost of bending a loop's displacement against its distance
    loop_log_odds: float = 0.3  # log odds on either side of an opening that count as seen, see openings.trace_opening
    loop_observed: float = 0.25  # least observed share of a loop that enters as a boundary term
    observed: float = 0.006  # a vertex this close to the labelled scan is observed [m]
    interpolated: float = 0.05  # within this of an observed one it is interpolated [m]
    contact: float = 0.012  # a hand vertex this close to the garment touches it [m]
    contact_share: float = 0.05  # of one hand's vertices that makes an unsupported contact
    ambiguous_size: float = 0.15  # loop lengths off by more than this share are reported


class TrackSettings(Settings):
    """Pose and surface of the single layer."""

    samples: int = 5000  # vertices of the body that look for the scan when the pose is fitted
    stiffness: float = 0.02  # bending of the free-form displacement, see surface.refinement
    refinement_steps: int = Field(
        6, ge=1, le=6
    )  # of the schedule of falling stiffness; fewer are faster and stop farther from the scan
    rest_smoothing: int = 5  # umbrella steps on the personal offsets
    observed: float = 0.004  # a tracked vertex this close to the scan is observed [m]
    interpolated: float = 0.02  # within this it is interpolated, beyond hidden [m]


class InnerSettings(Settings):
    """The body under the garments."""

    margin: float = 0.002  # of cloth off the body [m]
    tolerance: float = 2e-4  # a frame's fit ends when no vertex moves by more [m]


class Config(Settings):
    """All settings of a run, as RUN/config.toml keeps them."""

    quality: str = "standard"
    samples: int = 10  # frames of the preparatory pass
    reconstruct: ReconstructSettings = ReconstructSettings()
    track: TrackSettings = TrackSettings()
    segment: SegmentSettings = SegmentSettings()
    dress: DressSettings = DressSettings()
    inner: InnerSettings = InnerSettings()


QUALITIES = ("draft", "standard", "fine")
SAMPLES = {"draft": 5, "standard": 10, "fine": 16}
FIT_FRAMES = {"draft": 3, "standard": 6, "fine": 10}


def preset(quality):
    """The settings of a quality preset. Draft reads four pictures a frame, leaves openings where the labels put them, and fits
    pose and surfaces in fewer steps to fewer points."""
    if quality not in QUALITIES:
        raise ValueError(f"--quality {quality}: expected one of {', '.join(QUALITIES)}")
    draft = quality == "draft"
    return Config(
        quality=quality,
        samples=SAMPLES[quality],
        track=TrackSettings(samples=2000 if draft else 5000, refinement_steps=3 if draft else 6),
        segment=SegmentSettings(views=4 if draft else 0, refine_border=not draft),
        dress=DressSettings(
            fit_frames=FIT_FRAMES[quality], trace_openings=not draft, refinement_steps=3 if draft else 6
        ),
        inner=InnerSettings(tolerance=1e-3 if draft else 2e-4),
    )
