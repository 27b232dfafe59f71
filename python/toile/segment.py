"""Labels of a captured surface: given label images, colour models and neighbours in space and time, fused by an MRF;
the border of each garment is then placed between scan vertices by the pictures' own edges."""

from dataclasses import dataclass

import numpy as np

from . import kernels
from .colours import ColourModel, fit_colours
from .curves import Curve, isolines, resample, smooth, tangents
from .scene import CaptureError, Segmented
from .views import View, occlusion_border, read

_OUTLIER = -4.0  # least log likelihood ratio that one picture may give


@dataclass(frozen=True)
class SegmentModel:
    """What is fixed for a sequence: the labels' colours, and how often each place carries each label."""

    ids: np.ndarray  # (L,) uint8, ascending
    colours: ColourModel | None
    prior: np.ndarray  # (n,L) per tracked vertex, rows sum to 1


def prepare(scene, cameras, samples, faces, settings):
    """Fits the colour models on sampled frames [(Frame, Tracked)]; `faces` (m,3) of the tracked surface."""
    ids = np.array(sorted(set(scene.labels.values())), dtype=np.uint8)
    if not any(frame.labels for frame, _ in samples):
        raise CaptureError("labels: none of the sampled frames has label images, and the scene names a garment")
    _check_ids(scene, samples)
    n, L = len(samples[0][1].vertices), len(ids)
    votes = np.zeros((n, L))
    seen = [(frame, _views(frame, cameras, tracked.vertices, faces)) for frame, tracked in samples]
    for (frame, views), (_, tracked) in zip(seen, samples):
        N = kernels.vertex_normals(tracked.vertices, faces)
        votes += _label_votes(frame, views, tracked.vertices, N, ids, settings)[0]
    prior = _spread(votes, faces, rounds=1) + 1e-9
    prior = prior / prior.sum(1, keepdims=True) + settings.prior_floor
    prior /= prior.sum(1, keepdims=True)
    return SegmentModel(ids, _fit(seen, prior, faces, ids, settings), prior)


def segment(scene, cameras, model, frame, tracked, faces, settings, previous=None):
    """Labels of one frame on the tracked vertices and on the scan (on the tracked surface where there is no scan)."""
    if frame.scan is None:
        scan_V, scan_F = tracked.vertices, faces
    else:
        scan_V, scan_F = frame.scan.vertices, frame.scan.faces
    V = np.concatenate([scan_V, tracked.vertices])
    F = np.concatenate([scan_F, faces + len(scan_V)])
    views = _views(frame, cameras, V, F)
    evidence = _Evidence(frame, views, model, settings)
    N = kernels.vertex_normals(scan_V, scan_F)
    surface = kernels.SurfaceIndex(tracked.vertices, faces)
    place = _interpolate(_place_costs(model, previous, settings), *_closest(surface, scan_V, faces))
    cost, colour, observed = evidence.costs(scan_V, N)
    labels = _solve(cost + place, scan_V, scan_F, colour, settings)
    labels = _dissolve_islands(labels, scan_V, scan_F, settings.min_region)

    probability = np.zeros((len(scan_V), len(model.ids)), np.float32)
    probability[np.arange(len(scan_V)), labels] = 1
    moved = []
    scan_index = kernels.SurfaceIndex(scan_V, scan_F)
    for garment in scene.garments:
        column = int(np.searchsorted(model.ids, scene.labels[garment.label]))
        distance, shift = _refine_border(labels, column, scan_V, scan_F, N, scan_index, evidence, settings)
        p = np.clip(0.5 + 0.5 * distance / settings.ramp, 0, 1)
        rest = np.delete(np.arange(len(model.ids)), column)
        others = probability[:, rest]
        others = np.where(others.sum(1, keepdims=True) > 0, others, _runner_up(cost, rest))
        probability[:, rest] = others * ((1 - p) / np.maximum(others.sum(1), 1e-9))[:, None]
        probability[:, column] = p
        moved.append(shift)
    vertex_labels = _tracked_labels(tracked, faces, scan_V, scan_F, scan_index, probability, evidence, model, previous, settings)
    face_labels = model.ids[probability[scan_F].sum(1).argmax(1)]
    shifts = np.concatenate(moved) if moved else np.zeros(0)
    diagnostics = {
        "seen": float(observed.mean()),
        "border_moved_mm": float(1e3 * np.abs(shifts).mean()) if len(shifts) else 0.0,
    }
    return Segmented(model.ids[vertex_labels], face_labels, probability, model.ids, diagnostics)


