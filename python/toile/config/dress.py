"""Settings of dressing: templates, their loops, and where they lie."""

from __future__ import annotations

from .kernels import BiharmonicSettings, NricpSettings
from .settings import Rising, Settings, setting


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
    far_reach: float = setting(
        0.08,
        "m",
        "search range in the pictures to either side of a loop of which the usual one shows `min_observed`, but not `whole_share`",
        gt=0,
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
    size: Rising = setting((0.5, 2.0), "1", "of a template, and of a rim, against those of the capture")
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
    traces: int = setting(4, "count", "how often a loop is sought in the pictures, if it is not `settled` before", ge=1)
    settled: float = setting(
        0.015, "m", "a loop that pictures move by less, three quarters of what is seen of it, is not sought again", ge=0
    )
    free_reach: float = setting(
        0.05, "m", "about a loop, cloth that lies off the scan goes on as the cloth on the scan leads", ge=0
    )
    girth_distance: float = setting(
        0.08,
        "m",
        "so far from a loop the cloth tells how long the opening would be that the template's cut gives it",
        gt=0,
    )
    min_faces: int = setting(100, "count", "faces of the scan that carry the garment, else the frame fails", ge=1)
    fit_reach: float = setting(0.04, "m", "reach of the body's shape when a template is carried to the person", gt=0)
    skin_smoothing: int = setting(10, "count", "umbrella steps on transferred skinning weights", ge=0)
    fit_frames: int = setting(6, "count", "sampled frames that personalise the rest shape, 0 for none", ge=0)
    rim: float = setting(
        0.065,
        "m",
        "so near to an opening that a sampled frame shows wrong, its cloth says nothing of the rest shape",
        ge=0,
    )
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
        0.85,
        "1",
        "an opening shorter than this share of that, of what the cloth leads to expect, or of the fitted template's own, or as "
        "much longer, is not shown there",
        gt=0,
        le=1,
    )
    joined_opening: float = setting(
        1.3, "1", "one longer than so often what the cloth leads to expect is joined to other cloth there", gt=1
    )
    joined_share: float = setting(
        0.1, "1", "a sleeve's opening of which more lies at the trunk, off its arm, is joined to it there", ge=0, le=1
    )
    measured_share: float = setting(0.6, "1", "observed share of a loop from which on its length counts", ge=0, le=1)
    placement: PlacementSettings = PlacementSettings()
    loop: LoopSettings = LoopSettings()
    biharmonic: BiharmonicSettings = BiharmonicSettings()
