"""A garment's opening found by the pictures, along a strip about a curve that lies near it."""

import numpy as np

from .. import kernels
from ..surface.curves import Curve, smooth


class Strip:
    """A strip of surface about a curve, and layers above and below it: a scan rounds off the step at a cloth's opening,
    so that the opening itself lies off the scan; the views agree about its colour edge only where it truly is.

    `surface(across (k,m) [m])` gives points and unit normals (k,m,3) at signed distances to the left of the curve, where
    the garment is; a `free` strip may leave the scan."""

    def __init__(self, curve, surface, free=False):
        self.curve, self.surface, self.free = curve, surface, free

    def minimal_path(self, evidence, column, rival, reach=None):
        """Offsets (k,) [m] to the left of the curve, the opening as a curve in space, and the mean log odds (k,2) for the
        garment beyond it and short of it: at an opening that is seen the first is negative, the second positive. `reach`: of the
        search to either side [m], by default the settings'."""
        settings, closed, k = evidence.settings.opening, self.curve.closed, len(self.curve.points)
        step, sigma, reach = settings.step, settings.smoothing / settings.spacing, reach or settings.reach
        s = np.arange(-1, 1 + 1e-9, step / reach) * reach
        wide = self._odds(s, np.zeros(1), np.zeros(k), evidence, column, rival)
        cost = _path_costs(wide, step / settings.evidence_length)[:, 0]
        cost = cost + settings.stay_cost * (s / step) ** 2 * (step / reach)
        j = np.arange(len(s))
        path = _closed_path(cost, (j[:, None] - j) ** 2.0, settings.stiffness, closed)
        sides = _sides(wide[:, 0], path, int(round(settings.flank / step)))
        offset = smooth(s[path] + _parabola(cost, path) * step, closed, sigma)

        h = np.arange(settings.depth[0], settings.depth[1] + 1e-9, settings.layer)
        h = np.array([settings.rounding]) if self.free else h
        r = np.arange(-settings.layer_steps, settings.layer_steps + 1) * step
        cost = _path_costs(self._odds(r, h, offset, evidence, column, rival), step / settings.evidence_length)
        cost += settings.lift * ((h[:, None] - settings.rounding) / settings.layer) ** 2
        i, j = np.divmod(np.arange(len(h) * len(r)), len(r))
        apart = (j[:, None] - j) ** 2 + settings.layer_stiffness * (i[:, None] - i) ** 2
        path = _closed_path(cost.reshape(k, -1), apart, settings.stiffness, closed)
        i, j = np.divmod(path, len(r))
        offset, height = (smooth(x, closed, sigma) for x in (offset + r[j], h[i]))
        offset = offset + self._subpixel(offset, height, evidence, sigma)
        points, normals = self.surface(offset[:, None])
        opening = points[:, 0] + height[:, None] * normals[:, 0]
        return offset, Curve(self.curve.points + smooth(opening - self.curve.points, closed, sigma), closed), sides

    def _odds(self, s, h, offset, evidence, column, rival):
        """Log odds (k, len(h), len(s)) for the garment at distances s about `offset` and heights h."""
        points, normals = self.surface(offset[:, None] + s)
        lifted = points[:, :, None] + h[:, None] * normals[:, :, None]
        facing = np.repeat(normals.reshape(-1, 3), len(h), 0)
        odds = evidence.odds(lifted.reshape(-1, 3), facing, column, np.repeat(rival, len(s) * len(h)), self.free)
        return odds.reshape(lifted.shape[:3]).transpose(0, 2, 1)

    def _subpixel(self, offset, height, evidence, sigma):
        """Shifts (k,) [m] that halve the pictures' edge ramps: a class of colours takes a mixed pixel for its own."""
        settings = evidence.settings.opening
        s = np.arange(-settings.edge_reach, settings.edge_reach + 1e-9, settings.step)
        points, normals = self.surface(offset[:, None] + s)
        shift, weight = evidence.edges(points + height[:, None, None] * normals, normals, s)
        weight = weight + 1e-6
        mean = smooth(weight * shift, self.curve.closed, sigma) / smooth(weight, self.curve.closed, sigma)
        total = smooth(weight, self.curve.closed, sigma)
        return mean * total / (total + settings.edge_prior)


def _path_costs(odds, share):
    """Costs of a cut at each place (last axis): the garment's evidence to its right, less that to its left; `share` of it
    that one place counts."""
    below = np.cumsum(odds, axis=2)
    return (2 * below - odds - below[..., -1:]) * share


def _sides(odds, path, width):
    """Mean odds (k,2) over `width` samples to the right and to the left of the path through odds (k,m)."""
    k, m = odds.shape
    below = np.concatenate([np.zeros((k, 1)), np.cumsum(odds, 1)], 1)
    row = np.arange(k)
    low, high = np.maximum(path - width, 0), np.minimum(path + 1 + width, m)
    return np.stack([below[row, path] - below[row, low], below[row, high] - below[row, path + 1]], 1) / width


def _closed_path(cost, apart, stiffness, closed):
    """argmin over paths j of sum cost[i, j_i] + stiffness sum apart[j_i, j_{i+1}] (Viterbi); a closed one goes round
    three times and the middle lap is kept."""
    k = len(cost)
    laps = np.concatenate([cost] * 3) if closed else cost
    path = kernels.cheapest_path(laps, stiffness * apart)
    return path[k : 2 * k] if closed else path


def _parabola(cost, path):
    """Sub-step place (-0.5..0.5) of the minimum through three neighbours."""
    k, m = cost.shape
    j = path.clip(1, m - 2)
    row = np.arange(k)
    a, b, c = cost[row, j - 1], cost[row, j], cost[row, j + 1]
    bend = a - 2 * b + c
    return np.where(bend > 1e-9, np.clip(0.5 * (a - c) / np.maximum(bend, 1e-9), -0.5, 0.5), 0.0)
