"""The slide that lays one frame's print upon the reference: Gauss-Newton, coarse to fine, on the garment's own surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .. import kernels
from .lengths import Lengths

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of a symmetric 3 x 3 matrix
WHICH = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
HOLD = 1e4  # against the rest of the matrix
SEEN = 0.25  # share of a blurred point's neighbourhood that must have been seen
HARDLY = 0.01  # of the garment's area compared
KEPT = 0.5  # of what is compared: a slide that keeps less in sight is believed last


@dataclass(frozen=True)
class Matched:
    """A slide d (g,2) [m], and how well it fits: rms of what is left, over the parts seen in both, unslid and slid."""

    d: np.ndarray
    before: float
    after: float
    seen: float  # share of the garment's area that was compared
    kept: float  # the same once it has slid: of what slides out of sight nothing is left

    @property
    def blind(self):
        """Whether pictures show next to nothing of the print, so that it lies as where the search began."""
        return self.seen < HARDLY


class Matcher:
    """Matches prints on a SlidingSurface whose edges are as long as those of `template` (g,3); `settings` are PrintSettings.
    Slides without a print about them are drawn to `home` (g,2), to none by default."""

    def __init__(self, surface, template, settings, home=0.0):
        self.surface, self.template, self.settings, self.levels = surface, template, settings, settings.blurs
        self.sigma = np.array([settings.lightness_noise, settings.chroma_noise, settings.chroma_noise])
        self.home = home
        self.factor = kernels.CholeskyFactor()
        self.lengths = Lengths(surface, template, settings)
        self._grids = [_Grid(surface, sigma) for sigma in self.levels]
        self._shades = [self._shade_factor(settings.shade_blurs * sigma) for sigma in self.levels]
        self._pattern()

    def widened(self):
        """A Matcher for slides of centimetres: it begins with a print blurred much more, and cloth may stretch more."""
        s = self.settings
        more = {"blurs": (*s.wide_blurs, *s.blurs), "blur_steps": (*s.wide_steps, *(2 * n for n in s.blur_steps))}
        more |= {"slide_strain": s.wide_strain, "edge_strain": s.wide_edge_strain, "hold_loops": False}
        return Matcher(self.surface, self.template, s.model_copy(update=more))

    def about(self, home):
        """A Matcher of slides near `home` (g,2), whose cloth is as long as the rest shape there."""
        rest = self.surface.points_at(self.surface.rest, *self.surface.slid(home))
        return Matcher(self.surface, rest, self.settings, home)

    def pyramid(self, values, weights):
        """[(values (N,3), weights (N,))] a level, coarse to fine, of values known with weights 0..1."""
        out, start, total = [], 0.0, values * weights[:, None]
        for sigma in reversed(self.levels):
            total, weights = self.surface.lattice.blurred(total, weights, sigma, start)
            start = sigma
            out.append((total / np.maximum(weights, 1e-6)[:, None], weights * (weights > SEEN)))
        return out[::-1]

    def pulled(self, pictured, d, grid=None):
        """values (k,3), weights (k,) of a level as they lie under the lattice's points, or a grid's, once it has slid by d."""
        (values, weights), grid = pictured, grid or self._grids[-1]
        points = grid.positions + grid.to_points @ self.surface.vectors(d)
        ids, w = self.surface.lattice.look_up(*self.surface.places(points, grid.face))
        return np.einsum("nk,nkc->nc", w, values[ids]), np.einsum("nk,nk->n", w, weights[ids])

    def target(self, values, weights):
        """What frames are matched to: a reference's pyramid and its gradients at each level's points, [(values, weights,
        gradient (3,k,3))]."""
        out = []
        for (v, w), grid in zip(self.pyramid(values, weights), self._grids):
            out.append(
                (
                    v[grid.points],
                    w[grid.points],
                    np.stack([(G @ v)[grid.points] for G in self.surface.lattice.gradient]),
                )
            )
        return out

    def match(self, frame, target, posed, start=None):
        """The Matched slide of a frame's pyramid upon a target; `posed` (g,3) is the frame's registered surface. It follows
        the slide `start`; without one it begins with what the lengths of edges alone ask for."""
        nothing = np.zeros((len(self.surface.rest), 2))
        d = self.unstretched([posed]) if start is None else start
        share = 1.0 if start is None else self.settings.follow_share
        for k, count in enumerate(self.settings.blur_steps):
            for _ in range(math.ceil(share * count)):
                data = self._print_equations(k, *self._residual(frame, target, d, k), target[k][2])
                d = self._step(d, [posed], data)
        (before, seen), (after, kept) = self._misfit(frame, target, nothing), self._misfit(frame, target, d)
        return Matched(d, before, after, seen, kept)

    def best(self, frame, target, posed, starts):
        """Of the Matched slides from several `starts`, see `match`, the one that fits best, of equals the first; before all that
        slide most of what is compared out of sight."""
        found = (self.match(frame, target, posed, start) for start in starts)
        return min(found, key=lambda one: (one.kept < KEPT * one.seen, one.after))

    def unstretched(self, posed, slid=0.0):
        """The slide, the same for all frames, that leaves the edges' lengths on their `posed` surfaces (f,g,3) least changed;
        its smoothness counts together with that of `slid`, a slide that they have made already."""
        d = np.zeros((len(self.surface.rest), 2))
        for _ in range(self.settings.length_steps):
            d = self._step(d, posed, slid=slid)
        return d

    def _step(self, d, posed, data=None, slid=0.0):
        """d after one solve of the normal equations: of the lengths, the mean of those of all `posed` surfaces, of the slide's
        smoothness, and of `data` (entries, right side) where there are any."""
        places = self.surface.slid(d)
        entries, right = self._regular.data.copy(), self._regular @ (d - self.home + slid).ravel()
        for V in posed:
            blocks, b = self.lengths.equations(V, places)
            entries += np.bincount(self._edge_at, blocks.ravel(), len(entries)) / len(posed)
            right += b.ravel() / len(posed)
        if data is not None:
            entries, right = entries + data[0], right + data[1]
        A = sparse.csc_matrix((entries, self._indices, self._starts), shape=(len(right),) * 2)
        delta = -self.factor.factorize(A).solve(right[:, None])[:, 0].reshape(-1, 2)
        longest = np.linalg.norm(delta, axis=1, keepdims=True)
        return d + delta * np.minimum(1, self.settings.step_length / np.maximum(longest, 1e-12))

    def _misfit(self, frame, target, d):
        r, weight = self._residual(frame, target, d, len(self.levels) - 1)
        total = max(weight.sum(), 1e-12)
        rms = np.sqrt((weight * ((r / self.sigma) ** 2).mean(1)).sum() / total)
        return float(rms), float(total / self.surface.lattice.areas.sum())

    def _residual(self, frame, target, d, k):
        """r (N,3) at a level's points without what varies as slowly as light does, and weights (N,) [m^2]."""
        grid, (values, known, _) = self._grids[k], target[k]
        pulled, seen = self.pulled(frame[k], d, grid)
        weight = grid.areas * np.minimum(seen, 1) * np.minimum(known, 1)
        r = pulled - values
        return r - self._shade(r, weight, k), weight

    def _shade(self, r, weight, k):
        """The slowly varying part of r (N,3): its weighted mean over a neighbourhood."""
        to = self._grids[k].to_points
        both = self._shades[k].solve(np.ascontiguousarray(to.T @ np.c_[r * weight[:, None], weight]))
        return (to @ (both[:, :3] / np.maximum(both[:, 3:], 1e-9 * both[:, 3:].max() + 1e-30))) * (weight > 0)[:, None]

    def _shade_factor(self, reach):
        surface = self.surface
        L = kernels.cotangent_laplacian(surface.rest, surface.faces)
        return kernels.CholeskyFactor().factorize(sparse.csc_matrix(sparse.diags(surface.mass) - reach**2 / 2 * L))

    def _print_equations(self, k, residual, weight, gradient):
        """Entries of J'WJ and J'Wr of a level's residuals, with Welsch's robust weights."""
        robust = np.exp(-0.5 * (residual / (self.settings.robust_noise * self.sigma)) ** 2) / self.sigma**2
        cell = max(self.levels[k], self.surface.lattice.spacing) ** 2  # one independent reading each
        blocks, right = self._normal(self._grids[k], robust * (weight / cell)[:, None], residual, gradient)
        return np.bincount(self._at, blocks.ravel(), len(self._indices)), right

    def _normal(self, grid, w, r, gradient):
        """J'WJ as blocks (m,3,3,2,2) a face and pair of corners, and J'Wr (2g,)."""
        surface, T = self.surface, self.surface.frames[self.surface.faces]  # (m,3,2,3)
        weighted = gradient * w
        G = np.stack([(weighted[a] * gradient[b]).sum(1) for a, b in PAIRS], 1)
        h = np.stack([(g * r).sum(1) for g in weighted], 1)
        products = [grid.both[:, p, None] * G for p in range(6)] + [grid.bary[:, i, None] * h for i in range(3)]
        sums = grid.to_faces @ np.concatenate(products, 1)
        pairs = sums[:, :36].reshape(-1, 6, 6)[:, WHICH][..., WHICH]  # (m,3,3,3,3): corners, then axes
        blocks = T[:, :, None] @ pairs @ T.transpose(0, 1, 3, 2)[:, None]
        right = np.einsum("mipa,mia->mip", T, sums[:, 36:].reshape(-1, 3, 3))
        b = np.zeros((len(surface.rest), 2))
        np.add.at(b, surface.faces, right)
        return blocks, b.ravel()

    def _pattern(self):
        """The pattern of the matrix, the same whatever was seen, where in it the faces' blocks go, and what never changes."""
        s, surface = self.settings, self.surface
        F, two, n = 2 * surface.faces.astype(np.int64), np.arange(2), 2 * len(surface.rest)
        shape = (len(F), 3, 3, 2, 2)
        rows = np.broadcast_to(F[:, :, None, None, None] + two[:, None], shape).ravel()
        columns = np.broadcast_to(F[:, None, :, None, None] + two, shape).ravel()
        entries, self._at = np.unique(columns * n + rows, return_inverse=True)
        ends = 2 * surface.edges.T.astype(np.int64)
        rows, columns = ends[:, None, :, None, None] + two[:, None], ends[None, :, :, None, None] + two
        self._edge_at = np.searchsorted(entries, (columns * n + rows).ravel())
        self._indices, self._starts = entries % n, np.searchsorted(entries, n * np.arange(n + 1))
        hold = np.repeat(surface.mass / (s.strain_length * s.slide_length) ** 2, 2)
        if s.hold_loops:
            hold[0::2][surface.on_loop] += HOLD / s.strain_length**2
        hold[1::2][surface.on_loop] += HOLD / s.strain_length**2  # across a loop nothing slides
        fixed = (surface.smoothness / (s.slide_strain * s.strain_length) ** 2 + sparse.diags(hold)).tocoo()
        data = np.zeros(len(entries))
        np.add.at(data, np.searchsorted(entries, fixed.col.astype(np.int64) * n + fixed.row), fixed.data)
        self._regular = sparse.csc_matrix((data, self._indices, self._starts), shape=(n, n))


class _Grid:
    """The points of a lattice that a print of this blur needs, and how they hang on the mesh."""

    def __init__(self, surface, blur):
        lattice = surface.lattice
        self.points = np.arange(0, len(lattice), max(1, round(0.5 * (blur / lattice.spacing) ** 2)))
        self.face, self.bary, self.positions = (x[self.points] for x in (lattice.face, lattice.bary, lattice.positions))
        self.to_points, areas = lattice.to_points[self.points], lattice.areas[self.points]
        self.areas = areas * (lattice.areas.sum() / areas.sum())
        ones = np.ones(len(self.points))
        self.to_faces = sparse.csr_matrix(
            (ones, (self.face, np.arange(len(ones)))), shape=(len(surface.faces), len(ones))
        )
        self.both = np.stack([self.bary[:, i] * self.bary[:, j] for i, j in PAIRS], 1)
