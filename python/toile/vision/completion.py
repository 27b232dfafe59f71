"""Label images of the cameras that have none: what the places on the surface carry elsewhere, and the colours, say."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from .threads import parallel_map


def complete_labels(frame: Any, views: Any, shares: Any, faces: Any, colours: Any, ids: Any, settings: Any) -> Any:
    """{camera: (H,W) uint8} for those of `views` {camera: DepthView} of which the frame has a picture and no label image.

    `shares` (n,L): how probable each label of `ids` is on the vertices of the surface that the views show, `faces` (m,3) its
    triangles; `colours` a ColourModel. A pixel off the surface, or off the camera's mask, is background. One whose best
    label is less probable than `settings.sure_share` is on the person and of no label: colours and places still count there.
    """
    nothing = next(i for i in range(255, 0, -1) if i not in ids)
    log_place = np.log(np.maximum(shares, 1e-9))[faces].mean(1)
    missing = [name for name in views if name in frame.images and name not in frame.labels]

    def one(name: str) -> Any:
        shown = views[name].face >= 0
        if name in frame.masks:
            shown &= frame.masks[name]
        log = log_place[views[name].face[shown]] + settings.colour_weight * colours.evidence(frame.images[name][shown])
        share = np.zeros((*shown.shape, len(ids)), np.float32)
        share[shown] = _softmax(log)
        share = cv2.blur(share, (3, 3)).reshape(share.shape)
        weight = np.maximum(cv2.blur(shown.astype(np.float32), (3, 3)), 1e-6)
        best, sure = ids[share.argmax(2)], share.max(2) > settings.sure_share * weight
        return np.where(shown, np.where(sure, best, nothing), 0).astype(np.uint8)

    return dict(zip(missing, parallel_map(one, missing)))


def _softmax(log: Any) -> Any:
    odds = np.exp(log - log.max(1, keepdims=True))
    return odds / odds.sum(1, keepdims=True)
