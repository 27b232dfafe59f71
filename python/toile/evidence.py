"""What the pictures of one frame say about any point: labels given, labels by colour, colours."""

import cv2
import numpy as np

from . import kernels
from .views import View, occlusion_border, read

_OUTLIER = -4.0  # least log likelihood ratio that one picture may give
_OFF = 0.005  # a point this far from the scan is off it [m]
_FREE = 0.02  # a point this far before the surface floats [m]


def look(frame, cameras, V, F):
    """The View of the surface from each camera whose label image the frame has."""
    return {name: View(cameras[name], V, F) for name in frame.labels if name in cameras}


def spread_views(cameras, names, centre, most):
    """At most `most` of the cameras with these names, far apart as seen from `centre` [m]; all of them for 0."""
    chosen = {name: cameras[name] for name in names if name in cameras}
    if most == 0 or len(chosen) <= most:
        return chosen
    rays = {name: camera.centre - centre for name, camera in chosen.items()}
    rays = {name: ray / max(np.linalg.norm(ray), 1e-12) for name, ray in rays.items()}
    kept = [next(iter(rays))]
    while len(kept) < most:  # farthest first
        kept.append(min((n for n in rays if n not in kept), key=lambda n: max(rays[n] @ rays[k] for k in kept)))
    return {name: chosen[name] for name in chosen if name in kept}


def soft_labels(image, ids, settings):
    """Blurred indicator (H,W,L) of each label."""
    return cv2.GaussianBlur((image[..., None] == ids).astype(np.float32), (0, 0), settings.label_blur)


def mean_over_views(maps, views, points, normals, settings):
    """Mean (n,C) over the views that see each point of what their maps (H,W,C) say, and the views' weight (n,)."""
    channels = next(iter(maps.values())).shape[2] if maps else 0
    total, weight = np.zeros((len(points), channels)), np.zeros(len(points))
    for name, map_ in maps.items():
        uv, w = views[name].see(points, normals, settings.tolerance, settings.min_cosine)
        on = np.flatnonzero(w)
        total[on] += w[on, None] * read(map_, uv[on])
        weight[on] += w[on]
    return total / np.maximum(weight, 1e-9)[:, None], weight


class Evidence:
    """Per view one map (H,W,2L+4): log likelihoods of the labels by colour, shares of the blurred labels, RGB, and how
    empty the picture is.

    V, F the scan, `ids` (L,) the labels, `colours` their ColourModel or None, `settings` a SegmentSettings. `seen` (m,)
    are the faces that some view sees, all where none sees any; the others may be webs that a reconstruction spans under
    a hem."""

    def __init__(self, frame, views, V, F, ids, colours, settings):
        self.views, self.settings, self.L = views, settings, len(ids)
        self.seen = self._seen(V, kernels.vertex_normals(V, F))[F].any(1)
        self.seen |= not self.seen.any()
        self._surface = kernels.SurfaceIndex(V, F[self.seen])
        self.maps, self.rgb = {}, {}
        for name, view in views.items():
            labels, size = frame.labels[name], view.depth.shape
            likelihood, rgb = np.zeros(size + (self.L,), np.float32), np.zeros(size + (3,), np.float32)
            if colours is not None and name in frame.images:
                clear = (labels > 0) & ~occlusion_border(view.depth, 0.03, 1)
                likelihood[clear] = colours.evidence(frame.images[name][clear])
                rgb = frame.images[name] / np.float32(255)
            empty = cv2.GaussianBlur((labels == 0).astype(np.float32), (0, 0), 1.0)[..., None]
            self.maps[name] = np.concatenate([likelihood, soft_labels(labels, ids, settings), rgb, empty], 2)
            self.rgb[name] = rgb

    def costs(self, points, normals):
        """Unary costs (n,L), mean RGB (n,3) in 0..1, and whether any view sees the point (n,).

        Errors are alike in all views, so views are averaged, not added."""
        s, L = self.settings, self.L
        mean, weight = mean_over_views(self.maps, self.views, points, normals, s)
        given = np.log((1 - s.wrong) * mean[:, L : 2 * L] + s.wrong / L)
        cost = -s.colour_weight * mean[:, :L] - s.label_weight * given
        cost[weight == 0] = 0
        return cost, mean[:, 2 * L : 2 * L + 3], weight > 0

    def _seen(self, points, normals):
        """Whether any view sees each point (n,)."""
        s = self.settings
        seen = np.zeros(len(points), bool)
        for view in self.views.values():
            seen |= view.see(points, normals, s.tolerance, s.min_cosine)[1] > 0
        return seen

    def odds(self, points, normals, column, rival, free=False):
        """Log odds (n,) of label `column` against each point's label `rival`, by colour and by the labels given. Summed
        over views with weights below 1.

        `free` points may float before the surface: any label given speaks against `column` there; that a picture shows
        the label farther behind them says nothing; and where a point lies off the scan, no view faces it and a picture
        shows the background, there is no cloth."""
        s, L = self.settings, self.L
        total, weight, carved = (np.zeros(len(points)) for _ in range(3))
        share = np.zeros((len(points), 2))
        for name, view in self.views.items():
            uv, w = view.see(points, normals, s.tolerance, s.min_cosine)
            if free:
                before = np.flatnonzero(view.clearance(points)[1] > _FREE)
                said = read(self.maps[name], uv[before])
                carved[before] = np.maximum(carved[before], said[:, -1])
                w[before[said[:, L + column] > 0.5]] = 0
            on = np.flatnonzero(w)
            said, each, other = read(self.maps[name], uv[on]), np.arange(len(on)), rival[on]
            given = said[:, L : 2 * L]
            against = given.sum(1) - given[:, column] if free else given[each, other]
            total[on] += w[on] * np.clip(said[:, column] - said[each, other], _OUTLIER, -_OUTLIER)
            share[on] += w[on, None] * np.stack([given[:, column], against], 1)
            weight[on] += w[on]
        share = share / np.maximum(weight, 1e-9)[:, None] + s.wrong / self.L
        total += np.where(weight > 0, 0.5 * np.log(share[:, 0] / share[:, 1]), 0.0)
        if free:
            carved *= self._off_scan(points, carved > 0.6) * np.clip(1 - weight, 0, 1)
            total += _OUTLIER * np.clip((carved - 0.6) / 0.35, 0, 1)
        return total

    def _off_scan(self, points, among):
        """Which of the points (n,) `among` (n,) lie off what the views see of the scan."""
        off = among.copy()
        if among.any():
            off[among] = self._surface.closest(points[among], _OFF)[0] < 0
        return off

    def edges(self, points, normals, s):
        """Colour edges along profiles (k,m,3) that run from outside in at places s (m,) [m] about 0: shift (k,) [m]
        of the edge from 0 and weight (k,). Each view's profile is read as a mix of its two ends' colours; the edge
        lies where a sharp one would cover the same length."""
        k, m = points.shape[:2]
        flank = np.abs(s) > 0.55 * s[-1]
        total, weight = np.zeros(k), np.zeros(k)
        for name, view in self.views.items():
            uv, w = view.see(points.reshape(-1, 3), normals.reshape(-1, 3), self.settings.tolerance, self.settings.min_cosine)
            rgb = read(self.rgb[name], uv).reshape(k, m, 3)
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
