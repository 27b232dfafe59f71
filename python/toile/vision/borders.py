"""The border of a garment on a labelled scan, placed between the scan's vertices by the pictures' own edges."""

from typing import NamedTuple

import numpy as np

from ..surface.curves import Curve, isolines, pieces, resample, smooth, tangents
from ..surface.operators import at_closest, interpolate, with_neighbours
from .strip import Strip


class Border(NamedTuple):
    """A garment's border: `distance` (n,) [m] of the scan's vertices to it, positive on the garment, clipped at `opening.ramp`;
    its `curves` in space where pictures show them; and by how much the pictures shift it, `shifts` (k,) [m]."""

    distance: np.ndarray
    curves: tuple[Curve, ...]
    shifts: np.ndarray


def refine_border(labels, column, evidence, settings) -> Border:
    """The Border by the pictures' edges of the garment of this column, of vertex labels (n,), which are columns. `settings` are
    SegmentSettings."""
    from scipy.spatial import cKDTree

    V, s, inside = evidence.scan.vertices, settings.opening, labels == column
    distance = np.where(inside, s.ramp, -s.ramp)
    coarse, outside = _coarse_curves(evidence.scan, inside, s), np.flatnonzero(~inside)
    if not coarse or len(outside) == 0:
        return Border(distance, (), np.zeros(0))
    nearest = cKDTree(V[outside], balanced_tree=False, compact_nodes=False)  # few queries: quickly built
    rival = lambda curve: labels[outside[nearest.query(curve.points)[1]]]
    traced = [_traced(curve, rival(curve), column, evidence, s) for curve in coarse]
    at, across, shifts = (np.concatenate(of) for of in list(zip(*traced))[:3])
    near, signed = _signed_distance(V, at, across, shifts, s.reach + s.ramp)
    distance[near] = np.clip(signed, -s.ramp, s.ramp)
    return Border(distance, tuple(curve for *_, curves in traced for curve in curves), shifts)


def _coarse_curves(scan, inside, s):
    """[Curve] between the scan's vertices that are `inside` (n,) and the others, evenly sampled and smoothed; `s` is `opening` of
    SegmentSettings."""
    soft, whole = with_neighbours(np.stack([inside, np.ones(len(inside))], 1), scan.edges, 2).T
    curves = [curve for curve in isolines(scan.vertices, scan.faces, soft / whole) if curve.length > s.min_length]
    curves = [resample(curve, s.spacing) for curve in curves]
    return [Curve(smooth(curve.points, curve.closed, s.presmoothing), curve.closed) for curve in curves]


def _traced(curve, rival, column, evidence, s):
    """Along a coarse curve of k points, beyond which the labels are `rival` (k,): its points (k,3), the directions (k,3) across it,
    the shifts (k,) [m] along these, and the pieces of the border that pictures show."""
    left, surface = _strip(curve, evidence.scan)
    shift, border, sides = Strip(curve, surface).minimal_path(evidence, column, rival)
    return curve.points, left, shift, pieces(border, np.minimum(-sides[:, 0], sides[:, 1]) > s.min_log_odds)


def _strip(curve, scan):
    """Unit directions (k,3) across the curve, in the surface, towards the garment; and the Strip's map onto the scan."""
    left = np.cross(at_closest(scan, scan.normals, curve.points), tangents(curve))
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)

    def surface(across):
        at = curve.points[:, None] + across[..., None] * left[:, None]
        face, points, bary, _ = scan.index.closest(at.reshape(-1, 3))
        return points.reshape(at.shape), interpolate(scan.normals, scan.faces[face], bary).reshape(at.shape)

    return left, surface


def _signed_distance(V, at, across, shift, reach):
    """Which of V (n,3) lie within `reach` [m] of the points `at` (k,3), and their signed distances [m] along `across` (k,3) to the border
    that lies `shift` (k,) [m] beside these points."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(at).query(V, distance_upper_bound=reach)
    near = np.flatnonzero(np.isfinite(distance))
    k = nearest[near]
    return near, np.einsum("ni,ni->n", V[near] - at[k], across[k]) - shift[k]


def blend_border(probability, column, p, cost):
    """Gives a label's column of `probability` (v,L) the values p (v,). The other labels share what is left as they did, or where
    they had nothing the cheapest of them by `cost` (v,L) takes it."""
    rest = np.delete(np.arange(probability.shape[1]), column)
    others = probability[:, rest]
    others = np.where(others.sum(1, keepdims=True) > 0, others, _cheapest(cost, rest))
    probability[:, rest] = others * ((1 - p) / np.maximum(others.sum(1), 1e-9))[:, None]
    probability[:, column] = p


def _cheapest(cost, rest):
    """(v,len(rest)) 1 for the cheapest of the columns `rest` of `cost` (v,L), 0 for the others."""
    out = np.zeros((len(cost), len(rest)), np.float32)
    out[np.arange(len(cost)), cost[:, rest].argmin(1)] = 1
    return out