def _check_ids(scene, samples):
    found = np.zeros(256, bool)
    for frame, _ in samples:
        for image in frame.labels.values():
            found[np.unique(image)] = True
    for garment in scene.garments:
        if not found[scene.labels[garment.label]]:
            raise CaptureError(
                f"scene.toml: labels.{garment.label} = {scene.labels[garment.label]}: "
                f"no label image of the sampled frames carries this id (garment {garment.name})"
            )


def _views(frame, cameras, V, F):
    names = [name for name in frame.labels if name in cameras]
    return {name: View(cameras[name], V, F) for name in names}


def _one_hot(image, ids):
    return (image[..., None] == ids).astype(np.float32)


def _label_votes(frame, views, points, normals, ids, settings):
    """Mean of the blurred label images over views (n,L), and the weight of the views (n,)."""
    import cv2

    total, weight = np.zeros((len(points), len(ids))), np.zeros(len(points))
    for name, view in views.items():
        soft = cv2.GaussianBlur(_one_hot(frame.labels[name], ids), (0, 0), settings.label_blur)
        uv, w = view.see(points, normals, settings.tolerance, settings.min_cosine)
        on = w > 0
        total[on] += w[on, None] * read(soft, uv[on])
        weight[on] += w[on]
    return total, weight


def _fit(seen, prior, faces, ids, settings):
    """Colour models from the pixels of the sampled frames; None where the capture has no pictures."""
    rgb, given, place = [], [], []
    for frame, views in seen:
        for name, view in views.items():
            if name not in frame.images:
                continue
            column = np.searchsorted(ids, frame.labels[name]).clip(0, len(ids) - 1)
            known = (view.face >= 0) & (ids[column] == frame.labels[name])
            known &= ~occlusion_border(view.depth, 0.03, 1)
            rgb.append(frame.images[name][known])
            given.append(column[known])
            place.append(view.face[known])
    if not rgb:
        return None
    rgb, given, place = np.concatenate(rgb), np.concatenate(given), np.concatenate(place)
    if len(rgb) > settings.colour_pixels:
        pick = np.random.default_rng(settings.seed).choice(len(rgb), settings.colour_pixels, replace=False)
        pick.sort()
        rgb, given, place = rgb[pick], given[pick], place[pick]
    return fit_colours(rgb, given, prior[faces].mean(1)[place], ids, settings.wrong, settings.colour_iterations)


def _spread(values, faces, rounds):
    edges = kernels.unique_edges(faces)
    for _ in range(rounds):
        out = values.copy()
        np.add.at(out, edges[:, 0], values[edges[:, 1]])
        np.add.at(out, edges[:, 1], values[edges[:, 0]])
        values = out
    return values


class _Evidence:
    """What the pictures of one frame say about any point of the surface."""

    def __init__(self, frame, views, model, settings):
        self.views, self.settings, self.frame, self.model = views, settings, frame, model
        self.maps = {}
        for name, view in views.items():
            if model.colours is None or name not in frame.images:
                continue
            map_ = np.zeros(view.depth.shape + (len(model.ids),), np.float32)
            near = frame.labels[name] > 0
            map_[near] = model.colours.evidence(frame.images[name][near])
            map_[occlusion_border(view.depth, 0.03, 1)] = 0
            self.maps[name] = map_

    def costs(self, points, normals):
        """Unary costs (n,L), mean RGB (n,3) in 0..1, and whether any view sees the point (n,).

        Errors are alike in all views, so views are averaged, not added."""
        s = self.settings
        votes, weight = _label_votes(self.frame, self.views, points, normals, self.model.ids, s)
        share = votes / np.maximum(weight, 1e-9)[:, None]
        L = share.shape[1]
        cost = -s.label_weight * np.log((1 - s.wrong) * share + s.wrong / L)
        colour, rgb = self.colour(points, normals)
        cost -= s.colour_weight * colour
        cost[weight == 0] = 0
        return cost, rgb, weight > 0

    def colour(self, points, normals):
        """Mean over the views of the log likelihoods (n,L) and of RGB (n,3)."""
        s = self.settings
        total, rgb = np.zeros((len(points), len(self.model.ids))), np.zeros((len(points), 3))
        weight = np.zeros(len(points))
        for name, map_ in self.maps.items():
            uv, w = self.views[name].see(points, normals, s.tolerance, s.min_cosine)
            on = w > 0
            total[on] += w[on, None] * read(map_, uv[on])
            rgb[on] += w[on, None] * read(self.frame.images[name], uv[on])
            weight[on] += w[on]
        return total / np.maximum(weight, 1e-9)[:, None], rgb / np.maximum(weight, 1e-9)[:, None] / 255

    def odds(self, points, normals, column, other):
        """Log odds (n,) of label `column` against label `other` (n,), summed over views with weights below 1."""
        s = self.settings
        total = np.zeros(len(points))
        for name, map_ in self.maps.items():
            uv, w = self.views[name].see(points, normals, s.tolerance, s.min_cosine)
            on = np.flatnonzero(w > 0)
            value = read(map_, uv[on])
            ratio = value[:, column] - value[np.arange(len(on)), other[on]]
            total[on] += w[on] * np.clip(ratio, _OUTLIER, -_OUTLIER)
        votes, weight = _label_votes(self.frame, self.views, points, normals, self.model.ids, s)
        share = votes / np.maximum(weight, 1e-9)[:, None]
        a, b = share[:, column], share[np.arange(len(points)), other]
        floor = s.wrong / share.shape[1]
        return total + np.where(weight > 0, 0.5 * np.log((a + floor) / (b + floor)), 0.0)


