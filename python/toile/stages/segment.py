"""Labels of a captured surface: labels given in images or on the scan, colour models and neighbours in space and time,
fused by an MRF; the border of each garment is then placed between scan vertices by the pictures' own edges."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import kernels
from ..config import SegmentSettings
from ..errors import UserError
from ..kernels.arrays import Anything, Bools, Floats, Ints
from ..scene import Camera, Frame, Mesh, Scene, Segmented, Tracked, Vote
from ..surface.label_field import dissolve_islands, solve_labels
from ..surface.operators import at_closest, interpolate, with_neighbours
from ..vision.borders import blend_border, refine_border
from ..vision.colours import ColourModel, fit_colours
from ..vision.completion import complete_labels
from ..vision.evidence import (
    Evidence,
    depth_views,
    label_shares,
    mean_over_views,
    soft_crop,
    spread_views,
    visibility,
)
from ..vision.limb_colours import LimbCloth, limb_cloth, retold
from ..vision.visibility import occlusion_border

Sample = tuple[Frame, Tracked]


@dataclass(frozen=True)
class SegmentModel:
    """What is fixed for a sequence: the labels' colours, and how often each place carries each label."""

    ids: Anything  # (L,) uint8, ascending
    colours: ColourModel | None
    prior: Floats  # (n,L) per tracked vertex, rows sum to 1
    cloth: LimbCloth | None = None  # that a network took for skin


def coarse_pictures(cameras: Mapping[str, Camera], samples: Sequence[Sample], settings: SegmentSettings) -> list[str]:
    """What to warn of where a pixel of the labelled pictures of sampled frames is wide at the person."""
    middles = [(cameras[name], tracked.vertices.mean(0)) for frame, tracked in samples for name in frame.labels]
    widths = [camera.to_camera(middle)[2] / camera.K[0, 0] for camera, middle in middles]
    if not widths or np.median(widths) <= settings.coarse_pixel:
        return []
    return [f"pictures: a pixel is {1e3 * np.median(widths):.0f} mm wide at the person: openings are as uncertain"]


def prepare(
    scene: Scene,
    cameras: Mapping[str, Camera],
    samples: Sequence[Sample],
    faces: Ints,
    settings: SegmentSettings,
    parts: Mapping[str, Bools] | None = None,
) -> SegmentModel:
    """Fits the colour models on sampled frames; `faces` (m,3) of the tracked surface, `parts` {name: bool
    (n,)} of the body, by which cloth is found that a network took for skin."""
    ids = np.array(sorted(set(scene.labels.values())), dtype=np.uint8)
    if not any(frame.labels or frame.scan_labels is not None for frame, _ in samples):
        raise UserError(
            "labels: no sampled frame has label images or labels on its scan, and the scene names a garment"
        )
    views = lambda frame, tracked: depth_views(frame.certainty, cameras, tracked.vertices, faces)
    viewed = ((frame, views(frame, tracked)) for frame, tracked in samples)
    cloth = limb_cloth(scene, parts or {}, faces, viewed, settings.skin_colour)
    samples = [
        (believed(frame, frame.certainty, cameras, cloth, tracked, faces), tracked) for frame, tracked in samples
    ]
    _check_ids(scene, samples)
    model = replace(_fitted(cameras, samples, faces, ids, settings), cloth=cloth)
    for _ in range(settings.completion_rounds):
        if not any(_unlabelled(frame, frame.images, model) for frame, _ in samples):
            break
        votes = _no_votes(samples, ids)
        for frame, tracked in samples:
            frame = _completed(frame, frame.images, cameras, model, tracked, faces, settings)
            views = depth_views(frame.labels, cameras, tracked.vertices, faces)
            _count(votes, frame, views, tracked, faces, ids, settings)
        model = replace(model, prior=_prior(votes, faces, settings))
    return model


def believed(
    frame: Frame,
    names: Collection[str],
    cameras: Mapping[str, Camera],
    cloth: LimbCloth | None,
    tracked: Tracked,
    faces: Ints,
) -> Frame:
    """The frame with what its network took for skin told again, in pictures of the cameras `names`; itself where there is no such
    LimbCloth."""
    if cloth is None:
        return frame
    by_network = [name for name in frame.certainty if name in names]
    return retold(frame, depth_views(by_network, cameras, tracked.vertices, faces), faces, cloth)


def _fitted(cameras, samples, faces, ids, settings):
    """The SegmentModel of the labels that sampled frames [(Frame, Tracked)] have; of one frame at a time views are there."""
    votes, pixels = _no_votes(samples, ids), []
    for frame, tracked in samples:
        views = depth_views(frame.labels, cameras, tracked.vertices, faces)
        _count(votes, frame, views, tracked, faces, ids, settings)
        pixels += _known_pixels(frame, views, ids, settings)
    return SegmentModel(ids, _fit_colours(pixels, ids, settings), _prior(votes, faces, settings))


def _no_votes(samples, ids):
    return np.zeros((len(samples[0][1].vertices), len(ids)))


