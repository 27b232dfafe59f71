"""Colour models: one histogram a label, in lightness and two chroma ratios, fitted although some labels are wrong."""

from dataclasses import dataclass

import numpy as np

_BINS = (20, 40, 40)  # lightness, red against green, yellow against blue
_BLUR = (1.2, 0.8, 0.8)  # bins
_FLOOR = 0.02  # share of colours that follow no model
_CLEAR = 0.25  # of the pixels, at least, have a colour that one label alone has: what differs there is wrong


@dataclass(frozen=True)
class ColourModel:
    """`log_density` (bins, L) float32: log P(colour bin | label) + log(bins), so that 0 says nothing."""

    ids: np.ndarray
    log_density: np.ndarray

    def evidence(self, rgb):
        """(..., 3) uint8 -> (..., L) log likelihoods, up to what is common to all labels."""
        return self.log_density[colour_bins(rgb)]


def lightness_and_chroma(rgb):
    """Of (..., 3) uint8 colours their lightness (...) and two ratios (..., 2), red against green and yellow against blue: chroma
    divided by lightness, so that shading moves it little."""
    c = rgb.astype(np.float32)
    r, g, b = c[..., 0], c[..., 1], c[..., 2]
    light = (r + g + b) / 3
    return light, np.stack([(r - g) / (light + 12), (0.5 * (r + g) - b) / (light + 12)], axis=-1)


def colour_bins(rgb):
    """Bin (...) of (..., 3) uint8 colours."""
    light, chroma = lightness_and_chroma(rgb)
    u, v = chroma[..., 0], chroma[..., 1]
    cells = (light / 256, np.clip(u / 1.6 + 0.5, 0, 0.9999), np.clip(v / 2.4 + 0.5, 0, 0.9999))
    i, j, k = ((value * n).astype(np.int32) for value, n in zip(cells, _BINS))
    return (i * _BINS[1] + j) * _BINS[2] + k


def fit_colours(rgb, given, ids, error_share, iterations):
    """Expectation maximisation for pixels whose given labels are sometimes wrong, whole patches of them and in all views.

    rgb (p,3) uint8; given (p,) column of the pixel's label; `error_share` the share of given labels that are wrong, at least. The
    histograms and the labels' own shares are the maximum likelihood of
    prod_p sum_l share[l] P(given[p] | l) P(colour[p] | l), P(given | l) being 1 - e for l itself and even over the others.
    What the place on the surface says is left out: where a patch is wrong for good, it repeats the error. A label that few
    pixels truly have is given to more of them by error: so the start counts of each colour only what errors do not explain.
    """
    cell, pixels = np.unique(colour_bins(rgb) * len(ids) + given, return_counts=True)  # pixels that are alike are one
    bins, own, pixels = cell // len(ids), np.eye(len(ids))[cell % len(ids)], pixels[:, None]
    of_colour = np.maximum(np.exp(_log_histograms(bins, pixels * own)) - _FLOOR, 0) * (pixels * own).sum(0)
    of_colour /= np.maximum(of_colour.sum(1, keepdims=True), 1e-12)
    here = of_colour[bins]
    wrong = max(error_share, _quantile(1 - here.max(1), pixels[:, 0], _CLEAR))
    others = (pixels * np.where(here < here.max(1, keepdims=True), here, 0)).sum(0) / pixels.sum() + 1e-6
    posterior = np.maximum(here - wrong * others / others.sum(), 1e-6)
    posterior /= posterior.sum(1, keepdims=True)
    for _ in range(iterations):
        model = ColourModel(ids, _log_histograms(bins, pixels * posterior))
        others = (pixels * own * (1 - posterior)).sum(0) + 1e-6
        chance = wrong * others / others.sum()  # of each label to be given for another
        shares = (pixels * posterior).sum(0) / pixels.sum()
        place = shares * np.where(own > 0, 1 - wrong, (own @ chance)[:, None])
        posterior = place * np.exp(model.log_density[bins])
        posterior /= np.maximum(posterior.sum(1, keepdims=True), 1e-12)
    return ColourModel(ids, _log_histograms(bins, pixels * posterior))


def counted_colours(rgb, given, ids):
    """The ColourModel of pixels rgb (p,3) uint8 whose labels, columns (p,) of `ids`, are right."""
    return ColourModel(ids, _log_histograms(colour_bins(rgb), np.eye(len(ids))[given]))


def _quantile(values, counts, share):
    """What this share of the values, each counted so often, stays below."""
    order = np.argsort(values)
    below = np.cumsum(counts[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])


def _log_histograms(bins, weights):
    from scipy.ndimage import gaussian_filter

    count = int(np.prod(_BINS))
    out = np.empty((count, weights.shape[1]), np.float32)
    for column in range(weights.shape[1]):
        h = np.bincount(bins, weights=weights[:, column], minlength=count).reshape(_BINS)
        h = gaussian_filter(h, _BLUR, mode="nearest").ravel()
        out[:, column] = np.log((1 - _FLOOR) * h / max(h.sum(), 1e-12) * count + _FLOOR)
    return out
