"""A garment's loops laid on the openings that the pictures show beside them, on the scan or hanging free of it."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from ..scene import Mesh
from ..surface.curves import Curve, resample, smooth, tangents
from ..surface.loops import LoopInterpolation, LoopMatch, relaid
from .strip import Strip

STEPS = 8  # of a way into the silhouettes


class Rivals:
    """Which label a garment's opening parts it from: that of the nearest face of the scan that is not the garment's. `over`:
    labels of what is worn over the garment."""

    def __init__(self, V, F, segmented, label, over=()):
        self.V, self.F, self.faces, self.own = V, F, segmented.scan_faces, segmented.scan_faces == label
        self.ids, self.column = segmented.ids, int(np.searchsorted(segmented.ids, label))
        self.over = np.searchsorted(segmented.ids, np.array(over, np.uint8))

    @cached_property
    def tree(self):
        from scipy.spatial import cKDTree

        a, b, c = self.F[~self.own].T
        middles = (self.V[a] + self.V[b] + self.V[c]) / 3
        return cKDTree(middles, balanced_tree=False, compact_nodes=False)  # few queries: quickly built

    def __call__(self, points):
        """Columns (k,) of the labels' table; any other label where the scan shows the garment alone."""
        if self.own.all():
            return np.full(len(points), int(self.column == 0))
        return np.searchsorted(self.ids, self.faces[~self.own])[self.tree.query(points)[1]]

    def hide(self, points):
        """Where (k,) the garment goes on under another one."""
        return np.isin(self(points), self.over) if len(self.over) else np.zeros(len(points), bool)


def trace_opening(garment, loop, evidence, rivals, match, settings):
    """The LoopMatch of one loop of the garment, a Mesh that already lies within `opening.reach` of its opening;
    `settings` are LoopSettings.

    Along a strip that continues the garment past its loop, the pictures tell where cloth ends. Where they do not, the
    loop follows its seen neighbours; where they hardly do anywhere, `match` stands. A hem that swings free may lie farther off: where
    a part of a loop is seen so, and not most, a wider strip is searched, and believed if it shows more, and the same where the other did."""
    spacing, smoothness = evidence.settings.opening.spacing, evidence.settings.opening.presmoothing
    curve = resample(Curve(garment.vertices[loop], True), spacing)
    curve = Curve(smooth(curve.points, True, settings.smoothing / spacing), True)
    strip = Strip(curve, _strip(garment, curve, smoothness), free=True)
    rival, hidden = rivals(curve.points), rivals.hide(curve.points)

    def traced(reach):
        offset, opening, sides = strip.minimal_path(evidence, rivals.column, rival, reach)
        seen = _seen_log_odds(offset, sides, settings.background_way) > settings.min_log_odds
        return offset, opening.points, seen & ~hidden

    offset, opening, seen = traced(evidence.settings.opening.reach)
    shown = float(seen.mean())
    if settings.min_observed <= shown < settings.whole_share:
        far, *farther = traced(settings.far_reach)
        same = np.abs(far - offset)[seen] < settings.matched_distance
        if farther[1].mean() > seen.mean() and same.sum() >= settings.whole_share * len(same):
            opening, seen = farther
    if seen.mean() < settings.min_observed:
        return match
    return replace(_laid(garment.vertices[loop], curve.points, opening, seen, settings), shown=shown)


def cloth_within(cloth, evidence):
    """The Mesh of those faces of a garment's scan that lie within the silhouettes. None of them where too many do not: then pictures and
    scan disagree, and neither tells of a web."""
    outside = evidence.outside(cloth.vertices[cloth.faces].mean(1))
    disagree = outside.mean() > evidence.settings.evidence.outside_cloth
    return Mesh(cloth.vertices, cloth.faces[:0] if disagree else cloth.faces[~outside])


def within(at, match, evidence, cloth, settings):
    """The LoopMatch of a loop at (k,3) of which nothing lies outside of the silhouettes, as on a web of the scan: such targets are drawn
    towards the nearest of `cloth`, of `cloth_within`, if it lies within `far_reach`, until they lie within. A loop of which little is seen
    stays, as pictures did not lay it; so does one of which most lies outside: then masks lack the cloth."""
    if not len(cloth.faces) or match.observed.mean() < settings.min_observed:
        return match
    outside = evidence.outside(match.target)
    if not 0 < outside.mean() < evidence.settings.evidence.outside_loop:
        return match
    web = np.flatnonzero(outside)
    face, nearest, *_ = cloth.index.closest(match.target[web], radius=settings.far_reach)
    web, nearest = web[face >= 0], nearest[face >= 0]
    if not len(web):
        return match
    instead, false = match.target.copy(), np.isin(np.arange(len(at)), web)
    instead[web] = _first_within(match.target[web], nearest, evidence)
    return relaid(at, match, false, instead, settings)


def _first_within(points, ends, evidence):
    """The first places (n,3) that lie within the silhouettes on the way from points to ends (n,3), which do."""
    part = np.linspace(0, 1, STEPS + 1)[1:, None]
    way = points[:, None] + part * (ends - points)[:, None]
    outside = evidence.outside(way.reshape(-1, 3)).reshape(way.shape[:2])
    outside[:, -1] = False
    return way[np.arange(len(way)), outside.argmin(1)]


def _laid(at, curve, opening, seen, settings):
    """The LoopMatch of a loop's vertices `at` (k,3): where the points of a curve (c,3) beside it are `seen`, moved across the
    loop to those of its `opening` (c,3); elsewhere as their neighbours are."""
    nearest = np.linalg.norm(at[:, None] - curve, axis=2).argmin(1)
    way = tangents(Curve(at, True))
    wanted = opening[nearest] - at
    wanted -= np.einsum("ki,ki->k", wanted, way)[:, None] * way
    observed, bending = seen[nearest], settings.bending / 10**settings.bending_decades
    move = LoopInterpolation([len(at)], settings)(wanted, observed, at, bending, settings.stay_weight)
    return LoopMatch(at + move, observed, np.where(observed, np.linalg.norm(wanted - move, axis=1), np.nan))


def _seen_log_odds(offset, sides, way):
    """Log odds (k,) that an opening is there. Background seen past it bounds it, though nothing may show the cloth before it:
    that is believed for a short way, since a strip that leaves the cloth sideways meets background too."""
    outer, inner = -sides[:, 0], sides[:, 1]
    return np.where(np.abs(offset) < way, 0.5 * (inner + outer), np.minimum(inner, outer))


def _strip(garment, curve, smoothness):
    """The Strip's map: the garment's own surface on the left, its tangent plane beyond the loop."""
    index, N, F = garment.index, garment.normals, garment.faces
    face, _, bary, _ = index.closest(curve.points)
    normal = np.einsum("kc,kci->ki", bary, N[F[face]])
    normal = smooth(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9), True, smoothness)
    left = np.cross(normal, tangents(curve))
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)

    def surface(across):
        at = curve.points[:, None] + across[..., None] * left[:, None]
        normals = np.broadcast_to(normal[:, None], at.shape).copy()
        inner = across > 0
        face, points, bary, _ = index.closest(at[inner])
        at[inner], normals[inner] = points, np.einsum("kc,kci->ki", bary, N[F[face]])
        return at, normals

    return surface
