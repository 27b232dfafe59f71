"""Batches of pictures of people, as the network wants them."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from ...errors import UserError
from .looks import Looks
from .views import SIZE

BATCH = 8
PHOTOGRAPH = 800  # px, of the longer side of what is kept of one
MEAN, STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


class Drawn(IterableDataset):
    """Batches without end, drawn by processes of their own: pictures (B,3,S,S) normalised and classes (B,S,S)."""

    def __init__(self, views, seed, size, photographs=()):
        self.views, self.seed, self.size, self.photographs = views, seed, size, photographs

    def __iter__(self):
        rng = np.random.default_rng([*self.seed, get_worker_info().id])
        looks = Looks(SIZE, rng, self.photographs)
        while True:
            looks.size = self.size()
            yield batch(self.views, looks, rng)


def drawn(views, seed, size, photographs=()):
    """Batches without end by two processes. `seed`: a list; `size()` says how large the pictures are that are drawn next."""
    return DataLoader(Drawn(views, seed, size, photographs), batch_size=None, num_workers=2, prefetch_factor=4)


def drawn_here(views, seed, size):
    """The same by this process, all pictures of one size."""
    rng = np.random.default_rng(seed)
    looks = Looks(SIZE, rng)
    looks.size = size
    while True:
        yield batch(views, looks, rng)


def read_photographs(folder):
    """The pictures (h,w,3) uint8 RGB in a folder, none larger than PHOTOGRAPH. UserError: there is none."""
    found = []
    for path in sorted(folder.iterdir()):
        picture = cv2.imread(str(path))
        if picture is not None:
            scale = min(1.0, PHOTOGRAPH / max(picture.shape[:2]))
            found.append(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[..., ::-1].copy())
    if not found:
        raise UserError(f"--photographs: no pictures in {folder}")
    return found


def batch(views, looks, rng):
    """Of views, stacked fields."""
    pairs = [looks.picture([field[i] for field in views]) for i in rng.integers(len(views[0]), size=BATCH)]
    pictures = np.stack([(picture - np.float32(MEAN)) / np.float32(STD) for picture, _ in pairs])
    classes = torch.from_numpy(np.stack([label for _, label in pairs]).astype(np.int64))
    return torch.from_numpy(pictures).permute(0, 3, 1, 2), classes
