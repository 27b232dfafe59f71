"""A network of labels in an ONNX file: label images and how sure they are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...errors import UserError
from ..networks import open_network, run_network
from .description import Parts, describe
from .limbs import SeenLimbs

FOUND = 0.002  # share of the picture, at least, that is taken for a person


class Segmenter:
    """`Segmenter(path, labels)` for a scene's labels {name: id}. UserError: no ONNX file, or one whose description does not go with it or with the labels."""

    def __init__(self, path: Path, labels: Mapping[str, int]):
        self.path, self.session = path, open_network(path)
        self.about: Parts = describe(path, self.session.get_inputs(), self.session.get_outputs(), labels)
        self.ids = np.array(sorted({*labels.values()}))  # (L,)

    def label(self, picture: Any, mask: Any = None, limbs: SeenLimbs | None = None) -> tuple[Any, Any]:
        """The labels (H,W) uint8 of a picture (H,W,3) uint8 RGB and how sure they are (H,W) uint8 [1/255]. Off a mask (H,W)
        bool is background, surely; on it is none. Of a network that looks for one person, what is apart from the largest
        connected part is background, as sure as the network is of that; without a mask, what it sees in the whole picture
        and in the person's box is averaged, and limbs tell where the person is. Where the network sees a part of the person
        that has no label, the most probable label stands, and is not sure at all."""
        whole = np.array([0.0, 0, picture.shape[1], picture.shape[0]])
        box = _box(mask) if mask is not None else None
        if self.about.person and box is not None:
            return self._decided(self.shares(picture, self._padded(box), mask), mask)
        shares = self.shares(picture, whole, mask)
        if self.about.person and mask is None:
            told = limbs.background(picture.shape[:2]) if limbs is not None else None
            found = _largest(_told(shares, told)[..., 0] < 0.5)
            if found.sum() >= FOUND * found.size:
                shares = (shares + self.shares(picture, self._padded(_box(found)))) / 2
            shares = _told(shares, told)
        return self._decided(shares, mask)

    def _padded(self, box: Any) -> Any:
        middle, half = (box[:2] + box[2:]) / 2, self.about.padding * (box[2:] - box[:2]) / 2
        return np.concatenate([middle - half, middle + half])

    def _decided(self, shares: Any, mask: Any) -> tuple[Any, Any]:
        ids = np.concatenate([[0], self.ids]).astype(np.uint8)
        if mask is not None:
            shares[..., 0] = np.where(mask, 0, 1)
            shares[~mask, 1:] = 0
            shares /= np.maximum(shares.sum(-1, keepdims=True), 1e-6)
        best = np.where(shares[..., 0] > 0.5, 0, 1 + shares[..., 1:-1].argmax(-1))
        if self.about.person and mask is None:
            best[~_largest(shares[..., 0] < 0.5)] = 0
        sure = np.take_along_axis(shares, best[..., None], -1)[..., 0]
        return ids[best], np.rint(255 * np.clip(sure, 0, 1)).astype(np.uint8)

    def shares(self, picture: Any, box: Any, mask: Any = None) -> Any:
        """Probabilities (H,W,L+2) float32 of the background, of each label, and of the person without a label, seen in a box
        (4,) [px: left, top, right, bottom]; all background outside of it. Of a network that wants that, what is off a mask
        (H,W) bool is shown as the mean."""
        (height, width), about = self.about.size, self.about
        extent = np.maximum(box[2:] - box[:2], 1.0)
        scale = extent / [width, height]
        if about.fit == "letterbox":
            scale = np.full(2, scale.max())
        corner = (box[:2] + box[2:]) / 2 - scale * [width, height] / 2
        M = np.column_stack([np.diag(scale), corner + scale / 2 - 0.5])  # OpenCV counts from pixels' centres
        flags, edge = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
        crop = cv2.warpAffine(_smoothed(picture, scale), M, (width, height), flags=flags, borderMode=edge)
        crop = crop if about.channels == "rgb" else crop[..., ::-1]
        crop = ((crop - np.array(about.mean)) / about.std).transpose(2, 0, 1)
        if about.blank and mask is not None:
            crop[:, cv2.warpAffine(mask.astype(np.float32), M, (width, height), flags=flags) < 0.5] = 0
        values = self._classes(crop)
        if about.mirror:
            values = (values + self._classes(crop[:, :, ::-1])[:, ::-1]) / 2
        grouped = self._grouped(values)
        h, w = grouped.shape[:2]
        back = scale * [width / w, height / h]  # pixels of the picture a pixel of the output
        M = np.column_stack([np.diag(back), corner + back / 2 - 0.5])
        size = picture.shape[1], picture.shape[0]
        planes = [cv2.warpAffine(plane.copy(), M, size, borderMode=edge) for plane in np.moveaxis(grouped, -1, 0)]
        shares = np.stack(planes, -1)
        end = corner + scale * [width, height]
        for axis, side in enumerate(size):
            outside = (np.arange(side) + 0.5 < corner[axis]) | (np.arange(side) + 0.5 > end[axis])
            shares[(slice(None), outside) if axis == 0 else outside] = np.eye(shares.shape[-1])[0]
        return shares

    def _classes(self, crop: Any) -> Any:
        """Probabilities (h,w,C) of the classes at the output's own size."""
        output = run_network(self.path, self.session, crop)[self.about.output]
        C = len(self.about.ids)
        if self.about.kind == "labels":
            label = output.reshape(output.shape[-2:])
            if not (0 <= label.min() and label.max() < C):
                raise UserError(f"{self.path}: gives class {label.max()}, {C} are named")
            return np.eye(C, dtype=np.float32)[label.astype(np.int64)]
        values = output[0].astype(np.float32).transpose(1, 2, 0)
        if values.shape[2] != C:
            raise UserError(f"{self.path}: gives {values.shape[2]} classes, {C} are named")
        if not np.isfinite(values).all():
            raise UserError(f"{self.path}: gives numbers that are not finite")
        if self.about.kind == "probabilities":
            return values / np.maximum(values.sum(2, keepdims=True), 1e-9)
        odds = np.exp(values - values.max(2, keepdims=True))
        return odds / odds.sum(2, keepdims=True)

    def _grouped(self, values: Any) -> Any:
        """Sums (h,w,L+2) over the classes of the background, each label, and the person without one."""
        out = np.zeros((*values.shape[:2], len(self.ids) + 2), np.float32)
        for k, id in enumerate(self.about.ids):
            column = 0 if id == 0 else -1 if id < 0 else 1 + int(np.searchsorted(self.ids, id))
            out[..., column] += values[..., k]
        return out


def _told(shares: Any, background: Any) -> Any:
    """Shares (H,W,L+2) whose background has these log-odds (H,W) more; themselves where None are told."""
    if background is None:
        return shares
    weighed = np.concatenate([shares[..., :1] * np.exp(background)[..., None], shares[..., 1:]], -1)
    return weighed / np.maximum(weighed.sum(-1, keepdims=True), 1e-9)


def _smoothed(picture: Any, scale: Any) -> Any:
    """The picture without what is finer than the network's pixels."""
    sigma = 0.4 * np.maximum(scale - 1, 0)
    if sigma.max() < 0.3:
        return picture
    return cv2.GaussianBlur(picture, (0, 0), max(sigma[0], 0.01), sigmaY=max(sigma[1], 0.01))


def _box(mask: Any) -> Any:
    """left, top, right, bottom (4,) of what is set; None where nothing is."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    return np.array([columns[0], rows[0], columns[-1] + 1.0, rows[-1] + 1.0])


def _largest(mask: Any) -> Any:
    """The largest connected part (H,W) bool of a mask (H,W) bool; the mask itself where nothing is set."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    sizes = stats[1:, cv2.CC_STAT_AREA]
    return parts == 1 + sizes.argmax() if len(sizes) else mask
