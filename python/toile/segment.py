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
        soft = {name: _soft_labels(frame.labels[name], ids, settings) for name in views}
        share, weight = _mean_over_views(soft, views, tracked.vertices, N, settings)
        votes += share * weight[:, None]
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
    moved, rims = [], {}
    scan_index = kernels.SurfaceIndex(scan_V, scan_F)
    for garment in scene.garments:
        column = int(np.searchsorted(model.ids, scene.labels[garment.label]))
        distance, curves, shift = _refine_border(labels, column, scan_V, scan_F, N, scan_index, evidence, settings)
        p = np.clip(0.5 + 0.5 * distance / settings.ramp, 0, 1)
        rest = np.delete(np.arange(len(model.ids)), column)
        others = probability[:, rest]
        others = np.where(others.sum(1, keepdims=True) > 0, others, _runner_up(cost, rest))
        probability[:, rest] = others * ((1 - p) / np.maximum(others.sum(1), 1e-9))[:, None]
        probability[:, column] = p
        moved.append(shift)
        rims[scene.labels[garment.label]] = curves
    place = _place_costs(model, previous, settings)
    vertex_labels = _tracked_labels(tracked, faces, scan_F, scan_index, probability, evidence, place, settings)
    face_labels = model.ids[probability[scan_F].sum(1).argmax(1)]
    shifts = np.concatenate(moved) if moved else np.zeros(0)
    diagnostics = {
        "seen": float(observed.mean()),
        "border_moved_mm": float(1e3 * np.abs(shifts).mean()) if len(shifts) else 0.0,
    }
    return Segmented(model.ids[vertex_labels], face_labels, probability, model.ids, diagnostics, rims)


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


def _soft_labels(image, ids, settings):
    """Blurred indicator (H,W,L) of each label."""
    import cv2

    return cv2.GaussianBlur((image[..., None] == ids).astype(np.float32), (0, 0), settings.label_blur)