def _place_costs(model, previous, settings):
    """Costs (n,L) of the tracked vertices from all sampled frames and the previous frame."""
    cost = -settings.prior_weight * np.log(model.prior)
    if previous is not None:
        cost += settings.previous_weight * (previous.vertices[:, None] != model.ids)
    return cost


def _closest(index, points, faces):
    face, _, bary, distance = index.closest(points)
    return faces[face], bary


def _interpolate(values, corners, bary):
    return np.einsum("nc,ncl->nl", bary, values[corners])


def _solve(cost, V, F, colour, settings):
    """Potts MRF on the surface; an edge costs its length, less across an edge of the picture."""
    edges = kernels.unique_edges(F)
    length = np.linalg.norm(V[edges[:, 0]] - V[edges[:, 1]], axis=1)
    difference = np.linalg.norm(colour[edges[:, 0]] - colour[edges[:, 1]], axis=1)
    weights = settings.smoothness * np.clip(length / max(length.mean(), 1e-12), 0, 2)
    weights = weights / (1 + (difference / settings.contrast) ** 2) + 0.1
    return np.asarray(kernels.mrf(cost - cost.min(1, keepdims=True), edges, weights).labels)


def _dissolve_islands(labels, V, F, least):
    """Regions of one label smaller than `least` [m^2] take the label around them, if they touch one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = kernels.unique_edges(F)
    area = np.bincount(F.ravel(), np.repeat(kernels.face_areas(V, F) / 3, 3), minlength=len(V))
    labels = labels.copy()
    for _ in range(2):
        same = labels[edges[:, 0]] == labels[edges[:, 1]]
        graph = coo_matrix((np.ones(same.sum()), edges[same].T), shape=(len(V),) * 2)
        _, part = connected_components(graph, directed=False)
        small = np.bincount(part, area)[part] < least
        across = edges[~same]
        across = np.concatenate([across, across[:, ::-1]])
        across = across[small[across[:, 0]] & ~small[across[:, 1]]]
        if len(across) == 0:
            break
        votes = np.zeros((part.max() + 1, labels.max() + 1))
        np.add.at(votes, (part[across[:, 0]], labels[across[:, 1]]), 1)
        change = small & (votes[part].sum(1) > 0)
        labels[change] = votes[part[change]].argmax(1)
    return labels


def _runner_up(cost, rest):
    out = np.zeros((len(cost), len(rest)), np.float32)
    out[np.arange(len(cost)), cost[:, rest].argmin(1)] = 1
    return out


def _refine_border(labels, column, V, F, N, index, evidence, settings):
    """Signed distance (n,) [m] of scan vertices to the garment's border, positive on the garment, clipped at
    `ramp`; and the shifts of the border's samples [m]."""
    from scipy.spatial import cKDTree

    inside = labels == column
    distance = np.where(inside, settings.ramp, -settings.ramp)
    soft = _spread(inside.astype(float), F, 2) / _spread(np.ones(len(V)), F, 2)
    curves = [c for c in isolines(V, F, soft) if c.length > 0.02]
    outside = np.flatnonzero(~inside)
    if not curves or len(outside) == 0:
        return distance, np.zeros(0)
    opponents = cKDTree(V[outside])
    at, across, shift = [], [], []
    for curve in curves:
        curve = resample(curve, settings.rim_spacing)
        curve = Curve(smooth(curve.points, curve.closed, 3.0), curve.closed)
        face, _, bary, _ = index.closest(curve.points)
        normal = _interpolate(N, F[face], bary)
        left = np.cross(normal, tangents(curve))
        left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
        other = labels[outside[opponents.query(curve.points)[1]]]
        at.append(curve.points)
        across.append(left)
        shift.append(_best_cut(curve, left, other, column, N, F, index, evidence, settings))
    at, across, shift = np.concatenate(at), np.concatenate(across), np.concatenate(shift)
    d, k = cKDTree(at).query(V, distance_upper_bound=settings.rim_reach + settings.ramp)
    near = np.flatnonzero(np.isfinite(d))
    k = k[near]
    signed = np.einsum("ni,ni->n", V[near] - at[k], across[k]) - shift[k]
    distance[near] = np.clip(signed, -settings.ramp, settings.ramp)
    return distance, shift


