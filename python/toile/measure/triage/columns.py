"""What is said of each frame, in words: the columns of the page, of the CSV and of the JSON."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

HIGH, LOW, NEITHER = "high", "low", "neither"  # which values are bad
SCAN, OPENINGS, CLOTH, TIME, POSE, SECONDS, TRUTH = (
    "Scan",
    "Openings",
    "Cloth and skin",
    "Against neighbours",
    "Pose and pictures",
    "Seconds",
    "Against the truth",
)
GROUPS = (SCAN, OPENINGS, CLOTH, TIME, POSE, SECONDS, TRUTH)
UNITS = {  # of a value as it is kept: (unit shown, factor)
    "mm": ("mm", 1.0),
    "m": ("mm", 1e3),
    "share": ("%", 100.0),
    "times": ("\u00d7", 1.0),
    "px": ("px", 1.0),
    "s": ("s", 1.0),
    "": ("", 1.0),
}


@dataclass(frozen=True)
class Column:
    """`key`: STAGE:NAME of the measure; `floor`: the least difference to the run's middle that means anything, in the unit
    shown; `limit`: the setting of the verdict that bounds it, "" for none; `bounds`: where it begins to be out and to be
    grave, in the unit shown, of measures that no verdict asks for."""

    key: str
    words: str
    unit: str
    factor: float
    meaning: str
    bad: str
    floor: float
    limit: str
    group: str
    bounds: tuple[float, float] | None


@dataclass(frozen=True)
class _Kind:
    """Columns whose key the whole of `pattern` matches; `{g}` in the words is its garment, `{n}` its other name."""

    pattern: str
    words: str
    unit: str
    group: str
    floor: float
    meaning: str
    bad: str = HIGH
    limit: str = ""
    bounds: tuple[float, float] | None = None


G, N = r"(?P<g>[\w-]+)", r"(?P<n>.+)"
P50, P95 = "half of it is nearer", "95 % of it are nearer"
KINDS = (  # in the order of the page
    _Kind(r"evidence:two_sided_mm", "scan and body apart", "mm", SCAN, 3, "mean distance from the scan to the body or back, the smaller", HIGH, "two_sided_mm"),
    _Kind(rf"evidence:{G}\.garment_mm", "scan and {g} apart", "mm", SCAN, 3, "mean distance from the garment's part of the scan to it or back, the smaller", HIGH, "garment_mm"),
    _Kind(r"evidence:scan_edge_mm", "triangles of the scan", "mm", SCAN, 10, "width of the scan's triangles", HIGH, "scan_edge_mm"),
    _Kind(r"evidence:scan_to_surface_p50_mm", "scan to body, median", "mm", SCAN, 1.5, f"the scan's points, clutter too, to the body: {P50}"),
    _Kind(r"evidence:scan_to_surface_mm", "scan to body, mean", "mm", SCAN, 4, "the scan's points, clutter too, to the body"),
    _Kind(r"evidence:scan_to_surface_p95_mm", "scan to body, 95 %", "mm", SCAN, 15, f"the scan's points, clutter too, to the body: {P95}"),
    _Kind(r"evidence:surface_to_scan_p50_mm", "body to scan, median", "mm", SCAN, 1.5, f"the body's surface, hidden parts too, to the scan: {P50}"),
    _Kind(r"evidence:surface_to_scan_mm", "body to scan, mean", "mm", SCAN, 4, "the body's surface, hidden parts too, to the scan"),
    _Kind(r"evidence:surface_to_scan_p95_mm", "body to scan, 95 %", "mm", SCAN, 15, f"the body's surface, hidden parts too, to the scan: {P95}"),
    _Kind(r"evidence:observed", "body found on the scan", "share", SCAN, 10, "share of the body's surface", LOW, "observed"),
    _Kind(r"evidence:limb_observed", "limb that is shown", "share", SCAN, 10, "share of a forearm, a shank or the head that scan or pictures show, the least", LOW, "limb_observed"),
    _Kind(r"evidence:limb_inside", "limb in the body", "share", SCAN, 3, "share of a forearm or a shank that lies 2 cm and more in the rest of the body and in no picture", HIGH, "limb_inside"),
    _Kind(r"evidence:apart", "2 cm apart", "share", SCAN, 1, "share of scan and body that lie 2 cm from one another, the smaller", HIGH, "apart"),
    _Kind(rf"evidence:{G}\.cloth_to_garment_p50_mm", "scan to {g}, median", "mm", SCAN, 1.5, f"the garment's part of the scan to it: {P50}"),
    _Kind(rf"evidence:{G}\.cloth_to_garment_mm", "scan to {g}, mean", "mm", SCAN, 4, "the garment's part of the scan to it"),
    _Kind(rf"evidence:{G}\.cloth_to_garment_p95_mm", "scan to {g}, 95 %", "mm", SCAN, 10, f"the garment's part of the scan to it: {P95}"),
    _Kind(rf"evidence:{G}\.garment_to_cloth_p50_mm", "{g} to scan, median", "mm", SCAN, 1.5, f"the garment to its part of the scan: {P50}"),
    _Kind(rf"evidence:{G}\.garment_to_cloth_mm", "{g} to scan, mean", "mm", SCAN, 4, "the garment to its part of the scan"),
    _Kind(rf"evidence:{G}\.garment_to_cloth_p95_mm", "{g} to scan, 95 %", "mm", SCAN, 10, f"the garment to its part of the scan: {P95}"),
    _Kind(rf"evidence:{G}\.garment_observed", "{g} found on the scan", "share", SCAN, 10, "share of the garment's surface", LOW, "garment_observed"),
    _Kind(rf"evidence:{G}\.covered", "{g}: covered", "share", SCAN, 20, "share of the garment that others cover, where no verdict looks at it", NEITHER),
    _Kind(rf"dress {G}:loop_mm\.{N}", "{g} {n}: off", "mm", OPENINGS, 5, "the registered opening to the one that was seen; a dash: none was", HIGH, "loop_mm"),
    _Kind(rf"dress {G}:loop_observed\.{N}", "{g} {n}: seen", "share", OPENINGS, 20, "share of the opening that was seen", LOW),
    _Kind(rf"evidence:{G}\.opening_observed", "{g}: openings seen", "share", OPENINGS, 10, "of the openings that are not hidden throughout", LOW, "opening_observed"),
    _Kind(rf"evidence:{G}\.opening_bare", "{g}: opening without scan", "share", OPENINGS, 10, "of an opening that is seen nowhere, where there is no scan", HIGH, "opening_bare"),
    _Kind(rf"evidence:{G}\.cloth_overhang_mm", "{g}: in the air", "mm", OPENINGS, 10, "how far cloth reaches beyond the masks, in the picture of the second most", HIGH, "cloth_overhang_mm"),
    _Kind(rf"evidence:{G}\.{N}\.loop_length", "{g} {n}: length", "times", OPENINGS, 0.15, "the opening's length against what the sampled frames show, longer or shorter", HIGH, "loop_length"),
    _Kind(rf"evidence:{G}\.{N}\.loop_share", "{g} {n}: whole", "share", OPENINGS, 10, "the opening's length over what the cloth about it leads to expect", LOW, "loop_share"),
    _Kind(rf"evidence:{G}\.{N}\.loop_excess_mm", "{g} {n}: too long", "mm", OPENINGS, 50, "by how much the opening is longer than that length, where by three tenths and more", HIGH, "loop_excess_mm"),
    _Kind(rf"evidence:{G}\.{N}\.loop_at_trunk", "{g} {n}: at the trunk", "share", OPENINGS, 5, "share of a sleeve's opening that lies at the trunk, off its arm", HIGH, "loop_at_trunk"),
    _Kind(rf"evidence:{G}\.unclaimed_opening_mm", "{g}: openings that belong to none", "mm", OPENINGS, 200, "length of seen borders that belong to no opening: holes of the labels, folds, tears", HIGH, "unclaimed_opening_mm"),
    _Kind(r"evidence:pairs_left", "intersections", "", CLOTH, 20, "pairs of triangles of garments that go through the body or one another", HIGH, "pairs_left"),
    _Kind(rf"evidence:{G}\.flipped_share", "{g}: turned over", "share", CLOTH, 1, "share of the garment's triangles", HIGH, "flipped_share"),
    _Kind(rf"evidence:{G}\.stretch_p95", "{g}: stretch, 95 %", "times", CLOTH, 0.15, "largest stretch of a triangle against rest: 95 % have less", HIGH, "stretch_p95"),
    _Kind(rf"evidence:{G}\.edge_stretch", "{g}: strain, 95 %", "share", CLOTH, 10, "logarithm of its edges' lengths over those at rest, longer or shorter: 95 % have less", HIGH, "edge_stretch"),
    _Kind(rf"dress {G}:hand_contact", "{g}: touched by a hand", "share", CLOTH, 3, "share of a hand that lies at the garment: pulled cloth cannot be represented"),
    _Kind(rf"between:{G}\.folds", "{g}: through itself", "", CLOTH, 200, "pairs of the garment's own triangles that go through one another"),
    _Kind(r"between:folded", "body: folded", "share", CLOTH, 0.5, "share of the tracked skin's triangles that are turned against their neighbours", HIGH, "", (1.5, 4)),
    _Kind(r"between:stretched", "body: stretch, 95 %", "times", CLOTH, 0.1, "edges of the tracked skin against rest, longer or shorter: 95 % have less", HIGH, "", (2, 3)),
    _Kind(r"between:labels_alike", "labels as in the neighbours", "share", TIME, 5, "intersection over union of each label with the frames before and after, the worst label", LOW),
    _Kind(r"between:jump_p95_mm", "body: jump, 95 %", "mm", TIME, 15, "the tracked surface to the middle of the frames before and after: 95 % are nearer"),
    _Kind(rf"between:{G}\.jump_p95_mm", "{g}: jump, 95 %", "mm", TIME, 15, "the garment to the middle of the frames before and after: 95 % are nearer"),
    _Kind(rf"between:{G}\.slip_mm", "{g}: swimming over the body", "mm", TIME, 2, "mean jump along the cloth against the body under it: stands for the drift of its texture, which no print shows"),
    _Kind(rf"align {G}:misfit", "{g}: print misfit", "", TIME, 0.1, "what is left of the difference between the print and the pictures, after sliding"),
    _Kind(rf"align {G}:slide_mm", "{g}: print slid back by", "mm", TIME, 5, "mean way that the print was moved along the cloth: its drift before that"),
    _Kind(rf"dress {G}:slide_mm", "{g}: print slid back by", "mm", TIME, 5, "mean way that the print was moved along the cloth: its drift before that"),
    _Kind(r"evidence:pose_mm", "pose to scan", "mm", POSE, 8, "the posed body to the scan before it is bent to it", HIGH, "pose_mm"),
    _Kind(r"evidence:moved_mm", "bent to the scan by", "mm", POSE, 5, "mean way of the posed body's vertices to the scan", HIGH, "moved_mm"),
    _Kind(r"evidence:astray", "astray", "share", POSE, 2, "share of the scan that is not where the posed body is, and the other way round, the smaller", HIGH, "astray"),
    _Kind(r"evidence:stature_off_m", "stature off", "m", POSE, 100, "by how much the run's person is shorter or taller than people are", HIGH, "stature_off_m"),
    _Kind(r"track:skeleton_rms_m", "residual of the pose", "m", POSE, 5, "root of the mean squared distance of the skeleton's fit"),
    _Kind(r"evidence:keypoint_mm", "keypoints, median", "mm", POSE, 8, "the body's keypoints to those detected, at their depth", HIGH, "keypoint_mm"),
    _Kind(r"evidence:keypoint_p95_px", "keypoints, 95 %", "px", POSE, 10, "the body's keypoints to those detected: 95 % are nearer"),
    _Kind(r"evidence:face_off", "face off", "share", POSE, 10, "share of the facial keypoints that lie off the face and were left out", HIGH, "face_off"),
    _Kind(r"evidence:overhang_mm", "beyond masks", "mm", POSE, 10, "how far the silhouette reaches beyond the masks, in the picture of the second most", HIGH, "overhang_mm"),
    _Kind(r"evidence:uncovered_mm", "not covered", "mm", POSE, 10, "how far the masks reach beyond the silhouette, likewise", HIGH, "uncovered_mm"),
    _Kind(r"evidence:labels_off", "labels not covered", "share", POSE, 3, "share of the label images beyond the silhouette, where there are no masks", HIGH, "labels_off"),
    _Kind(r"evidence:silhouette_iou", "silhouettes", "share", POSE, 3, "intersection over union of body and masks", LOW, "silhouette_iou"),
    _Kind(r"evidence:masks_empty", "empty masks", "", POSE, 1, "masks that are empty where scan, keypoints or other masks show the person, and left out of the silhouettes"),
    _Kind(r"seconds:all", "all stages", "s", SECONDS, 5, "seconds of all stages together"),
    _Kind(rf"seconds:{N}", "{n}", "s", SECONDS, 3, "seconds of this stage"),
    _Kind(r"truth:joint_mm", "joints", "mm", TRUTH, 5, "joints to the true joints of the same name"),
    _Kind(r"truth:fingertip_mm", "fingertips", "mm", TRUTH, 5, "fingertips of the tracked surface to the true ones"),
    _Kind(r"truth:face_mm", "face", "mm", TRUTH, 3, "facial keypoints of the tracked surface to the true ones"),
    _Kind(r"truth:inner hidden_mm", "body under garments", "mm", TRUTH, 4, "the hidden body to the true body"),
    _Kind(r"truth:inner visible_mm", "body elsewhere", "mm", TRUTH, 2, "the visible body to the true body"),
    _Kind(r"truth:inner jitter_mm", "body: jitter", "mm", TRUTH, 1, "mean second difference over time of the visible body's errors"),
    _Kind(rf"truth:label_iou {N}", "label {n}", "share", TRUTH, 5, "intersection over union with the true label, by area", LOW),
    _Kind(rf"truth:garment {G} surface_mm", "{g} to true surface", "mm", TRUTH, 2, "the garment's vertices to the true garment"),
    _Kind(rf"truth:garment {G} surface_missed_mm", "true {g} to surface", "mm", TRUTH, 2, "the true garment's vertices to the garment"),
    _Kind(rf"truth:garment {G} correspondence_mm", "{g}: vertices off", "mm", TRUTH, 5, "the garment's vertices to their true places"),
    _Kind(rf"truth:garment {G} slip_mm", "{g}: slip", "mm", TRUTH, 5, "the errors of the vertices' places without what all frames share"),
    _Kind(rf"truth:garment {G} jitter_mm", "{g}: jitter", "mm", TRUTH, 1, "mean second difference over time of the errors of the vertices' places"),
    _Kind(rf"truth:garment {G} boundary_all_mm", "{g}: all openings", "mm", TRUTH, 3, "the vertices of all openings to the true borders"),
    _Kind(rf"truth:garment {G} boundary_mm {N}", "{g} {n} to true border", "mm", TRUTH, 5, "the opening's vertices to its true border"),
    _Kind(rf"truth:garment {G} boundary_missed_mm {N}", "true {g} {n} to opening", "mm", TRUTH, 5, "the true border's vertices to the opening"),
)  # fmt: skip
INSTEAD = {"_p50_mm": "_mm"}  # a mean is shown where an older run has no median


def columns_of(keys: Iterable[str]) -> list[Column]:
    """The columns of those measures that have one, in the page's order."""
    keys = sorted(set(keys))
    means = {key.replace(new, old) for key in keys for new, old in INSTEAD.items() if new in key}
    found = []
    for kind in KINDS:
        for key in keys:
            match = re.fullmatch(kind.pattern, key)
            if match and key not in means and all(key != column.key for column in found):
                names = {name: text.replace("_", " ") for name, text in match.groupdict().items()}
                unit, factor = UNITS[kind.unit]
                words, meaning = kind.words.format(**names), kind.meaning
                told = (kind.bad, kind.floor, kind.limit, kind.group, kind.bounds)
                found.append(Column(key, words, unit, factor, meaning, *told))
    return sorted(found, key=lambda column: GROUPS.index(column.group))