def _mean_over_views(maps, views, points, normals, settings):
    """Mean (n,C) over the views that see each point of what their maps (H,W,C) say, and the views' weight (n,)."""
    channels = next(iter(maps.values())).shape[2] if maps else 0
    total, weight = np.zeros((len(points), channels)), np.zeros(len(points))
    for name, map_ in maps.items():
        uv, w = views[name].see(points, normals, settings.tolerance, settings.min_cosine)
        on = np.flatnonzero(w)
        total[on] += w[on, None] * read(map_, uv[on])
        weight[on] += w[on]
    return total / np.maximum(weight, 1e-9)[:, None], weight


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
    """What the pictures of one frame say about any point of the surface: per view one map (H,W,2L+3) of log
    likelihoods by colour, shares of the blurred labels, and RGB."""

    def __init__(self, frame, views, model, settings):
        self.views, self.settings, self.L = views, settings, len(model.ids)
        self.maps = {}
        for name, view in views.items():
            labels = frame.labels[name]
            map_ = np.zeros(view.depth.shape + (2 * self.L + 3,), np.float32)
            map_[..., self.L : 2 * self.L] = _soft_labels(labels, model.ids, settings)
            if model.colours is not None and name in frame.images:
                clear = (labels > 0) & ~occlusion_border(view.depth, 0.03, 1)
                map_[clear, : self.L] = model.colours.evidence(frame.images[name][clear])
                map_[..., 2 * self.L :] = frame.images[name] / np.float32(255)
            self.maps[name] = map_

    def costs(self, points, normals):
        """Unary costs (n,L), mean RGB (n,3) in 0..1, and whether any view sees the point (n,).

        Errors are alike in all views, so views are averaged, not added."""
        s, L = self.settings, self.L
        mean, weight = _mean_over_views(self.maps, self.views, points, normals, s)
        given = np.log((1 - s.wrong) * mean[:, L : 2 * L] + s.wrong / L)
        cost = -s.colour_weight * mean[:, :L] - s.label_weight * given
        cost[weight == 0] = 0
        return cost, mean[:, 2 * L :], weight > 0

    def odds(self, points, normals, column, other):
        """Log odds (n,) of label `column` against label `other` (n,), summed over views with weights below 1."""
        s, L = self.settings, self.L
        total, share, weight = np.zeros(len(points)), np.zeros((len(points), 2)), np.zeros(len(points))
        floor = s.wrong / L
        for name, map_ in self.maps.items():
            uv, w = self.views[name].see(points, normals, s.tolerance, s.min_cosine)
            for rival in np.unique(other):
                on = np.flatnonzero((w > 0) & (other == rival))
                ratio = np.clip(map_[..., column] - map_[..., rival], _OUTLIER, -_OUTLIER)
                pair = map_[..., [L + column, L + rival]]
                value = read(np.concatenate([ratio[..., None], pair], -1), uv[on])
                total[on] += w[on] * value[:, 0]
                share[on] += w[on, None] * value[:, 1:]
                weight[on] += w[on]
        share /= np.maximum(weight, 1e-9)[:, None]
        return total + np.where(weight > 0, 0.5 * np.log((share[:, 0] + floor) / (share[:, 1] + floor)), 0.0)


    def edges(self, points, normals, s):
        """Colour edges along profiles (k,m,3) that run from outside in at places s (m,) [m] about 0: shift (k,) [m]
        of the edge from 0 and weight (k,). Each view's profile is read as a mix of its two ends' colours; the edge
        lies where a sharp one would cover the same length."""
        k, m = points.shape[:2]
        flank = np.abs(s) > 0.55 * s[-1]
        total, weight = np.zeros(k), np.zeros(k)
        for name, map_ in self.maps.items():
            uv, w = self.views[name].see(points.reshape(-1, 3), normals.reshape(-1, 3), self.settings.tolerance,
                                         self.settings.min_cosine)
            rgb = read(map_[..., 2 * self.L :], uv).reshape(k, m, 3)
            out, inner = rgb[:, flank & (s < 0)].mean(1), rgb[:, flank & (s > 0)].mean(1)
            step = inner - out
            contrast = np.linalg.norm(step, axis=1)
            share = np.einsum("kmi,ki->km", rgb - out[:, None], step) / np.maximum(contrast, 1e-6)[:, None] ** 2
            rest = rgb - out[:, None] - share[..., None] * step[:, None]  # colours off the mixing line: print, folds
            spoilt = np.linalg.norm(rest, axis=2).mean(1) + np.abs(share - (s > 0))[:, flank].mean(1) * contrast
            at = (0.5 - np.clip(share, 0, 1).mean(1)) * (s[-1] - s[0])
            good = w.reshape(k, m).min(1) * np.exp(-((0.1 / np.maximum(contrast, 1e-6)) ** 2))
            good = good * np.exp(-((spoilt / np.maximum(contrast, 1e-6) / 0.1) ** 2)) * (np.abs(at) < 0.6 * s[-1])
            total += good * at
            weight += good
        return total / np.maximum(weight, 1e-9), weight


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
    """The garment's border by the pictures' edges. Returns the signed distance (n,) [m] of scan vertices to it,
    positive on the garment, clipped at `ramp`; the border's curves in space; and their shifts [m]."""
    from scipy.spatial import cKDTree

    inside = labels == column
    distance = np.where(inside, settings.ramp, -settings.ramp)
    soft = _spread(inside.astype(float), F, 2) / _spread(np.ones(len(V)), F, 2)
    coarse = [c for c in isolines(V, F, soft) if c.length > 0.02]
    outside = np.flatnonzero(~inside)
    if not coarse or len(outside) == 0:
        return distance, (), np.zeros(0)
    rivals = cKDTree(V[outside])
    at, across, shift, rims = [], [], [], []
    for curve in coarse:
        curve = resample(curve, settings.rim_spacing)
        curve = Curve(smooth(curve.points, curve.closed, 3.0), curve.closed)
        left = _left(curve, N, F, index)
        rival = labels[outside[rivals.query(curve.points)[1]]]
        ribbon = _Ribbon(curve, left, N, F, index)
        offset, rim = ribbon.cut(evidence, column, rival, settings)
        at.append(curve.points)
        across.append(left)
        shift.append(offset)
        rims.append(rim)
    at, across, shift = np.concatenate(at), np.concatenate(across), np.concatenate(shift)
    d, k = cKDTree(at).query(V, distance_upper_bound=settings.rim_reach + settings.ramp)
    near = np.flatnonzero(np.isfinite(d))
    k = k[near]
    signed = np.einsum("ni,ni->n", V[near] - at[k], across[k]) - shift[k]
    distance[near] = np.clip(signed, -settings.ramp, settings.ramp)
    return distance, tuple(rims), shift


def _left(curve, N, F, index):
    """Unit directions (k,3) across the curve, in the surface, towards the garment."""
    face, _, bary, _ = index.closest(curve.points)
    left = np.cross(_interpolate(N, F[face], bary), tangents(curve))
    return left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)


