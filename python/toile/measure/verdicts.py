"""Is a registered frame to be trusted? Evidence from both sides, without truth, and a verdict with its reasons."""

from __future__ import annotations

import numpy as np

from .. import kernels
from ..io.layout import DOUBTFUL, GOOD, WRONG
from ..scene import OBSERVED
from ..surface.joined import Sleeves
from ..surface.loops import loop_length
from .empty_masks import PATCH, wrongly_empty
from .evidence import keypoint_errors, overlap, parted
from .judged import JudgedLayer, covered_shares, uncovered
from .limbs import limbs_shown

VERTICES = 2000  # of a surface, that look for the scan
# how the posed body lies before it is bent to the scan, and facial keypoints
OF_TRACKING = ("pose_mm", "astray", "moved_mm", "moved_p95_mm", "face_off")
APART = 20.0  # mm: nowhere is a surface that has found its limbs so far from a scan, and the scan from it
PEOPLE = (1.0, 2.3)  # m, statures from a small child's to a giant's
HARDLY = 0.25  # of an opening: so much is taken for it where it is tucked in
WIDER = 0.3  # of the length that the cloth about it leads to expect: a cuff's true opening may be wider by that
STEP = 4  # every so many faces are asked for their stretch
CRUMPLED = ("unclaimed_opening_mm", "stretch_p95", "flipped_share")
# of each measure that has limits, what is said where it is beyond them; its settings are (doubtful from, wrong from)
REASONS = {
    "scan_edge_mm": "the scan's triangles are {} mm wide: surface and openings are as uncertain",
    "two_sided_mm": "scan and surface lie {} mm apart, from whichever side",
    "apart": "{} of the surface is not where the scan is, and the other way round",
    "astray": "{} of the scan is not where the posed body is, and the other way round",
    "pose_mm": "the posed body lies {} mm from the scan on average",
    "moved_mm": "the posed body was bent by {} mm to meet the scan",
    "stature_off_m": "the person's stature lies {} m outside of what people's is, 1 to 2.3 m",
    "keypoint_mm": "half of the keypoints are more than {} mm off",
    "face_off": "{} of the facial keypoints lie off the face",
    "silhouette_iou": "silhouette and masks overlap by {}",
    "labels_off": "{} of what the label images show lies beyond the silhouette",
    "uncovered_mm": "the masks of two cameras reach {} mm beyond the silhouette",
    "overhang_mm": "the silhouette reaches {} mm beyond the masks of two cameras",
    "cloth_overhang_mm": "cloth reaches {} mm beyond the masks of two cameras",
    "observed": "{} of the surface was found on the scan, and nothing else shows it",
    "limb_observed": "{} of an arm, a leg or the head is shown by the scan or by pictures: it is guessed",
    "limb_inside": "{} of an arm or a leg lies within the body, and no picture shows it",
    "garment_observed": "{} of the garment was found on the labelled scan",
    "garment_mm": "garment and labelled scan lie {} mm apart, from whichever side",
    "opening_observed": "{} of the openings that are not hidden throughout were seen",
    "opening_bare": "{} of an opening that no frame shows lies where there is no scan: it is guessed",
    "loop_mm": "an opening lies {} mm from the one that was seen",
    "loop_length": "{} times as long as the sampled frames show the opening, or as short",
    "loop_share": "{} of the opening's length that the cloth about it leads to expect: it is cut off",
    "loop_excess_mm": "the opening is {} mm longer than the cloth about it leads to expect: it is joined to other cloth",
    "loop_at_trunk": "{} of the opening lies at the trunk, off its arm: it is joined to it",
    "unclaimed_opening_mm": "{} mm of seen openings belong to no loop",
    "edge_stretch": "a twentieth of the garment's edges are as long as exp({}) times at rest, or as short",
    "stretch_p95": "a twentieth of the garment is stretched {} times and more",
    "flipped_share": "{} of the garment is turned over",
    "pairs_left": "{} pairs of triangles go through one another",
}
AT_LEAST = (  # what is good when large
    "silhouette_iou",
    "observed",
    "limb_observed",
    "garment_observed",
    "opening_observed",
    "loop_share",
)


