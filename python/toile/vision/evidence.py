"""What one frame says about any point: labels given by its pictures and by its scan, labels by colour, colours."""

import cv2
import numpy as np

from .. import kernels
from ..scene import Mesh
from .threads import parallel_map
from .visibility import DepthView, occlusion_border


def depth_views(names, cameras, V, F):
    """The DepthView of the surface from each camera of these names."""
    names = [name for name in names if name in cameras]
    return dict(zip(names, parallel_map(lambda name: DepthView(cameras[name], V, F), names)))


def spread_views(cameras, names, centre, most, first=1):
    """At most `most` of the cameras with these names, far apart as seen from `centre` [m]; all of them for 0. The `first`
    of them come before all others."""
    chosen = {name: cameras[name] for name in names if name in cameras}
    if most == 0 or len(chosen) <= most:
        return chosen
    rays = {name: camera.centre - centre for name, camera in chosen.items()}
    rays = {name: ray / max(np.linalg.norm(ray), 1e-12) for name, ray in rays.items()}
    before = list(rays)[: max(first, 1)]
    kept = before[:1]
    while len(kept) < most:  # farthest first
        left = [name for name in before if name not in kept] or [name for name in rays if name not in kept]
        kept.append(min(left, key=lambda n: max(rays[n] @ rays[k] for k in kept)))
    return {name: chosen[name] for name in chosen if name in kept}


def soft_labels(image, ids, settings, certainty=None):
    """Blurred indicator (H,W,L) of each label. Where labels are not certain (H,W uint8 [1/255]) what is left is shared by all."""
    if certainty is None:
        return kernels.soft_labels(image, ids, settings.label_blur)
    sure = certainty[..., None].astype(np.float32) / 255
    given = sure * (image[..., None] == ids) + (1 - sure) / len(ids) * (image[..., None] > 0)
    return cv2.GaussianBlur(given.astype(np.float32), (0, 0), settings.label_blur)


def soft_crop(view, image, ids, settings, certainty=None):
    """The Crop of `soft_labels` about a DepthView's surface."""
    rows, columns = view.crop(0, int(4 * settings.label_blur) + 2)
    certainty = None if certainty is None else certainty[rows, columns]
    return Crop(soft_labels(image[rows, columns], ids, settings, certainty), (columns.start, rows.start))


def visibility(views, points, normals, settings):
    """{name: pixels (n,2), weights (n,), clearance (n,)} of points (n,3), see DepthView.visibility."""
    seen = parallel_map(
        lambda view: view.visibility(points, normals, settings.depth_tolerance, settings.min_cosine), views.values()
    )
    return dict(zip(views, seen))


def mean_over_views(pictures, seen):
    """Mean (n,C) over the views that see each point of what their pictures say there, and the views' weight (n,)."""

    def one(name):
        uv, w, _ = seen[name]
        on = np.flatnonzero(w)
        return on, w[on, None], pictures[name].read(uv[on])

    readings = parallel_map(one, pictures)
    n = len(next(iter(seen.values()))[1]) if seen else 0
    total, weight = np.zeros((n, readings[0][2].shape[1] if readings else 0)), np.zeros(n)
    for on, w, reading in readings:
        total[on] += w * reading
        weight[on] += w[:, 0]
    return total / np.maximum(weight, 1e-9)[:, None], weight


def label_shares(mesh, ids):
    """Share (n,L) by area of the faces about each vertex that carry each label; rows sum to less than 1 where some carry
    none."""
    area = np.repeat(kernels.face_areas(mesh.vertices, mesh.faces), 3)
    n, corners, labels = len(mesh.vertices), mesh.faces.ravel(), np.repeat(mesh.face_labels, 3)
    whole = np.maximum(np.bincount(corners, area, n), 1e-30)
    return np.stack([np.bincount(corners, area * (labels == i), n) / whole for i in ids], 1)


