"""What people see that a squared error does not: structure at several scales, edges, and whether a print can be read.

A sharp print a centimetre off its place costs a squared error as much as no print at all. Pictures are (H,W,3), values 0..1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .metrics import similarity_maps

WEIGHTS = np.array([0.0448, 0.2856, 0.3001, 0.2363, 0.1333])  # of the scales, table 1 of Wang et al. 2003
LUMA = (0.299, 0.587, 0.114)  # of red, green, blue (BT.601)
FLAT = 170 / 255**2  # below such a squared gradient edges are alike (Xue et al. 2014)
REACH = 10.0  # by which a print may lie off and be read [mm]
LETTER = 50.0  # width of the window in which it is read [mm]
PLAIN = 10 / 255  # standard deviation in a window below which there is no print to read
NOISE = 2 / 255  # standard deviation that is no print either


@dataclass
class SeenSums:
    """Similarities added over pixels: of each scale, of edges, of print. None where there are no pixels."""

    sums: np.ndarray = field(default_factory=lambda: np.zeros(len(WEIGHTS) + 2))
    pixels: np.ndarray = field(default_factory=lambda: np.zeros(len(WEIGHTS) + 2, np.int64))

    def add(self, other):
        self.sums += other.sums
        self.pixels += other.pixels
        return self

    @property
    def measures(self):
        there = self.pixels > 0
        mean = np.divide(self.sums, self.pixels, out=np.zeros(len(there)), where=there)
        scales = float(np.prod(np.maximum(mean[:-2], 0) ** WEIGHTS)) if there[:-2].all() else None
        edges, print_ = (float(m) if known else None for m, known in zip(mean[-2:], there[-2:]))
        return {"ms_ssim": scales, "gradient_similarity": edges, "legibility": print_}


def seen(image, reference, mask, cloth, mm_per_pixel):
    """`SeenSums` of a picture against the captured one: scales and edges over `mask` (H,W), print over `cloth` (H,W)."""
    maps = [*_scales(image, reference, mask), _edges(image, reference, mask)]
    maps.append(legibility(image, reference, cloth, mm_per_pixel))
    return SeenSums(np.array([m.sum() for m in maps]), np.array([len(m) for m in maps]))


def _scales(a, b, mask):
    """Per scale the values (k,) over the foreground: contrast and structure, at the coarsest luminance too (Wang et al. 2003,
    equation 7; means are taken over all pictures before their product)."""
    share = mask.astype(np.float64)
    for scale in range(len(WEIGHTS)):
        luminance, structure = similarity_maps(a, b)
        last = scale == len(WEIGHTS) - 1
        yield (luminance * structure if last else structure).mean(-1)[share >= 0.5]
        a, b, share = _halved(a), _halved(b), _halved(share)


def _edges(a, b, mask):
    """(k,) similarity of gradient magnitudes at half the size (Xue et al. 2014, equation 4)."""
    ga, gb = (_gradient(_halved(x @ LUMA)) for x in (a, b))
    return ((2 * ga * gb + FLAT) / (ga**2 + gb**2 + FLAT))[_halved(mask.astype(np.float64)) >= 0.5]


def _gradient(y):
    """Magnitude (H,W) by Prewitt's filters."""
    import cv2

    smooth, slope = np.full(3, 1 / 3), np.array([1.0, 0.0, -1.0])
    return np.hypot(*(cv2.sepFilter2D(y, cv2.CV_64F, *pair) for pair in ((slope, smooth), (smooth, slope))))


def _halved(x):
    """Means of 2x2 pixels; an odd last row or column is left out."""
    h, w = (2 * (n // 2) for n in x.shape[:2])
    return (x[:h:2, :w:2] + x[1:h:2, :w:2] + x[:h:2, 1:w:2] + x[1:h:2, 1:w:2]) / 4


def legibility(image, reference, cloth, mm_per_pixel):
    """(k,) of the pixels of `cloth` with a print about them: its correlation, in a window of LETTER about the pixel, after the
    best shift of at most REACH."""
    import cv2

    size, reach = 2 * round(LETTER / 2 / mm_per_pixel) + 1, int(REACH / mm_per_pixel)
    weight = cloth.astype(np.float64)
    box = lambda v: cv2.boxFilter(v, cv2.CV_64F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
    n = np.maximum(box(weight), 1)
    local = lambda v: box(weight * v) / n
    x, y = (np.ascontiguousarray(p @ LUMA) for p in (image, reference))
    my = local(y)
    vy = local(y * y) - my**2
    best = np.full(y.shape, -1.0)
    padded = np.pad(x, reach, mode="edge")
    for dv, du in np.ndindex(2 * reach + 1, 2 * reach + 1):
        if np.hypot(dv - reach, du - reach) * mm_per_pixel > REACH:
            continue
        moved = padded[dv : dv + y.shape[0], du : du + y.shape[1]]
        mx = local(moved)
        vx = local(moved * moved) - mx**2
        spread = np.sqrt((np.maximum(vx, 0) + NOISE**2) * (np.maximum(vy, 0) + NOISE**2))
        best = np.maximum(best, (local(moved * y) - mx * my) / spread)
    return best[cloth & (vy > PLAIN**2)]