def judge(
    seen, cameras, model, person, tracked, worn, settings, pairs_left=0
) -> tuple[dict[str, float], int, list[str]]:
    """(measures, verdict, reasons) of a frame: a Glimpse of it against its Tracked and its garments `worn`, each a
    (GarmentTemplate, vertices (g,3), Dressed), `pairs_left` of whose triangles go through what lies under them."""
    outside = np.flatnonzero(~model.inside)
    body = JudgedLayer("body", None, tracked.vertices, model.skin_faces, tracked.confidence, outside)
    joints = model.joint_transforms(person.J, tracked.rotations, tracked.translation)[1]
    layers = uncovered(
        [JudgedLayer(t.name, t.label, V, t.faces, dressed.confidence, np.arange(len(V))) for t, V, dressed in worn]
    )
    measures = agreement(seen, cameras, model, joints, body, layers)
    measures |= {f"{name}.covered": share for name, share in covered_shares(layers).items()}
    if len(seen.points):
        measures |= limbs_shown(seen, cameras, model, body)
    measures["stature_off_m"] = beyond_people(person.rest)
    measures |= {name: tracked.diagnostics[name] for name in OF_TRACKING if name in tracked.diagnostics}
    sleeves = Sleeves(model, tracked.vertices, joints)
    for template, V, dressed in worn:
        measures |= _openings(template, dressed.diagnostics) | _excess(template, V, dressed.diagnostics)
        measures |= _joined(sleeves, template, V)
        measures |= _bare(seen, template, V, dressed.diagnostics)
        measures[f"{template.name}.edge_stretch"] = stretch(V, template.rest, template.faces)
    if worn:
        measures["pairs_left"] = float(pairs_left)
    return measures, *verdict(measures, settings)


def agreement(seen, cameras, model, joints, body, garments=()) -> dict[str, float]:
    """How well layers explain a Glimpse, from both sides; what the frame lacks is left out.

    `body`: the tracked JudgedLayer, `joints` (K,3) its joints; `garments`: JudgedLayers. observed: share of the body's vertices found
    on the scan. scan_to_surface_mm, surface_to_scan_mm: mean, and what 95 % stay below (_p95_mm); the second to the
    scan's points with their normals. keypoint_px: of the model's keypoints and those detected, all cameras, median and
    p95; keypoint_mm: the same at the keypoints' depth. silhouette_iou: mean over few cameras. uncovered_mm, overhang_mm: how
    far a mask reaches beyond the silhouette (where there are garments), by PATCH or more, and the silhouette beyond the mask,
    the second largest over the cameras; labels_off: of a frame without masks the share of its label images that lies beyond the
    silhouette, mean over few cameras; NAME.cloth_overhang_mm: how far of the silhouette what a garment shows. Of a garment NAME:
    NAME.garment_observed, NAME.cloth_to_garment_mm (its part of the scan) and NAME.garment_to_cloth_mm, with their p95. What only
    one of two lacks, the scan by a hole or the body by clutter, is no fault: two_sided_mm and NAME.garment_mm are the
    smaller of the two means. apart: for the same reason the smaller of the shares of scan and surface that lie more than
    APART from one another, as on both sides of a limb that was bent to another part of the scan.
    """
    out = {"observed": float((body.confidence[body.looks] == OBSERVED).mean())}
    if len(seen.points):
        skin = kernels.SurfaceIndex(body.vertices, body.faces)
        sides = 1e3 * skin.closest(seen.points)[3], 1e3 * _to_points(seen, None, body)
        for name, side in zip(("scan_to_surface", "surface_to_scan"), sides):
            out |= _spread(name, "mm", side, np.mean)
        out["scan_edge_mm"] = 1e3 * seen.side
        out["two_sided_mm"] = min(out["scan_to_surface_mm"], out["surface_to_scan_mm"])
        out["apart"] = float(min((side > APART).mean() for side in sides))
    if seen.keypoints.size:
        views = dict(zip(seen.keypoint_views, seen.keypoints))
        pixels, millimetres = keypoint_errors(seen.keypoint_names, views, cameras, model, body.vertices, joints)
        if len(pixels):
            out |= _spread("keypoint", "px", pixels, np.median) | _spread("keypoint", "mm", millimetres, np.median)
    out |= _outlined(seen, cameras, body, garments)
    for layer in garments:
        if len(seen.points):  # without a scan it is said that none shows the surface
            out[f"{layer.name}.garment_observed"] = float((layer.confidence[layer.looks] == OBSERVED).mean())
        of_garment = seen.points[seen.labels == layer.label]
        if len(of_garment):
            cloth = kernels.SurfaceIndex(layer.vertices, layer.faces)
            out |= _spread(f"{layer.name}.cloth_to_garment", "mm", 1e3 * cloth.closest(of_garment)[3], np.mean)
            out |= _spread(f"{layer.name}.garment_to_cloth", "mm", 1e3 * _to_points(seen, layer.label, layer), np.mean)
            sides = out[f"{layer.name}.cloth_to_garment_mm"], out[f"{layer.name}.garment_to_cloth_mm"]
            out[f"{layer.name}.garment_mm"] = min(sides)
    return out