class Crop:
    """Values (h,w,C) float32 of a view's pixels about the surface, from pixel `corner` (column, row) on. Beyond them the
    outermost go on."""

    def __init__(self, values, corner=(0, 0)):
        self.values, self.corner = np.ascontiguousarray(values, np.float32), np.array(corner, np.float64)

    def read(self, uv):
        """Bilinear values (n,C) at pixels (n,2) of the whole picture."""
        return kernels.bilinear(self.values, uv - self.corner)


class Evidence:
    """What a frame's pictures and the labels that its scan carries say; either may be missing. The errors of the two have
    nothing in common, so their costs and log odds are added.

    Per view a Crop of 2L+4 channels: log likelihoods of the labels by colour, shares of the blurred labels, RGB, and
    how empty the picture is.

    `scan` is a Mesh, `ids` (L,) the labels, `colours` their ColourModel or None, `settings` a SegmentSettings. `seen` (m,)
    are the faces that some view sees, all where none sees any, and `shown` is the Mesh of them; the others may be webs
    that a reconstruction spans under a hem."""

    def __init__(self, frame, views, scan, ids, colours, settings):
        self.views, self.scan, self.settings, self.ids, self.colours = views, scan, settings, ids, colours
        self.L = len(ids)
        self.shares = None if scan.face_labels is None else label_shares(scan, ids)
        self._scan_visibility = visibility(views, scan.vertices, scan.normals, settings)
        seen = np.zeros(len(scan.vertices), bool)
        for _, w, _ in self._scan_visibility.values():
            seen |= w > 0
        self.seen = seen[scan.faces].any(1)
        self.seen |= not self.seen.any()
        self.shown = Mesh(scan.vertices, scan.faces[self.seen])
        pictures = parallel_map(
            lambda name: self._picture(
                views[name], *(of.get(name) for of in (frame.labels, frame.images, frame.certainty))
            ),
            views,
        )
        self.maps = dict(zip(views, pictures))
        self._views = [view.with_picture(self.maps[name]) for name, view in views.items()]

    def _picture(self, view, labels, image, certainty):
        """The Crop of one view."""
        s, own = self.settings, self.settings.evidence
        rows, columns = view.crop(own.picture_margin, int(4 * s.label_blur))
        labels, depth = labels[rows, columns], view.depth[rows, columns]
        clear, colours = np.zeros(labels.shape, bool), None
        if self.colours is not None and image is not None:
            image = image[rows, columns]
            clear = (labels > 0) & ~occlusion_border(depth, own.depth_step, own.depth_border)
            colours = self.colours.evidence(image[clear])
        shown = None if colours is None else image
        every = kernels.evidence_picture(labels, self.ids, clear, colours, shown, s.label_blur, own.empty_blur)
        if certainty is not None:
            every[..., self.L : 2 * self.L] = soft_labels(labels, self.ids, s, certainty[rows, columns])
        return Crop(every, (columns.start, rows.start))

    def scan_costs(self):
        """`costs` of the scan's vertices, with what its own labels say; a labelled vertex is seen."""
        cost, colour, seen = self._costs(self._scan_visibility, len(self.scan.vertices))
        if self.shares is None:
            return cost, colour, seen
        return cost + self._given(self.shares), colour, seen | (self.shares.sum(1) > 0)

    def costs(self, points, normals):
        """Unary costs (n,L) by the pictures, mean RGB (n,3) in 0..1, and whether any view sees the point (n,)."""
        return self._costs(visibility(self.views, points, normals, self.settings), len(points))

    def _costs(self, seen, n):
        """Errors are alike in all views, so views are averaged, not added."""
        L = self.L
        if not self.views:
            return np.zeros((n, L)), np.zeros((n, 3)), np.zeros(n, bool)
        mean, weight = mean_over_views(self.maps, seen)
        cost = self._given(mean[:, L : 2 * L]) - self.settings.colour_weight * mean[:, :L]
        cost[weight == 0] = 0
        return cost, mean[:, 2 * L : 2 * L + 3], weight > 0

    def _given(self, shares):
        """Costs (n,L) of the labels by the shares (n,L) of those that were given, some of them wrong."""
        wrong = self.settings.label_error_share
        return -self.settings.label_weight * np.log((1 - wrong) * shares + wrong / self.L)

    def odds(self, points, normals, column, rival, free=False):
        """Log odds (n,) of label `column` against each point's label `rival`, by colour and by the labels given. Summed
        over views with weights below 1, and over the scan's own labels at points that lie on it.

        `free` points may float before the surface: any label given speaks against `column` there; that a picture shows
        the label farther behind them says nothing; and where a point lies off the scan, no view faces it and a picture
        shows the background, there is no cloth."""
        s, own = self.settings, self.settings.evidence
        seen = kernels.view_odds(
            self._views,
            points,
            normals,
            self.L,
            column,
            rival,
            tolerance=s.depth_tolerance,
            min_cosine=s.min_cosine,
            floating=own.floating_distance,
            behind=own.behind_share,
            most=own.max_log_odds,
            free=free,
        )
        by_colour, weight, carved = seen[:, 0], seen[:, 1], seen[:, 4]
        total = self._scan_odds(points, column, rival, free) + by_colour
        share = seen[:, 2:4] / np.maximum(weight, 1e-9)[:, None] + s.label_error_share / self.L
        total += np.where(weight > 0, own.given_weight * np.log(share[:, 0] / share[:, 1]), 0.0)
        if free:
            carved = carved * self._off_scan(points, carved > own.empty_share) * np.clip(1 - weight, 0, 1)
            total -= own.max_log_odds * np.clip((carved - own.empty_share) / own.empty_ramp, 0, 1)
        return total

    def _scan_odds(self, points, column, rival, free):
        """What the scan's own labels add to `odds`."""
        odds = np.zeros(len(points))
        if self.shares is None:
            return odds
        own = self.settings.evidence
        face, _, bary, _ = self.scan.index.closest(points, own.off_scan_distance)
        on = np.flatnonzero(face >= 0)
        given = np.einsum("nc,ncl->nl", bary[on], self.shares[self.scan.faces[face[on]]])
        against = given.sum(1) - given[:, column] if free else given[np.arange(len(on)), rival[on]]
        least = self.settings.label_error_share / self.L
        odds[on] = own.given_weight * np.log((given[:, column] + least) / (against + least))
        return odds

    def _off_scan(self, points, among):
        """Which of the points (n,) `among` (n,) lie off what the views see of the scan."""
        off = among.copy()
        if among.any():
            off[among] = self.shown.index.closest(points[among], self.settings.evidence.off_scan_distance)[0] < 0
        return off

    def outside(self, points):
        """Which points (n,) lie outside of the silhouettes: `outside_views` pictures or more show background about them."""
        own, count = self.settings.evidence, np.zeros(len(points), int)
        for name, view in self.views.items():
            there = np.flatnonzero(view.camera.sees(points))
            shown = self.maps[name].read(view.camera.project(points[there])[0])
            count[there] += shown[:, -1] > own.outside_share
        return count >= own.outside_views

    def edges(self, points, normals, s):
        """Colour edges along profiles (k,m,3) that run from outside in at places s (m,) [m] about 0: shift (k,) [m]
        of the edge from 0 and weight (k,). Each view's profile is read as a mix of its two ends' colours; the edge
        lies where a sharp one would cover the same length."""
        own = self.settings.evidence
        total, weight = kernels.view_edges(
            self._views,
            points.reshape(-1, 3),
            normals.reshape(-1, 3),
            self.L,
            s,
            tolerance=self.settings.depth_tolerance,
            min_cosine=self.settings.min_cosine,
            flank=own.edge_flank,
            contrast=own.edge_contrast,
            disorder=own.edge_disorder,
            shift=own.edge_shift,
        ).T
        return total / np.maximum(weight, 1e-9), weight