def _best_cut(curve, left, other, column, N, F, index, evidence, settings):
    """Offsets (k,) [m] to the left that part the evidence best: a shortest path across a ribbon about the curve."""
    steps = int(round(settings.rim_reach / settings.rim_step))
    s = np.arange(-steps, steps + 1) * settings.rim_step
    ribbon = curve.points[:, None] + s[:, None] * left[:, None]
    face, points, bary, _ = index.closest(ribbon.reshape(-1, 3))
    normals = _interpolate(N, F[face], bary)
    odds = evidence.odds(points, normals, column, np.repeat(other, len(s))).reshape(len(curve.points), len(s))
    # cutting at s_j pays for garment evidence on its right (below j) and for the opposite on its left
    cumulative = np.cumsum(odds, axis=1)
    cost = 2 * (cumulative - 0.5 * odds) * (settings.rim_step / 0.004)
    cost += 0.02 * (s / settings.rim_step) ** 2 * (settings.rim_step / settings.rim_reach)  # stay where nothing speaks
    path = _shortest_path(np.concatenate([cost, cost, cost]) if curve.closed else cost, settings.rim_stiffness)
    path = path[len(cost) : 2 * len(cost)] if curve.closed else path
    offset = s[path] + _parabola(cost, path) * settings.rim_step
    return smooth(offset, curve.closed, settings.rim_smoothing / settings.rim_spacing)


def _shortest_path(cost, stiffness):
    """argmin over paths j of sum cost[i, j_i] + stiffness sum (j_i - j_{i+1})^2 (Viterbi)."""
    k, m = cost.shape
    step = stiffness * (np.arange(m)[:, None] - np.arange(m)) ** 2.0
    best, back = cost[0], np.zeros((k, m), np.int64)
    for i in range(1, k):
        total = best[:, None] + step
        back[i] = total.argmin(0)
        best = total[back[i], np.arange(m)] + cost[i]
    path = np.empty(k, np.int64)
    path[-1] = best.argmin()
    for i in range(k - 1, 0, -1):
        path[i - 1] = back[i, path[i]]
    return path


def _parabola(cost, path):
    """Sub-step place (-0.5..0.5) of the minimum through three neighbours."""
    k, m = cost.shape
    j = path.clip(1, m - 2)
    row = np.arange(k)
    a, b, c = cost[row, j - 1], cost[row, j], cost[row, j + 1]
    bend = a - 2 * b + c
    return np.where(bend > 1e-9, np.clip(0.5 * (a - c) / np.maximum(bend, 1e-9), -0.5, 0.5), 0.0)


def _tracked_labels(tracked, faces, scan_V, scan_F, index, probability, evidence, model, previous, settings):
    """Columns (n,) per tracked vertex: the scan's where it is near, the pictures and the neighbours elsewhere."""
    V = tracked.vertices
    face, _, bary, distance = index.closest(V)
    near = distance < settings.tolerance
    p = _interpolate(probability, scan_F[face], bary)
    cost, colour, _ = evidence.costs(V, kernels.vertex_normals(V, faces))
    cost += _place_costs(model, previous, settings)
    cost[near] = -4 * np.log(p[near] + 1e-3)
    return _solve(cost, V, faces, colour, replace_smoothness(settings, 0.5))


def replace_smoothness(settings, factor):
    return settings.model_copy(update={"smoothness": settings.smoothness * factor})