def _outlined(seen, cameras, body, garments):
    """What `agreement` says of masks, or where there are none of label images. A camera that looks elsewhere, whose empty mask is
    right, tells nothing; neither does one whose mask is empty although the frame shows that she is there."""
    pictures = [
        (name, layer, mask, side)
        for name, layer, mask, side in _silhouettes(seen, cameras, (body, *garments))
        if mask.any() or (layer >= 0).any()
    ]
    if not pictures:
        return {}
    if seen.of_labels:
        return {"labels_off": float(np.mean([_beyond_all(layer, mask) for _, layer, mask, _ in pictures]))}
    empty = wrongly_empty(seen, cameras, body, {name: (mask, side) for name, _, mask, side in pictures})
    pictures = [picture for name, *picture in pictures if name not in empty]
    out = {"masks_empty": float(len(empty))} if empty else {}
    out["silhouette_iou"] = float(np.mean([overlap(layer >= 0, mask) for layer, mask, _ in pictures]))
    if garments:  # a surface tracked alone lacks sleeves' ends and hems that hang free
        out["uncovered_mm"] = _reach((mask, layer >= 0, side) for layer, mask, side in pictures)
    out["overhang_mm"] = _reach((layer >= 0, mask, side) for layer, mask, side in pictures)
    for i, garment in enumerate(garments, 1):
        out[f"{garment.name}.cloth_overhang_mm"] = _reach((layer == i, mask, side) for layer, mask, side in pictures)
    return out


def beyond_people(rest) -> float:
    """By how much [m] a body at rest (n,3) is shorter or taller than PEOPLE; 0 within."""
    tall = float(np.ptp(rest, axis=0).max())
    return max(PEOPLE[0] - tall, tall - PEOPLE[1], 0.0)


def verdict(measures, settings) -> tuple[int, list[str]]:
    """GOOD, DOUBTFUL or WRONG by the settings' limits, and the reasons in words, the gravest first."""
    faults = []
    for name, words in REASONS.items():
        doubtful, wrong = getattr(settings, name)
        for key in measures:
            owner, _, measure = key.rpartition(".")
            if measure != name:
                continue
            value, low = measures[key], name in AT_LEAST
            level = WRONG if _beyond(value, wrong, low) else DOUBTFUL if _beyond(value, doubtful, low) else GOOD
            if level != GOOD and not _said_by_others(key, measures, settings):
                said = f"{words.format(_words(value))} ({'at least' if low else 'at most'} {_words(doubtful)} is good)"
                faults.append((level, f"{owner}: {said}" if owner else said))
    if "scan_to_surface_mm" not in measures:
        faults.append((DOUBTFUL, "no scan shows where the surface lies"))
    faults.sort(key=lambda item: -item[0])
    return max([GOOD, *(level for level, _ in faults)]), [reason for _, reason in faults]