def _count(votes, frame, views, tracked, faces, ids, settings):
    """Adds to `votes` (n,L) how often each tracked vertex carries each label in the frame's `views` {camera: DepthView} and
    on its scan."""
    if views:
        N = kernels.vertex_normals(tracked.vertices, faces)
        certainty = frame.certainty
        soft = {n: soft_crop(view, frame.labels[n], ids, settings, certainty.get(n)) for n, view in views.items()}
        share, weight = mean_over_views(soft, visibility(views, tracked.vertices, N, settings))
        votes += share * weight[:, None]
    if frame.scan_labels is not None:
        votes += _scan_votes(frame.scan, tracked.vertices, ids, settings)


def _prior(votes, faces, settings):
    """Probabilities (n,L) of the labels by votes (n,L) of a vertex and its neighbours."""
    prior = with_neighbours(votes, kernels.unique_edges(faces)) + 1e-9
    prior = prior / prior.sum(1, keepdims=True) + settings.prior_floor
    return prior / prior.sum(1, keepdims=True)


def unlabelled_pictures(samples: Sequence[Sample]) -> list[str]:
    """What to warn of where pictures of sampled frames have no label image."""
    pictures = [name in frame.labels for frame, _ in samples for name in frame.images]
    if all(pictures) or not any(frame.labels for frame, _ in samples):
        return []
    missing = len(pictures) - sum(pictures)
    return [
        f"labels: {missing} of {len(pictures)} sampled pictures have no label image: theirs follow colours and places"
    ]


def _completed(frame, names, cameras, model, tracked, faces, settings):
    """The frame with label images of the cameras `names` that have a picture; itself where none is missing or to be told."""
    missing = _unlabelled(frame, names, model)
    if not missing:
        return frame
    views = depth_views(missing, cameras, tracked.vertices, faces)
    more = complete_labels(frame, views, model.prior, faces, model.colours, model.ids, settings)
    return replace(frame, labels=frame.labels | more)


def _unlabelled(frame, names, model):
    """Those of the cameras `names` whose pictures have no label image and can be told one by their colours."""
    tellable = () if model.colours is None else frame.images
    return [name for name in names if name in tellable and name not in frame.labels]


def _scan_votes(scan, points, ids, settings):
    """Shares (n,L) of the scan's own labels at points (n,3), 0 away from it."""
    face, _, bary, distance = scan.index.closest(points)
    shares = interpolate(label_shares(scan, ids), scan.faces[face], bary)
    return shares * (distance < settings.depth_tolerance)[:, None]


def evidence(
    frame: Frame,
    cameras: Mapping[str, Camera],
    model: SegmentModel,
    tracked: Tracked,
    faces: Ints,
    settings: SegmentSettings,
) -> Evidence:
    """What the frame's pictures say, seen past the scan and the tracked surface, and what labels its scan carries."""
    scan = Mesh(tracked.vertices, faces) if frame.scan is None else frame.scan
    V, F = scan.vertices, scan.faces
    names = [*frame.labels, *_unlabelled(frame, frame.images, model)]
    chosen = spread_views(cameras, names, V.mean(0), settings.views, len(frame.labels))
    frame = believed(frame, chosen, cameras, model.cloth, tracked, faces)
    frame = _completed(frame, chosen, cameras, model, tracked, faces, settings)
    both = np.concatenate([V, tracked.vertices]), np.concatenate([F, faces + len(V)])
    views = depth_views([name for name in frame.labels if name in chosen], chosen, *both)
    return Evidence(frame, views, scan, model.ids, model.colours, settings)


def segment(
    scene: Scene,
    evidence: Evidence,
    model: SegmentModel,
    tracked: Tracked,
    faces: Ints,
    settings: SegmentSettings,
    previous: Segmented | None = None,
    votes: Sequence[Vote] = (),
) -> Segmented:
    """Labels of one frame on the tracked vertices and on the scan (on the tracked surface where there is no scan). `votes`:
    those of the frame."""
    surface = Mesh(tracked.vertices, faces)
    places, voted = _place_costs(model, previous, settings), _vote_costs(votes, model, settings)
    labels, cost, colour, observed = _scan_labels(evidence, model, surface, places + voted, settings)
    probability, openings, shifts = _with_borders(scene, evidence, labels, cost, settings)
    vertex_labels = _tracked_labels(surface, probability, colour, evidence, places, voted, settings)
    face_labels = model.ids[probability[evidence.scan.faces].sum(1).argmax(1)]
    diagnostics = {
        "seen": float(observed.mean()),
        "border_moved_mm": float(1e3 * np.abs(shifts).mean()) if len(shifts) else 0.0,
    }
    return Segmented(model.ids[vertex_labels], face_labels, probability, model.ids, diagnostics, openings)


def _scan_labels(evidence, model, surface, priors, settings):
    """Columns (v,) of the scan's vertices by evidence and by the costs `priors` (n,L) of the tracked surface; the costs (v,L) of evidence
    alone, colours (v,3) in 0..1, and whether any view or label of the scan tells of them (v,)."""
    scan = evidence.scan
    cost, colour, observed = evidence.scan_costs()
    labels = solve_labels(cost + at_closest(surface, priors, scan.vertices), scan, colour, settings)
    likelihood = None if model.colours is None else model.colours.evidence((255 * colour + 0.5).astype(np.uint8))
    return dissolve_islands(labels, scan, settings, likelihood, observed), cost, colour, observed


