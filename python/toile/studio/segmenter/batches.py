"""Batches of pictures of people, as the network wants them."""

from __future__ import annotations

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from .looks import Looks
from .views import SIZE

BATCH = 8
MEAN, STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


class Drawn(IterableDataset):
    """Batches without end, drawn by processes of their own: pictures (B,3,S,S) normalised and classes (B,S,S)."""

    def __init__(self, views, seed, size):
        self.views, self.seed, self.size = views, seed, size

    def __iter__(self):
        rng = np.random.default_rng([*self.seed, get_worker_info().id])
        looks = Looks(SIZE, rng)
        while True:
            looks.size = self.size()
            yield batch(self.views, looks, rng)


def drawn(views, seed, size):
    """Batches without end by two processes. `seed`: a list; `size()` says how large the pictures are that are drawn next."""
    return DataLoader(Drawn(views, seed, size), batch_size=None, num_workers=2, prefetch_factor=4)


def drawn_here(views, seed, size):
    """The same by this process, all pictures of one size."""
    rng = np.random.default_rng(seed)
    looks = Looks(SIZE, rng)
    looks.size = size
    while True:
        yield batch(views, looks, rng)


def batch(views, looks, rng):
    """Of views, stacked fields."""
    pairs = [looks.picture([field[i] for field in views]) for i in rng.integers(len(views[0]), size=BATCH)]
    pictures = np.stack([(picture - np.float32(MEAN)) / np.float32(STD) for picture, _ in pairs])
    classes = torch.from_numpy(np.stack([label for _, label in pairs]).astype(np.int64))
    return torch.from_numpy(pictures).permute(0, 3, 1, 2), classes