def severity(measures, settings) -> float:
    """How far the worst measure is from its limit of a good frame: 1 at that limit, more beyond, 2 at that of a wrong one."""
    severities = [0.0]
    for name in REASONS:
        doubtful, wrong = getattr(settings, name)
        for key, value in measures.items():
            if key.rpartition(".")[2] == name and not _said_by_others(key, measures, settings):
                low = name in AT_LEAST
                if _beyond(value, doubtful, low):
                    severities.append(1 + abs(value - doubtful) / max(abs(wrong - doubtful), 1e-9))
                elif value > 0:
                    severities.append(doubtful / value if low else value / doubtful)
    return max(severities)


def _said_by_others(key, measures, settings):
    """Is a fault of the scan against the body answered by the pictures? Where keypoints and silhouettes both agree with
    the body, a scan with clutter and holes may be far from it from either side; where one of them does, a scan may show
    little of it."""
    agree = [
        "keypoint_mm" in measures and measures["keypoint_mm"] <= settings.keypoint_mm[0],
        measures.get("silhouette_iou", 0.0) >= settings.silhouette_iou[0],
    ]
    if key in ("two_sided_mm", "apart", "astray"):
        return all(agree)
    return key == "observed" and ("keypoint_mm" in measures or "silhouette_iou" in measures)


def _openings(template, diagnostics):
    """What dressing said of a garment's loops: the share seen, that of those that are no _hidden ones (what is tucked in or covered
    throughout is no fault of a frame), the largest distance, openings that belong to none, and of each how its length departs from
    its opening's, and from what the cloth about it leads to expect."""
    seen = [diagnostics[f"loop_observed.{name}"] for name in template.loop_names]
    in_sight = [not _hidden(diagnostics, name) for name in template.loop_names]
    off = [diagnostics[f"loop_mm.{name}"] for name in template.loop_names]  # -1 where none was seen
    return {
        f"{template.name}.loop_observed": float(np.mean(seen)),
        **({f"{template.name}.opening_observed": float(np.mean(np.array(seen)[in_sight]))} if any(in_sight) else {}),
        f"{template.name}.loop_mm": max([0.0, *off]),
        **{f"{template.name}.{name}": diagnostics[name] for name in CRUMPLED if name in diagnostics},
        **{
            f"{template.name}.{name}.loop_length": max(diagnostics[key], 1 / diagnostics[key])
            for name in template.loop_names
            if (key := f"loop_length.{name}") in diagnostics
        },
        **{
            f"{template.name}.{name}.loop_share": diagnostics[key]
            for name in template.loop_names
            if (key := f"loop_share.{name}") in diagnostics
        },
    }


def _hidden(diagnostics, name):
    """Whether the preparation's frames show an opening nowhere whole, and this one hardly anything of it: it is tucked in, or lost."""
    return f"loop_length.{name}" not in diagnostics and diagnostics[f"loop_observed.{name}"] < HARDLY


def _bare(seen, template, V, diagnostics):
    """Of the openings that are hidden the largest share that lies APART from any scan: one that is tucked in has what covers it there."""
    loops = [loop for name, loop in zip(template.loop_names, template.loops) if _hidden(diagnostics, name)]
    if not loops or not len(seen.points):
        return {}
    far = [_to_points(seen, None, JudgedLayer(template.name, None, V, template.faces, None, loop)) for loop in loops]
    return {f"{template.name}.opening_bare": float(max((1e3 * of > APART).mean() for of in far))}


