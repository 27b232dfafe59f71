"""Settings of all stages of `toile register`; the larger ones lie in files of their own."""

from __future__ import annotations

from .dress import DressSettings
from .kernels import InnerSolverSettings, UntangleSettings
from .prints import PrintSettings
from .segment import SegmentSettings
from .settings import Falling, Rising, Settings, setting
from .stereo import StereoSettings
from .track import TrackSettings
from .triangulation import ReconstructSettings


class MotionSettings(Settings):
    """Smoothing over consecutive frames."""

    temporal: bool = setting(True, "switch", "smooth pose and surfaces over consecutive frames")
    near: float = setting(
        0.07, "s", "frames farther apart than that do not tell noise from motion: they are not smoothed", gt=0
    )
    reach: float = setting(
        1.0, "s", "a frame without a scan takes its surfaces from scanned frames no farther than that", gt=0
    )
    margin: int = setting(16, "count", "frames read on either side of a block, so that its border shows no seam", ge=2)
    samples: int = setting(1000, "count", "vertices of a surface that tell its noise from its motion", ge=1)
    max_strength: float = setting(10.0, "1", "of second differences against displacements, at most", gt=0)
    pose_factor: float = setting(
        3.0,
        "1",
        "times the strength that best foretells places of joints left out, for poses: turns are smoother than places",
        ge=0,
    )
    unscanned_weight: float = setting(
        0.3, "1", "of the pose of a frame that no scan shows against another's", gt=0, le=1
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
    whole_opening: float = setting(
        0.9,
        "1",
        "a loop shorter than this share of what other frames show, or as much longer, was laid on no whole opening",
        gt=0,
        le=1,
    )
    whole_rank: float = setting(
        0.6,
        "1",
        "of the lengths that frames show of a loop, from the shortest to the longest: the one that is whole",
        ge=0,
        le=1,
    )
    loop_reach: float = setting(0.05, "m", "cloth this near to such a loop counts as hidden in that frame", ge=0)


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
    measure/verdicts.py. Falling are limits of what is good when large. The worst measure decides. Calibrated by bench/verdicts.py."""

    two_sided_mm: Rising = setting(
        (12.0, 30.0), "mm", "the tracked surface and the scan, mean distance from the side that is nearer"
    )
    scan_edge_mm: Rising = setting((50.0, 200.0), "mm", "median length of the edges of the frame's scan")
    apart: Rising = setting(
        (0.02, 0.1), "1", "share of the scan and of the tracked surface, both, that lie 2 cm from one another"
    )
    astray: Rising = setting(
        (0.05, 0.15), "1", "share of the scan and of the posed body, both, that lie 5 cm from one another"
    )
    pose_mm: Rising = setting((40.0, 60.0), "mm", "the posed body and the scan, mean distance of both sides")
    moved_mm: Rising = setting(
        (20.0, 50.0), "mm", "by how much the posed body was bent to the scan, mean over its outside"
    )
    stature_off_m: Rising = setting(
        (0.0, 0.5), "m", "by how much the run's person is shorter than 1 m or taller than 2.3: is it another unit?"
    )
    keypoint_mm: Rising = setting((50.0, 80.0), "mm", "keypoints to those detected, median")
    face_off: Rising = setting(
        (0.5, 1.0), "1", "share of the facial keypoints given that lie off the face: alone they make no frame wrong"
    )
    silhouette_iou: Falling = setting((0.93, 0.85), "1", "overlap of silhouette and masks, at least")
    labels_off: Rising = setting(
        (0.07, 0.15), "1", "share of the label images that lies beyond the silhouette, where there are no masks"
    )
    uncovered_mm: Rising = setting((30.0, 300.0), "mm", "how far the masks of two cameras reach beyond the silhouette")
    overhang_mm: Rising = setting((45.0, 90.0), "mm", "how far the silhouette reaches beyond the masks of two cameras")
    cloth_overhang_mm: Rising = setting((25.0, 60.0), "mm", "the same of what a garment shows of the silhouette")
    observed: Falling = setting(
        (0.4, 0.1), "1", "share of the body's surface found on the scan, at least, where nothing else shows the body"
    )
    limb_observed: Falling = setting(
        (0.05, 0.0),
        "1",
        "share of a forearm with its hand, a shank with its foot or the head that the scan or pictures show, the least: alone it makes "
        "no frame wrong",
    )
    limb_inside: Rising = setting(
        (0.05, 0.5),
        "1",
        "share of a forearm or a shank that lies 2 cm and more in the rest of the body, where no picture shows it",
    )
    garment_observed: Falling = setting(
        (0.3, 0.1), "1", "share of a garment's vertices found on the labelled scan, at least"
    )
    garment_mm: Rising = setting(
        (10.0, 30.0), "mm", "a garment and the labelled scan, mean distance from the side that is nearer"
    )
    opening_observed: Falling = setting(
        (0.75, 0.25),
        "1",
        "share of a garment's openings that were seen, of those that the preparation's frames show whole or the frame in part",
    )
    opening_bare: Rising = setting(
        (0.5, 1.0),
        "1",
        "share of an opening that is seen nowhere and lies 2 cm and more from any scan: alone it makes no frame wrong",
    )
    loop_mm: Rising = setting((20.0, 40.0), "mm", "a loop to the opening that was seen, the worst")
    loop_length: Rising = setting(
        (1.5, 3.0),
        "1",
        "length of a loop against its opening's in the frames of the preparation, or the other way round",
    )
    loop_share: Falling = setting(
        (0.92, 0.5),
        "1",
        "length of a loop over what the cloth about it leads to expect by the template's cut, at least",
    )
    loop_excess_mm: Rising = setting(
        (100.0, 500.0), "mm", "how much longer a loop is than the cloth about it leads to expect, if by three tenths"
    )
    loop_at_trunk: Rising = setting(
        (0.1, 0.6),
        "1",
        "share of a sleeve's opening that lies 4 cm and more off its arm and half as far from the trunk",
    )
    unclaimed_opening_mm: Rising = setting((1200.0, 5000.0), "mm", "openings that belong to no loop")
    edge_stretch: Rising = setting((0.35, 0.6), "1", "|log of the stretch| of a garment's edges, what 95 % stay below")
    stretch_p95: Rising = setting((2.0, 3.0), "1", "stretch of a garment, what 95 % of its area stay below")
    pairs_left: Rising = setting(
        (0.0, 1000.0), "count", "pairs of a garment's triangles and of those under it that go through one another"
    )
    flipped_share: Rising = setting((0.05, 0.15), "1", "of a garment's area, turned over by the fit")


class Config(Settings):
    """All settings of a run, as RUN/config.toml keeps them."""

    quality: str = setting("standard", "name", "draft or standard: the preset that the others start from")
    preparation_frames: int = setting(
        6, "count", "spread over the run, that make the person, the colours and the templates", ge=1
    )
    holdout: tuple[int, int] | tuple[()] = setting(
        (), "count", "first and last number of the frames that nothing which other frames are made from reads"
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
