"""The slide that lays one frame's print upon the reference: Gauss-Newton, coarse to fine, on the garment's own surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .. import kernels

SEEN = 0.25  # share of a blurred point's neighbourhood that must have been seen


@dataclass(frozen=True)
class Matched:
    """A slide d (g,2) [m], and how well it fits: rms of what is left, over the parts seen in both."""

    d: np.ndarray
    before: float
    after: float
    seen: float  # share of the garment's area that was compared


class Matcher:
    """Matches prints on a SlidingSurface; `settings` are AlignSettings."""

    def __init__(self, surface, settings):
        self.surface, self.settings = surface, settings
        lattice = surface.lattice
        self.levels = settings.blur
        self.K = surface.smoothness
        self.factor = kernels.CholeskyFactor()
        self._shades = {s: self._shade_factor(settings.shade * max(s, lattice.spacing)) for s in self.levels}
        self._pattern()

    def pyramid(self, values, weights):
        """[(values (N,3), weights (N,))] a level, coarse to fine, of values known with weights 0..1."""
        out, start, total = [], 0.0, values * weights[:, None]
        for sigma in reversed(self.levels):
            total, weights = self.surface.lattice.blurred(total, weights, sigma, start)
            start = sigma
            out.append((total / np.maximum(weights, 1e-6)[:, None], weights * (weights > SEEN)))
        return out[::-1]

    def pulled(self, pictured, d):
        """values (N,3), weights (N,) of a level as they lie under the lattice's points once it has slid by d."""
        values, weights = pictured
        lattice, surface = self.surface.lattice, self.surface
        points = lattice.positions + lattice.to_points @ surface.vectors(d)
        ids, w = lattice.look_up(*surface.places(points, lattice.face))
        return np.einsum("nk,nkc->nc", w, values[ids]), np.einsum("nk,nk->n", w, weights[ids])

    def match(self, frame, reference, start=None):
        """The Matched slide of a frame's pyramid upon the reference's, from the slide `start` (none by default)."""
        g = len(self.surface.rest)
        d = np.zeros((g, 2)) if start is None else start.copy()
        for k, sigma in enumerate(self.levels):
            gradient = [G @ reference[k][0] for G in self.surface.lattice.gradient]
            for _ in range(self.settings.iterations[k]):
                residual, weight = self._residual(frame[k], reference[k], d, sigma)
                d = self._step(d, residual, weight, gradient, sigma)
        before = self._misfit(frame[-1], reference[-1], np.zeros((g, 2)))
        after = self._misfit(frame[-1], reference[-1], d)
        return Matched(d, before[0], after[0], after[1])

    def _misfit(self, pictured, reference, d):
        residual, weight = self._residual(pictured, reference, d, self.levels[-1])
        scaled = (residual / self._sigma()) ** 2
        total = weight.sum()
        return float(np.sqrt((weight * scaled.mean(1)).sum() / max(total, 1e-12))), float(total / self.surface.lattice.areas.sum())

    def _sigma(self):
        return np.array([self.settings.light, self.settings.chroma, self.settings.chroma])

    def _residual(self, pictured, reference, d, sigma):
        """r (N,3) without what varies as slowly as light does, and weights (N,) [m^2]."""
        values, seen = self.pulled(pictured, d)
        weight = self.surface.lattice.areas * np.minimum(seen, 1) * np.minimum(reference[1], 1)
        r = values - reference[0]
        return r - self._shade(r, weight, sigma), weight

    def _shade(self, r, weight, sigma):
        """The slowly varying part of r (N,3): its weighted mean over a neighbourhood."""
        to, factor = self.surface.lattice.to_points, self._shades[sigma]
        both = factor.solve(np.ascontiguousarray(to.T @ np.c_[r * weight[:, None], weight]))
        return (to @ (both[:, :3] / np.maximum(both[:, 3:], 1e-9 * both[:, 3:].max(initial=1e-9)))) * (weight > 0)[:, None]

    def _shade_factor(self, reach):
        surface = self.surface
        L = kernels.cotangent_laplacian(surface.rest, surface.faces)
        A = sparse.diags(surface.mass) - reach**2 / 2 * L
        return kernels.CholeskyFactor().factorize(sparse.csc_matrix(A))

    def _step(self, d, residual, weight, gradient, sigma):
        """d after one solve of the normal equations, robust weights of Welsch."""
        s, lattice = self.settings, self.surface.lattice
        scaled = residual / self._sigma()
        robust = np.exp(-0.5 * (scaled / s.robust) ** 2) / self._sigma() ** 2
        w = robust * (weight / max(sigma**2, lattice.spacing**2))[:, None]  # so many independent readings an area
        blocks, right = self._normal(w, residual, gradient)
        A = self._data_matrix(blocks) + self.regular
        b = -(right + self.regular @ d.ravel())
        delta = self.factor.factorize(A).solve(b[:, None])[:, 0].reshape(-1, 2)
        longest = np.linalg.norm(delta, axis=1, keepdims=True)
        return d + delta * np.minimum(1, s.stride / np.maximum(longest, 1e-12))

    def _normal(self, w, residual, gradient):
        """Per face and pair of corners the 2x2 blocks (m,3,3,2,2) of J'WJ, and J'Wr (2g,)."""
        lattice, surface, m = self.surface.lattice, self.surface, len(self.surface.faces)
        face, bary = lattice.face, lattice.bary
        G = np.empty((len(face), 3, 3))
        for a in range(3):
            for b in range(a, 3):
                G[:, a, b] = G[:, b, a] = np.einsum("nc,nc,nc->n", w, gradient[a], gradient[b])
        h = np.stack([np.einsum("nc,nc,nc->n", w, gradient[a], residual) for a in range(3)], 1)
        outer = np.einsum("ni,nj,nab->nijab", bary, bary, G).reshape(len(face), -1)
        sums = self.to_faces @ np.c_[outer, np.einsum("ni,na->nia", bary, h).reshape(len(face), -1)]
        T = surface.frames[surface.faces]  # (m,3,2,3)
        blocks = np.einsum("mipa,mijab,mjqb->mijpq", T, sums[:, :81].reshape(m, 3, 3, 3, 3), T, optimize=True)
        right = np.einsum("mipa,mia->mip", T, sums[:, 81:].reshape(m, 3, 3))
        b = np.zeros((len(surface.rest), 2))
        np.add.at(b, surface.faces, right)
        return blocks, b.ravel()

    def _pattern(self):
        """Where the blocks of the faces go in the matrix, and what of the matrix never changes."""
        s, surface = self.settings, self.surface
        F, g = surface.faces.astype(np.int64), len(surface.rest)
        lattice = surface.lattice
        self.to_faces = sparse.csr_matrix(
            (np.ones(len(lattice)), (lattice.face, np.arange(len(lattice)))), shape=(len(F), len(lattice))
        )
        shape = (len(F), 3, 3, 2, 2)
        two = np.arange(2)
        self._rows = np.broadcast_to(2 * F[:, :, None, None, None] + two[:, None], shape).ravel()
        self._columns = np.broadcast_to(2 * F[:, None, :, None, None] + two, shape).ravel()
        hold = np.zeros((g, 2))
        hold[surface.on_loop, 1] = 1e4  # across a loop nothing slides
        still = surface.mass / s.reach**2 / s.slip**2  # a slide without evidence returns
        self.regular = (self.K / (s.strain * s.reach) ** 2 + sparse.diags((hold + 0).ravel() / s.reach**2 + np.repeat(still, 2))).tocsc()

    def _data_matrix(self, blocks):
        n = 2 * len(self.surface.rest)
        return sparse.coo_matrix((blocks.ravel(), (self._rows, self._columns)), shape=(n, n)).tocsc()