def _excess(template, V, diagnostics):
    """By how much [mm] each loop is longer than the cloth about it leads to expect; 0 up to a share that cuffs reach which are
    cut otherwise than the template's."""
    out = {}
    for name, loop in zip(template.loop_names, template.loops):
        if (share := diagnostics.get(f"loop_share.{name}")) is not None:
            longer = 1e3 * loop_length(V[loop]) * (1 - 1 / share) if share > 1 + WIDER else 0.0
            out[f"{template.name}.{name}.loop_excess_mm"] = float(longer)
    return out


def _joined(sleeves, template, V):
    """Of each sleeve's opening the share that lies at the trunk."""
    out = {}
    for name, loop in zip(template.loop_names, template.loops):
        if (there := sleeves.at_trunk(name, V[loop])) is not None:
            out[f"{template.name}.{name}.loop_at_trunk"] = float(there.mean())
    return out


def stretch(V, rest, F):
    """What 95 % of the faces' edges stay below: |log(length / length at rest)|."""
    length = [np.linalg.norm(X[F[::STEP, 0]] - X[F[::STEP, 1]], axis=1) for X in (V, rest)]
    return float(np.percentile(np.abs(np.log(np.maximum(length[0], 1e-9) / np.maximum(length[1], 1e-9))), 95))


def _beyond(value, limit, low):
    return value < limit if low else value > limit


def _words(value):
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _spread(name, unit, values, middle):
    out = {f"{name}_{unit}": float(middle(values))}
    ranks = (80, 95) if middle is np.median else (50, 80, 95)
    return out | {f"{name}_p{rank}_{unit}": float(np.percentile(values, rank)) for rank in ranks}


def _to_points(seen, label, layer):
    """Distances (k,) [m] of the layer's vertices to the surface that the scan's points stand for: across their normals,
    and along them beyond half their spacing."""
    from scipy.spatial import cKDTree

    of_label = slice(None) if label is None else seen.labels == label
    points, normals = seen.points[of_label], seen.normals[of_label]
    V = layer.vertices[layer.looks[:: max(len(layer.looks) // VERTICES, 1)]]
    at = cKDTree(points).query(V)[1]
    way = V - points[at]
    across = np.abs(np.einsum("ki,ki->k", way, normals[at]))
    along = np.sqrt(np.maximum((way**2).sum(1) - across**2, 0))
    return np.hypot(across, np.maximum(along - seen.spacing, 0))


def _silhouettes(seen, cameras, layers):
    """(camera's name; which of the layers (H,W) is seen, -1 for none; mask; side of a pixel where the layers are [m]) of each kept
    mask."""
    V = np.concatenate([layer.vertices for layer in layers])
    first = np.cumsum([0, *(len(layer.vertices) for layer in layers)])
    F = np.concatenate([layer.faces + n for layer, n in zip(layers, first)]).astype(np.int32)
    owner = np.append(np.repeat(np.arange(len(layers)), [len(layer.faces) for layer in layers]), -1)
    for name, step, mask in seen.views():
        camera = cameras[name]
        moved = kernels.undistorted_view(V, camera.K, camera.distortion, camera.T_camera_world)
        K = camera.K / [[step], [step], [1]]
        yield (
            name,
            owner[kernels.raster(moved, F, K, mask.shape).face],
            mask,
            float(np.median(np.maximum(moved[:, 2], 1e-3))) / K[0, 0],
        )


def _beyond_all(layer, labelled):
    """Share of what a label image shows (H,W) that no layer covers; `layer` (H,W): -1 where there is none."""
    return (labelled & (layer < 0)).sum() / max(labelled.sum(), 1)


def _reach(pictures):
    """The second largest [mm] over pictures (a, b, side) of how far a reaches beyond b; the largest of a single one."""
    far = [parted(a, b, side, PATCH) for a, b, side in pictures]
    return 1e3 * sorted(far)[-2:][0]
