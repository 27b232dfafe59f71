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
from ..surface.curves import Curve, isolines, pieces, resample, smooth, tangents
from ..surface.operators import adjacency
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
from ..vision.strip import Strip
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
    shown = [(cameras[name], tracked.vertices.mean(0)) for frame, tracked in samples for name in frame.labels]
    widths = [camera.to_camera(middle)[2] / camera.K[0, 0] for camera, middle in shown]
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
    shown = ((frame, views(frame, tracked)) for frame, tracked in samples)
    cloth = limb_cloth(scene, parts or {}, faces, shown, settings.skin_colour)
    samples = [
        (believed(frame, frame.certainty, cameras, cloth, tracked, faces), tracked) for frame, tracked in samples
    ]
    _check_ids(scene, samples)
    model = replace(_fitted(cameras, samples, faces, ids, settings), cloth=cloth)
    for _ in range(settings.completion_rounds):
        if not any(_unlabelled(frame, frame.images, model) for frame, _ in samples):
            break
        votes = _no_votes(samples, ids)
        for given, tracked in samples:
            frame = _completed(given, given.images, cameras, model, tracked, faces, settings)
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
    told = [name for name in frame.certainty if name in names]
    return retold(frame, depth_views(told, cameras, tracked.vertices, faces), faces, cloth)


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
        given = lambda name: (frame.labels[name], ids, settings, frame.certainty.get(name))
        soft = {name: soft_crop(view, *given(name)) for name, view in views.items()}
        share, weight = mean_over_views(soft, visibility(views, tracked.vertices, N, settings))
        votes += share * weight[:, None]
    if frame.scan_labels is not None:
        votes += _scan_votes(frame.scan, tracked.vertices, ids, settings)


def _prior(votes, faces, settings):
    """Probabilities (n,L) of the labels by votes (n,L) of a vertex and its neighbours."""
    prior = _with_neighbours(votes, kernels.unique_edges(faces)) + 1e-9
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
    told = () if model.colours is None else frame.images
    return [name for name in names if name in told and name not in frame.labels]


def _scan_votes(scan, points, ids, settings):
    """Shares (n,L) of the scan's own labels at points (n,3), 0 away from it."""
    face, _, bary, distance = scan.index.closest(points)
    shares = _interpolate(label_shares(scan, ids), scan.faces[face], bary)
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
    told = frame.images if model.colours is not None else {}  # pictures whose labels can be
    names = [*frame.labels, *(name for name in told if name not in frame.labels)]
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
    scan, surface = evidence.scan, Mesh(tracked.vertices, faces)
    voted = _vote_costs(votes, model, settings)
    places = _place_costs(model, previous, settings)
    place = _interpolate(places + voted, *_closest(surface, scan.vertices))
    cost, colour, observed = evidence.scan_costs()
    labels = _solve_labels(cost + place, scan, colour, settings)
    likelihood = None if model.colours is None else model.colours.evidence((255 * colour + 0.5).astype(np.uint8))
    labels = _dissolve_islands(labels, scan, settings, likelihood, observed)

    probability = np.zeros((len(scan.vertices), len(model.ids)), np.float32)
    probability[np.arange(len(scan.vertices)), labels] = 1
    moved, openings = [], {}
    for garment in scene.garments if settings.refine_border or not evidence.views else ():
        column = int(np.searchsorted(model.ids, scene.labels[garment.label]))
        distance, curves, shift = _refine_border(labels, column, evidence, settings)
        _ramp(probability, column, np.clip(0.5 + 0.5 * distance / settings.opening.ramp, 0, 1), cost)
        moved.append(shift)
        openings[scene.labels[garment.label]] = curves
    vertex_labels = _tracked_labels(surface, probability, colour, evidence, places, voted, settings)
    face_labels = model.ids[probability[scan.faces].sum(1).argmax(1)]
    shifts = np.concatenate(moved) if moved else np.zeros(0)
    diagnostics = {
        "seen": float(observed.mean()),
        "border_moved_mm": float(1e3 * np.abs(shifts).mean()) if len(shifts) else 0.0,
    }
    return Segmented(model.ids[vertex_labels], face_labels, probability, model.ids, diagnostics, openings)


def _check_ids(scene, samples):
    found = np.zeros(256, bool)
    for frame, _ in samples:
        for image in frame.labels.values():
            found[np.unique(image)] = True
        if frame.scan_labels is not None:
            found[np.unique(frame.scan_labels)] = True
    for garment in scene.garments:
        if not found[scene.labels[garment.label]]:
            raise UserError(
                f"scene.toml: labels.{garment.label} = {scene.labels[garment.label]}: "
                f"nothing in the sampled frames carries this id (garment {garment.name})"
            )


