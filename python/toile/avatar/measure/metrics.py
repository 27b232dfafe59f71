"""Picture errors over chosen pixels: MSE, PSNR, SSIM (Wang et al. 2004), and the pixels that each is taken over.

Pictures are (H,W,3) with values 0..1; MSE is stated on the scale 0..255. A `ErrorSums` adds pictures up, so that a mean
over many is a mean over their pixels and never over an empty picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WIDTH, SIGMA = 11, 1.5  # of the SSIM's Gaussian [px]
C1, C2 = 0.01**2, 0.03**2
BAND = 10.0  # half width of the band about a garment's border [px]
RING = 5.0  # width of the ring inside the silhouette [px]


@dataclass
class ErrorSums:
    """Squared error and SSIM added over pixels. None, never NaN, where there are no pixels."""

    squared: float = 0.0
    ssim_sum: float = 0.0
    pixels: int = 0

    def add(self, other):
        self.squared += other.squared
        self.ssim_sum += other.ssim_sum
        self.pixels += other.pixels
        return self

    @property
    def mse(self):
        """Mean over pixels and channels, values 0..255."""
        return self.squared / self.pixels if self.pixels else None

    @property
    def psnr(self):
        """10 log10(255^2 / mse) [dB]; None also where the pictures agree to the bit, since JSON has no infinity."""
        return float(10 * np.log10(255.0**2 / self.mse)) if self.pixels and self.squared > 0 else None

    @property
    def ssim(self):
        return self.ssim_sum / self.pixels if self.pixels else None


def errors_over(squared, ssim, pixels):
    """`ErrorSums` of the maps (H,W) of `squared_error` and `ssim_map` over `pixels` (H,W) bool."""
    return ErrorSums(float(squared[pixels].sum()), float(ssim[pixels].sum()), int(pixels.sum()))


def squared_error(image, reference):
    """(H,W): mean over the channels, values 0..255."""
    return ((image.astype(np.float64) - reference) ** 2).mean(-1) * 255.0**2


def ssim_map(a, b):
    """Structural similarity (H,W) of two pictures, the mean over their channels.

    Gaussian weights of 11x11 with sigma 1.5 and mirrored borders, population covariances, C1 = 0.01^2, C2 = 0.03^2 for
    a range of 1 (equation 13 of Wang et al. 2004).
    """
    luminance, structure = similarity_maps(a, b)
    return (luminance * structure).mean(-1)


def similarity_maps(a, b):
    """Luminance, and contrast with structure, each (H,W,C): the two factors of `ssim_map` in each channel."""
    a, b = (np.atleast_3d(np.asarray(x, dtype=np.float64)) for x in (a, b))
    if a.shape != b.shape:
        raise ValueError(f"ssim_map: a has shape {a.shape}, b has {b.shape}")
    ma, mb = _blur(a), _blur(b)
    va, vb, cov = _blur(a * a) - ma * ma, _blur(b * b) - mb * mb, _blur(a * b) - ma * mb
    return (2 * ma * mb + C1) / (ma**2 + mb**2 + C1), (2 * cov + C2) / (va + vb + C2)


def _blur(x):
    import cv2

    at = np.arange(WIDTH) - WIDTH // 2
    g = np.exp(-0.5 * (at / SIGMA) ** 2)
    g /= g.sum()
    return np.atleast_3d(cv2.sepFilter2D(x, cv2.CV_64F, g, g, borderType=cv2.BORDER_REFLECT)).reshape(x.shape)


def border_band(labels, garments, width=BAND):
    """Foreground pixels (H,W) bool whose centres lie within `width` px of a border between a garment and the rest.

    labels (H,W) ids, 0 background; garments: ids of the garments. A border runs between neighbouring pixels (of four)
    that are both foreground and of which one is a garment's, or each another's; the silhouette is none.
    """
    import cv2

    kind = np.where(np.isin(labels, list(garments)), labels, np.where(labels > 0, -1, 0)).astype(np.int64)
    down = (kind[1:] != kind[:-1]) & (kind[1:] != 0) & (kind[:-1] != 0)
    right = (kind[:, 1:] != kind[:, :-1]) & (kind[:, 1:] != 0) & (kind[:, :-1] != 0)
    if not (down.any() or right.any()):
        return np.zeros(kind.shape, bool)
    # borders lie between pixels: distances on a grid of twice the resolution, where pixel (r, c) is (2r, 2c)
    grid = np.ones((2 * kind.shape[0] - 1, 2 * kind.shape[1] - 1), np.uint8)
    grid[1::2, ::2][down] = 0
    grid[::2, 1::2][right] = 0
    distance = cv2.distanceTransform(grid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[::2, ::2] / 2
    return (distance <= width) & (kind != 0)


def pixel_sets(mask, labels, garments, width=BAND, face=False):
    """{name: (H,W) bool} of the pixels that errors are taken over.

    all: the foreground; band: `border_band`; garment: the garments' labels; body: the other labels outside the band;
    face: those of `face` (H,W) bool that are no garment's; silhouette: `silhouette_ring`. Without garments `band` and `garment` are empty.
    """
    mask = mask.astype(bool)
    cloth = np.isin(labels, list(garments)) & mask
    band = border_band(np.where(mask, labels, 0), garments, width)
    return {
        "all": mask, "band": band, "garment": cloth, "body": mask & (labels > 0) & ~cloth & ~band,
        "face": mask & face & ~cloth, "silhouette": silhouette_ring(mask),
    }  # fmt: skip


def silhouette_ring(mask, width=RING):
    """Foreground pixels (H,W) bool within `width` px of a background pixel; the picture's edge is no silhouette."""
    import cv2

    if mask.all():
        return np.zeros(mask.shape, bool)
    return mask & (cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= width)
