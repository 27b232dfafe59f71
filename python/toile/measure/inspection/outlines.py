"""Pictures against masks: whether a camera's picture shows the outline of its own mask, of that turned or mirrored, or of another
camera's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

import numpy as np

from ...frame_numbers import evenly
from ...kernels.arrays import Anything, Array, Floats
from ...scene import Frame
from ...vision.thin_pictures import thin_pictures
from .cameras import Finding

SIDE = 512  # px, longer side, to which pictures are thinned for this
SOFT = 1.0  # px, by which they are blurred
POINTS, FEWEST = 120, 20  # of an outline that are looked at, and how long it must be [px]
ACROSS = 2.0  # px to either side of the outline, where colours are compared
BESIDE, LEAST = 0.06, 8.0  # of an outline's diagonal, and px: how far it is moved, eight ways
FITS = 1.5  # times the contrast beside: an outline that lies on edges of the picture
AS_OTHERS = 0.65  # of the fit that is usual: an outline that fits as well as masks do in these pictures
BETTER = 1.5  # times the fit of any other outline
PAIRS = 2000  # of pictures and masks that are compared: of many cameras fewer frames are

TURNS: dict[str, Callable[[Array], Array]] = {  # of a mask, against its picture
    "turned by half a turn": lambda mask: mask[::-1, ::-1],
    "turned to the left": np.rot90,
    "turned to the right": lambda mask: np.rot90(mask, -1),
    "mirrored, left for right": lambda mask: mask[:, ::-1],
    "mirrored, top for bottom": lambda mask: mask[::-1],
}


def exchanged(frames: Sequence[Frame]) -> list[Finding]:
    """Cameras whose pictures show, in most frames, the outline of another camera's mask (or label image) and not their own, or that of
    their own turned or mirrored."""
    told: dict[tuple[str, str], list[float]] = {}
    cameras = max((len(frame.images) for frame in frames), default=1)
    for frame in evenly(frames, max(1, PAIRS // max(1, cameras**2))):
        for pair, fit in _fits(thin_pictures(frame, SIDE)).items():
            told.setdefault(pair, []).append(fit)
    fits: dict[str, dict[str, float]] = {}
    for (name, other), values in told.items():
        fits.setdefault(name, {})[other] = median(values)
    usual = median(max(of.values()) for of in fits.values()) if fits else 0.0
    found = []
    for name, of in fits.items() if usual > FITS else ():
        kind = "masks" if any(name in frame.masks for frame in frames) else "label images"
        first, *others = sorted((other for other in of if other not in TURNS), key=lambda other: -of[other])
        turn = max((turn for turn in TURNS if turn in of), key=lambda turn: of[turn], default=first)
        clear = max(FITS, AS_OTHERS * usual)
        if name in others and of[first] > max(clear, BETTER * of[others[0]]):
            text = f"{name}: its pictures show the outlines of {first}'s {kind}, not of its own"
            found.append(Finding(f"{text}: were they exchanged?"))
        elif name in of and of[turn] > max(clear, BETTER * of[first]):
            text = f"{name}: its pictures show the outlines of its {kind} {turn}"
            found.append(Finding(f"{text}: turn the pictures, or the {kind}, as the calibration means them"))
    return found


def _fits(frame: Frame) -> dict[tuple[str, str], float]:
    """{(camera of a picture, camera of a mask of the same size or one of TURNS of its own): how many times the contrast across the
    mask's outline is that across the outline moved aside}."""
    shown = frame.silhouettes
    found = {}
    for size in {image.shape[:2] for image in frame.images.values()}:
        lines = {name: outline(mask) for name, mask in shown.items() if mask.shape == size}
        lines = {name: line for name, line in lines.items() if line is not None}
        for name, image in frame.images.items() if lines else ():
            if image.shape[:2] == size:
                asked = lines | (_turned(shown[name], size) if name in lines else {})
                fit = clearness(image, [*asked.values()])
                found |= {(name, other): float(value) for other, value in zip(asked, fit)}
    return found


def clearness(image: Anything, lines: Sequence[tuple[Floats, Floats]]) -> Floats:
    """How many times the contrast of a picture (H,W,3) across each of some outlines is that across it moved aside (M,)."""
    import cv2

    soft = cv2.GaussianBlur(image, (0, 0), SOFT).astype(np.float32)
    contrast = _contrasts(soft, *(np.stack(part) for part in zip(*lines)))
    return contrast[:, 0] / np.maximum(contrast[:, 1:].mean(1), 1e-6)


def _turned(mask: Array, size: tuple[int, ...]) -> dict[str, tuple[Floats, Floats]]:
    """{one of TURNS: the outline of a mask that was turned so}, of those that still have the picture's size (H,W)."""
    turned = {how: np.ascontiguousarray(turn(mask)) for how, turn in TURNS.items()}
    lines = {how: outline(of) for how, of in turned.items() if of.shape == size}
    return {how: line for how, line in lines.items() if line is not None}


def outline(mask: Array) -> tuple[Floats, Floats] | None:
    """Places (9,POINTS,2) [px] of points on a mask's outline and moved aside, and the outline's normals (POINTS,2); None where
    it is too short away from the picture's border."""
    import cv2

    lines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    at = np.concatenate([line[:, 0] for line in lines]) if lines else np.zeros((0, 2), int)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), ACROSS)
    slopes = [cv2.Sobel(soft, cv2.CV_32F, *way) for way in ((1, 0), (0, 1))]
    slope = np.stack([along[at[:, 1], at[:, 0]] for along in slopes], axis=1)
    steep = np.linalg.norm(slope, axis=1)
    inner = (at > ACROSS).all(1) & (at < np.array(mask.shape[::-1]) - 1 - ACROSS).all(1) & (steep > 1e-6)
    if inner.sum() < FEWEST:
        return None
    pick = np.flatnonzero(inner)[np.linspace(0, inner.sum() - 1, POINTS).astype(int)]
    turn = np.arange(8) * np.pi / 4
    reach = max(LEAST, BESIDE * float(np.linalg.norm(np.ptp(at, axis=0))))
    moved = np.vstack([np.zeros((1, 2)), reach * np.c_[np.cos(turn), np.sin(turn)]])
    return at[pick] + moved[:, None], slope[pick] / steep[pick, None]


def _contrasts(image: Anything, places: Floats, normals: Floats) -> Floats:
    """Mean differences of colour (M,9) of a picture across outlines (M,9,n,2) with normals (M,n,2), where within it."""
    across = ACROSS * normals[:, None]
    ends = [np.rint(places + side * across).astype(int) for side in (1, -1)]
    within = np.logical_and(*((end >= 0).all(-1) & (end < image.shape[1::-1]).all(-1) for end in ends))
    one, other = (image[np.where(within, end[..., 1], 0), np.where(within, end[..., 0], 0)] for end in ends)
    return np.where(within, np.linalg.norm(one - other, axis=-1), 0.0).sum(-1) / np.maximum(within.sum(-1), 1)