def _known_pixels(frame, views, ids, settings):
    """[(RGB (p,3), columns (p,) of their labels)] of each of a frame's `views` {camera: DepthView} that has a picture."""
    found = []
    for name, view in views.items():
        if name not in frame.images:
            continue
        column = np.searchsorted(ids, frame.labels[name]).clip(0, len(ids) - 1)
        known = (view.face >= 0) & (ids[column] == frame.labels[name])
        known &= ~occlusion_border(view.depth, settings.evidence.depth_step, settings.evidence.depth_border)
        if name in frame.certainty:
            known &= frame.certainty[name] > 255 * settings.sure_share
        found.append((frame.images[name][known], column[known].astype(np.uint8)))
    return found


def _fit_colours(pixels, ids, settings):
    """Colour models from `_known_pixels` of the sampled frames; None where no picture shows a label on the person."""
    if not any(len(given) for _, given in pixels):
        return None
    rgb, given = (np.concatenate(of) for of in zip(*pixels))
    if len(rgb) > settings.colour_pixels:
        pick = np.random.default_rng(settings.seed).choice(len(rgb), settings.colour_pixels, replace=False)
        pick.sort()
        rgb, given = rgb[pick], given[pick]
    return fit_colours(rgb, given.astype(np.int64), ids, settings.label_error_share, settings.colour_iterations)


def _with_neighbours(values, edges, rounds=1):
    """Sums of values (n, ...) over each vertex and its neighbours along edges (e,2), `rounds` times."""
    A = adjacency(edges, len(values))
    for _ in range(rounds):
        values = values + A @ values
    return values


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


def _closest(mesh, points):
    """Corners (n,3) and barycentrics (n,3) of the closest points of a Mesh."""
    face, _, bary, _ = mesh.index.closest(points)
    return mesh.faces[face], bary


def _interpolate(values, corners, bary):
    return np.einsum("nc,ncl->nl", bary, values[corners])


def _solve_labels(cost, mesh, colour, settings):
    """Potts MRF on the surface; an edge costs its length, less across an edge of the picture."""
    edges, V = mesh.edges, mesh.vertices
    length = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    difference = np.linalg.norm(colour[edges[:, 0]] - colour[edges[:, 1]], axis=1)
    weights = settings.smoothness * np.clip(length / max(length.mean(), 1e-12), 0, settings.max_edge_ratio)
    weights = weights / (1 + (difference / settings.colour_contrast) ** 2) + settings.smoothness_floor
    return np.asarray(
        kernels.mrf(cost - cost.min(1, keepdims=True), edges, weights, **settings.mrf.model_dump()).labels
    )


def _dissolve_islands(labels, mesh, settings, likelihood=None, seen=None):
    """Regions of one label smaller than `min_region` [m^2] take the label around them, if they touch one. So do those up to
    `doubted_region` whose colours, of log likelihoods (n,L) where they are `seen` (n,), are rather that label's."""
    V, F, edges = mesh.vertices, mesh.faces, mesh.edges
    area = np.bincount(F.ravel(), np.repeat(kernels.face_areas(V, F) / 3, 3), minlength=len(V))
    labels = labels.copy()
    for _ in range(2):
        same = labels[edges[:, 0]] == labels[edges[:, 1]]
        part = kernels.vertex_components(edges[same][:, [0, 1, 1]], len(V))
        areas = np.bincount(part, area)
        least = settings.min_region if likelihood is None else max(settings.min_region, settings.doubted_region)
        small = (areas < least)[part]
        across = edges[~same]
        across = np.concatenate([across, across[:, ::-1]])
        across = across[small[across[:, 0]] & ~small[across[:, 1]]]
        if len(across) == 0:
            break
        votes = np.zeros((part.max() + 1, labels.max() + 1))
        np.add.at(votes, (part[across[:, 0]], labels[across[:, 1]]), 1)
        around = votes.argmax(1)[part]
        change = small & (votes[part].sum(1) > 0)
        if likelihood is not None:
            rows = np.arange(len(V))
            own = np.where(seen, likelihood[rows, labels] - likelihood[rows, around], 0)
            change &= ((areas < settings.min_region) | (np.bincount(part, area * own) < 0))[part]
        labels[change] = around[change]
    return labels