class _Ribbon:
    """A strip of surface about a curve, and layers above and below it: a scan rounds off the step at a cloth's rim,
    so that the rim itself lies off the scan; the views agree about its colour edge only where it truly is."""

    def __init__(self, curve, left, N, F, index):
        self.curve, self.left, self.N, self.F, self.index = curve, left, N, F, index

    def cut(self, evidence, column, rival, settings):
        """Offsets (k,) [m] to the left, and the rim as a curve in space."""
        closed, step = self.curve.closed, settings.rim_step
        s = np.arange(-1, 1 + 1e-9, step / settings.rim_reach) * settings.rim_reach
        cost = self._costs(s, np.zeros(1), 0.0, evidence, column, rival, settings)
        cost = cost[:, 0] + 0.02 * (s / step) ** 2 * (step / settings.rim_reach)  # stay where nothing speaks
        j = np.arange(len(s))
        path = _closed_path(cost, (j[:, None] - j) ** 2.0, settings.rim_stiffness, closed)
        offset = smooth(s[path] + _parabola(cost, path) * step, closed, settings.rim_smoothing / settings.rim_spacing)

        h = np.arange(settings.rim_depth[0], settings.rim_depth[1] + 1e-9, settings.rim_layer)
        r = np.arange(-6, 7) * step
        cost = self._costs(r, h, offset, evidence, column, rival, settings)
        cost += settings.rim_lift * ((h[:, None] - 0.003) / settings.rim_layer) ** 2
        i, j = np.divmod(np.arange(len(h) * len(r)), len(r))
        apart = (j[:, None] - j) ** 2 + 40.0 * (i[:, None] - i) ** 2
        path = _closed_path(cost.reshape(len(cost), -1), apart, settings.rim_stiffness, closed)
        i, j = np.divmod(path, len(r))
        sigma = settings.rim_smoothing / settings.rim_spacing
        offset, height = (smooth(x, closed, sigma) for x in (offset + r[j], h[i]))
        offset = offset + self._subpixel(offset, height, evidence, sigma, settings)
        points, normals = self._surface(offset[:, None])
        rim = points[:, 0] + height[:, None] * normals[:, 0]
        return offset, Curve(self.curve.points + smooth(rim - self.curve.points, closed, sigma), closed)

    def _subpixel(self, offset, height, evidence, sigma, settings):
        """Shifts (k,) [m] that halve the pictures' edge ramps: a class of colours takes a mixed pixel for its own."""
        s = np.arange(-settings.edge_reach, settings.edge_reach + 1e-9, settings.rim_step)
        points, normals = self._surface(offset[:, None] + s)
        shift, weight = evidence.edges(points + height[:, None, None] * normals, normals, s)
        weight = weight + 1e-6
        mean = smooth(weight * shift, self.curve.closed, sigma) / smooth(weight, self.curve.closed, sigma)
        sure = smooth(weight, self.curve.closed, sigma)
        return mean * sure / (sure + 0.03)

    def _surface(self, across):
        """Scan points and normals (k,m,3) at signed distances `across` (k,m) to the left of the curve."""
        at = self.curve.points[:, None] + across[..., None] * self.left[:, None]
        face, points, bary, _ = self.index.closest(at.reshape(-1, 3))
        return points.reshape(at.shape), _interpolate(self.N, self.F[face], bary).reshape(at.shape)

    def _costs(self, s, h, offset, evidence, column, rival, settings):
        """Costs (k, len(h), len(s)) of a cut at s of layer h: the garment's evidence to its right, less that to its
        left."""
        points, normals = self._surface((np.zeros(len(self.curve.points)) + offset)[:, None] + s)
        lifted = points[:, :, None] + h[:, None] * normals[:, :, None]
        facing = np.repeat(normals.reshape(-1, 3), len(h), 0)
        odds = evidence.odds(lifted.reshape(-1, 3), facing, column, np.repeat(rival, len(s) * len(h)))
        odds = odds.reshape(lifted.shape[:3]).transpose(0, 2, 1)
        below = np.cumsum(odds, axis=2)
        return (2 * below - odds - below[..., -1:]) * (settings.rim_step / 0.004)


def _closed_path(cost, apart, stiffness, closed):
    """argmin over paths j of sum cost[i, j_i] + stiffness sum apart[j_i, j_{i+1}] (Viterbi); a closed one goes round
    three times and the middle lap is kept."""
    k = len(cost)
    laps = np.concatenate([cost] * 3) if closed else cost
    path = _shortest_path(laps, stiffness * apart)
    return path[k : 2 * k] if closed else path


def _shortest_path(cost, step):
    k, m = cost.shape
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


def _tracked_labels(tracked, faces, scan_F, index, probability, evidence, place, settings):
    """Columns (n,) per tracked vertex: the scan's where it is near, the pictures and the neighbours elsewhere."""
    V = tracked.vertices
    face, _, bary, distance = index.closest(V)
    near = distance < settings.tolerance
    p = _interpolate(probability, scan_F[face], bary)
    cost, colour, _ = evidence.costs(V, kernels.vertex_normals(V, faces))
    cost += place
    cost[near] = -4 * np.log(p[near] + 1e-3)
    return _solve(cost, V, faces, colour, settings.model_copy(update={"smoothness": 0.5 * settings.smoothness}))
