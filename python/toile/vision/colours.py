"""Colour models: one histogram a label, in lightness and two chroma ratios, fitted although some labels are wrong."""

from dataclasses import dataclass

import numpy as np

_BINS = (20, 40, 40)  # lightness, red against green, yellow against blue
_BLUR = (1.2, 0.8, 0.8)  # bins
_FLOOR = 0.02  # share of colours that follow no model


@dataclass(frozen=True)
class ColourModel:
    """`log_density` (bins, L) float32: log P(colour bin | label) + log(bins), so that 0 says nothing."""

    ids: np.ndarray
    log_density: np.ndarray

    def evidence(self, rgb):
        """(..., 3) uint8 -> (..., L) log likelihoods, up to what is common to all labels."""
        return self.log_density[colour_bins(rgb)]


def colour_bins(rgb):
    """Bin (...) of (..., 3) uint8 colours; chroma is divided by lightness, so that shading moves it little."""
    c = rgb.astype(np.float32)
    r, g, b = c[..., 0], c[..., 1], c[..., 2]
    light = (r + g + b) / 3
    u = (r - g) / (light + 12)
    v = (0.5 * (r + g) - b) / (light + 12)
    cells = (light / 256, np.clip(u / 1.6 + 0.5, 0, 0.9999), np.clip(v / 2.4 + 0.5, 0, 0.9999))
    i, j, k = ((value * n).astype(np.int32) for value, n in zip(cells, _BINS))
    return (i * _BINS[1] + j) * _BINS[2] + k


def fit_colours(rgb, given, prior, ids, error_share, iterations):
    """Expectation maximisation for pixels whose given labels are sometimes wrong.

    rgb (p,3) uint8; given (p,) column of the pixel's label; prior (p,L) what the place on the surface says;
    `error_share` the share of given labels that are. The histograms are the maximum likelihood of
    prod_p sum_l prior[p,l] P(given | l) P(colour | l).
    """
    L = len(ids)
    place = prior * np.where(np.arange(L) == given[:, None], 1 - error_share, error_share / max(L - 1, 1))
    place /= np.maximum(place.sum(1, keepdims=True), 1e-12)
    bins = colour_bins(rgb)
    share = place
    for _ in range(iterations):
        model = ColourModel(ids, _log_histograms(bins, share))
        share = place * np.exp(model.log_density[bins])
        share /= np.maximum(share.sum(1, keepdims=True), 1e-12)
    return ColourModel(ids, _log_histograms(bins, share))


def _log_histograms(bins, share):
    from scipy.ndimage import gaussian_filter

    count = int(np.prod(_BINS))
    out = np.empty((count, share.shape[1]), np.float32)
    for column in range(share.shape[1]):
        h = np.bincount(bins, weights=share[:, column], minlength=count).reshape(_BINS)
        h = gaussian_filter(h, _BLUR, mode="nearest").ravel()
        out[:, column] = np.log((1 - _FLOOR) * h / max(h.sum(), 1e-12) * count + _FLOOR)
    return out