def _ramp(probability, column, p, cost):
    """Gives a label's column of `probability` (v,L) the values p (v,). The other labels share what is left as they did, or where
    they had nothing the cheapest of them by `cost` (v,L) takes it."""
    rest = np.delete(np.arange(probability.shape[1]), column)
    others = probability[:, rest]
    others = np.where(others.sum(1, keepdims=True) > 0, others, _runner_up(cost, rest))
    probability[:, rest] = others * ((1 - p) / np.maximum(others.sum(1), 1e-9))[:, None]
    probability[:, column] = p


def _runner_up(cost, rest):
    """(v,len(rest)) 1 for the cheapest of the columns `rest` of `cost` (v,L), 0 for the others."""
    out = np.zeros((len(cost), len(rest)), np.float32)
    out[np.arange(len(cost)), cost[:, rest].argmin(1)] = 1
    return out


def _refine_border(labels, column, evidence, settings):
    """The garment's border by the pictures' edges. Returns the signed distance (n,) [m] of scan vertices to it,
    positive on the garment, clipped at `opening.ramp`; the border's curves in space; and their shifts [m]."""
    from scipy.spatial import cKDTree

    scan, own = evidence.scan, settings.opening
    V, F, inside = scan.vertices, scan.faces, labels == column
    distance = np.where(inside, own.ramp, -own.ramp)
    soft, whole = _with_neighbours(np.stack([inside, np.ones(len(V))], 1), scan.edges, 2).T
    soft = soft / whole
    coarse = [c for c in isolines(V, F, soft) if c.length > own.min_length]
    outside = np.flatnonzero(~inside)
    if not coarse or len(outside) == 0:
        return distance, (), np.zeros(0)
    rivals = cKDTree(V[outside], balanced_tree=False, compact_nodes=False)  # few queries: quickly built
    at, across, shift, openings = [], [], [], []
    for curve in coarse:
        curve = resample(curve, own.spacing)
        curve = Curve(smooth(curve.points, curve.closed, own.presmoothing), curve.closed)
        rival = labels[outside[rivals.query(curve.points)[1]]]
        left, strip = _strip(curve, scan)
        offset, opening, sides = Strip(curve, strip).minimal_path(evidence, column, rival)
        at.append(curve.points)
        across.append(left)
        shift.append(offset)
        openings += pieces(opening, np.minimum(-sides[:, 0], sides[:, 1]) > own.min_log_odds)
    at, across, shift = np.concatenate(at), np.concatenate(across), np.concatenate(shift)
    d, k = cKDTree(at).query(V, distance_upper_bound=own.reach + own.ramp)
    near = np.flatnonzero(np.isfinite(d))
    k = k[near]
    signed = np.einsum("ni,ni->n", V[near] - at[k], across[k]) - shift[k]
    distance[near] = np.clip(signed, -own.ramp, own.ramp)
    return distance, tuple(openings), shift


def _strip(curve, scan):
    """Unit directions (k,3) across the curve, in the surface, towards the garment; and the Strip's map onto the scan."""
    left = np.cross(_interpolate(scan.normals, *_closest(scan, curve.points)), tangents(curve))
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)

    def surface(across):
        at = curve.points[:, None] + across[..., None] * left[:, None]
        face, points, bary, _ = scan.index.closest(at.reshape(-1, 3))
        return points.reshape(at.shape), _interpolate(scan.normals, scan.faces[face], bary).reshape(at.shape)

    return left, surface


def _tracked_labels(surface, probability, colour, evidence, place, voted, settings):
    """Columns (n,) per tracked vertex: those of the scan's faces that pictures show, where one is near or where no picture
    shows the vertex; the pictures' elsewhere; those of votes; and the neighbours'. `probability` (p,L) and `colour` (p,3)
    are the scan's."""
    face, _, bary, distance = evidence.shown.index.closest(surface.vertices)
    corners = evidence.shown.faces[face]
    p, colour = _interpolate(probability, corners, bary), _interpolate(colour, corners, bary)
    cost = -settings.near_weight * np.log(p + settings.near_floor)
    off = np.flatnonzero(distance >= settings.depth_tolerance)
    told, colour[off], seen = evidence.costs(surface.vertices[off], surface.normals[off])
    unseen = -settings.unseen_weight * np.log(p[off] + settings.unseen_floor)
    cost[off] = np.where(seen[:, None], told + place[off], unseen)
    cost += voted
    smoothness = settings.tracked_smoothness * settings.smoothness
    if smoothness == 0:
        return cost.argmin(1)
    labels = _solve_labels(cost, surface, colour, settings.model_copy(update={"smoothness": smoothness}))
    return np.where(voted.any(1), labels, _dissolve_islands(labels, surface, settings))
