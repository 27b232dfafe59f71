"""Curves on surfaces: isolines, resampling, smoothing."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Curve:
    """A polyline (k,3) [m]; a closed one does not repeat its first point. Larger values lie on its left."""

    points: np.ndarray
    closed: bool

    @property
    def length(self):
        return float(_segments(self.points, self.closed).sum())


def isolines(V, F, value, level=0.5):
    """Curves where the piecewise linear `value` (n,) crosses `level`, longest first; open where the mesh ends."""
    high = value > level
    mixed = F[np.where((c := high[F].sum(1)) == 1, True, c == 2)]
    if len(mixed) == 0:
        return []
    one = high[mixed].sum(1) == 1
    odd = np.where(one[:, None], high[mixed], ~high[mixed]).argmax(1)  # the corner that differs from the other two
    row = np.arange(len(mixed))
    a, b, c = (mixed[row, (odd + i) % 3] for i in range(3))
    ab, ca = np.sort(np.stack([a, b], 1), 1), np.sort(np.stack([c, a], 1), 1)
    # one high corner lies left of ab -> ca, one low corner left of ca -> ab
    start, end = np.where(one[:, None], ab, ca), np.where(one[:, None], ca, ab)
    ends = np.concatenate([start, end]).astype(np.int64)
    key, index = np.unique(ends[:, 0] * len(V) + ends[:, 1], return_inverse=True)
    edges = np.stack(np.divmod(key, len(V)), 1)
    start, end = index.ravel()[: len(start)], index.ravel()[len(start) :]
    t = (level - value[edges[:, 0]]) / (value[edges[:, 1]] - value[edges[:, 0]])
    points = V[edges[:, 0]] + t[:, None] * (V[edges[:, 1]] - V[edges[:, 0]])
    curves = [Curve(points[chain], closed) for chain, closed in _chains(start, end, len(edges))]
    return sorted(curves, key=lambda curve: -curve.length)


def _chains(start, end, count):
    """Maximal chains of the arrows start -> end; a second arrow from one node (non-manifold edges) is dropped."""
    following = np.full(count, -1, np.int64)
    following[start[::-1]] = end[::-1]
    preceded = np.zeros(count, bool)
    preceded[following[following >= 0]] = True
    used = np.zeros(count, bool)
    heads = np.flatnonzero((following >= 0) & ~preceded)
    for head in np.concatenate([heads, np.flatnonzero(following >= 0)]):
        if used[head]:
            continue
        chain, node = [], int(head)
        while node >= 0 and not used[node]:
            used[node] = True
            chain.append(node)
            node = int(following[node])
        if len(chain) > 1:
            yield np.array(chain), node == head


def _segments(points, closed):
    following = np.roll(points, -1, 0) if closed else points[1:]
    return np.linalg.norm(following - points[: len(following)], axis=1)


def resample(curve, spacing):
    """Points at equal steps of about `spacing` [m] along the curve."""
    points = np.concatenate([curve.points, curve.points[:1]]) if curve.closed else curve.points
    s = np.concatenate([[0], np.cumsum(_segments(points, False))])
    count = max(int(np.ceil(s[-1] / spacing)), 3)
    at = np.linspace(0, s[-1], count + 1)[: count + (not curve.closed)]
    return Curve(np.stack([np.interp(at, s, points[:, i]) for i in range(3)], 1), curve.closed)


def pieces(curve, keep):
    """The open curves left of `curve` where `keep` (k,) holds; the whole curve where it holds everywhere."""
    if keep.all():
        return [curve]
    if curve.closed:  # begin with a gap
        first = int(np.argmin(keep))
        curve, keep = Curve(np.roll(curve.points, -first, 0), False), np.roll(keep, -first)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], keep.astype(np.int8), [0]])))
    return [Curve(curve.points[a:b], False) for a, b in ends.reshape(-1, 2) if b - a > 2]


def smooth(values, closed, sigma):
    """Gaussian smoothing along a curve of values (k, ...), sigma in samples; open ends are held by reflection."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, sigma, axis=0, mode="wrap" if closed else "reflect")


def tangents(curve):
    """Unit directions (k,3) along the curve."""
    p = curve.points
    if curve.closed:
        d = np.roll(p, -1, 0) - np.roll(p, 1, 0)
    else:
        d = np.gradient(p, axis=0)
    return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-12)