def _with_borders(scene, evidence, labels, cost, settings):
    """Probabilities (v,L) of the scan's vertices by their labels (v,), which go over from one to the other at the garments' borders as
    pictures show them; {garment's label id: its border's curves}, and the shifts (k,) [m] of all borders."""
    probability = np.zeros(cost.shape, np.float32)
    probability[np.arange(len(labels)), labels] = 1
    shifts, openings = [np.zeros(0)], {}
    for garment in scene.garments if settings.refine_border or not evidence.views else ():
        label = scene.labels[garment.label]
        column = int(np.searchsorted(evidence.ids, label))
        border = refine_border(labels, column, evidence, settings)
        blend_border(probability, column, np.clip(0.5 + 0.5 * border.distance / settings.opening.ramp, 0, 1), cost)
        shifts.append(border.shifts)
        openings[label] = border.curves
    return probability, openings, np.concatenate(shifts)


def _check_ids(scene, samples):
    carried = np.zeros(256, bool)
    for frame, _ in samples:
        for image in frame.labels.values():
            carried[np.unique(image)] = True
        if frame.scan_labels is not None:
            carried[np.unique(frame.scan_labels)] = True
    for garment in scene.garments:
        if not carried[scene.labels[garment.label]]:
            raise UserError(
                f"scene.toml: labels.{garment.label} = {scene.labels[garment.label]}: "
                f"nothing in the sampled frames carries this id (garment {garment.name})"
            )


def _known_pixels(frame, views, ids, settings):
    """[(RGB (p,3), columns (p,) of their labels)] of each of a frame's `views` {camera: DepthView} that has a picture."""
    pixels = []
    for name, view in views.items():
        if name not in frame.images:
            continue
        column = np.searchsorted(ids, frame.labels[name]).clip(0, len(ids) - 1)
        known = (view.face >= 0) & (ids[column] == frame.labels[name])
        known &= ~occlusion_border(view.depth, settings.evidence.depth_step, settings.evidence.depth_border)
        if name in frame.certainty:
            known &= frame.certainty[name] > 255 * settings.sure_share
        pixels.append((frame.images[name][known], column[known].astype(np.uint8)))
    return pixels


def _fit_colours(pixels, ids, settings):
    """Colour models from `_known_pixels` of the sampled frames; None where no picture shows a label on the person."""
    if not any(len(labels) for _, labels in pixels):
        return None
    rgb, labels = (np.concatenate(of) for of in zip(*pixels))
    if len(rgb) > settings.colour_pixels:
        pick = np.random.default_rng(settings.seed).choice(len(rgb), settings.colour_pixels, replace=False)
        pick.sort()
        rgb, labels = rgb[pick], labels[pick]
    return fit_colours(rgb, labels.astype(np.int64), ids, settings.label_error_share, settings.colour_iterations)


def _place_costs(model, previous, settings):
    """Costs (n,L) of the tracked vertices from all sampled frames and the previous frame."""
    cost = -settings.prior_weight * np.log(model.prior)
    if previous is not None:
        cost += settings.previous_weight * (previous.vertices[:, None] != model.ids)
    return cost


def _vote_costs(votes, model, settings):
    """Costs (n,L) of the tracked vertices by people's votes."""
    cost = np.zeros_like(model.prior)
    for vote in votes:
        cost[vote.vertices, np.searchsorted(model.ids, vote.label)] += settings.vote_weight * (-1 if vote.prefer else 1)
    return cost


def _tracked_labels(surface, probability, colour, evidence, place, voted, settings):
    """Columns (n,) per tracked vertex: those of the scan's faces that pictures show, where one is near or where no picture
    shows the vertex; the pictures' elsewhere; those of votes; and the neighbours'. `probability` (p,L) and `colour` (p,3)
    are the scan's."""
    face, _, bary, distance = evidence.shown.index.closest(surface.vertices)
    corners = evidence.shown.faces[face]
    p, colour = interpolate(probability, corners, bary), interpolate(colour, corners, bary)
    cost = -settings.near_weight * np.log(p + settings.near_floor)
    off = np.flatnonzero(distance >= settings.depth_tolerance)
    by_pictures, colour[off], seen = evidence.costs(surface.vertices[off], surface.normals[off])
    unseen = -settings.unseen_weight * np.log(p[off] + settings.unseen_floor)
    cost[off] = np.where(seen[:, None], by_pictures + place[off], unseen)
    cost += voted
    smoothness = settings.tracked_smoothness * settings.smoothness
    if smoothness == 0:
        return cost.argmin(1)
    labels = solve_labels(cost, surface, colour, settings.model_copy(update={"smoothness": smoothness}))
    return np.where(voted.any(1), labels, dissolve_islands(labels, surface, settings))
