"""How good a trained network is on people that it was not shown, and how sure it may be.

python -m toile.studio.segmenter.check NETWORK.onnx VIEWS.npz [--pictures 320] [--seed 1]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from . import CLASSES
from .batches import BATCH, drawn_here
from .export import read_network
from .views import SIZE, read_views

TEMPERATURES = np.exp(np.linspace(-0.7, 1.4, 43))
SURE = np.linspace(0, 1, 11)  # borders of the bins of certainty


def main():
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("network", type=Path)
    parser.add_argument("views", type=Path)
    parser.add_argument("--pictures", type=int, default=320)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    logits, classes = answers(read_network(asked.network), read_views([asked.views]), asked.pictures, asked.seed)
    for name, value in overlaps(logits.argmax(1), classes).items():
        print(f"{name:12} {value:.3f}")
    print(f"{'calibration':12} {calibration_error(logits, classes):.3f}")


@torch.no_grad()
def answers(network, views, count, seed):
    """Logits (n,C,S,S) and classes (n,S,S) of about so many pictures of the views."""
    network.eval()
    shown = drawn_here(views, seed, SIZE)
    batches = [next(shown) for _ in range(-(-count // BATCH))]
    return torch.cat([network(p) for p, _ in batches]), torch.cat([c for _, c in batches])


def overlaps(found, classes):
    """Intersection over union by class, over all pictures, and of the person's outline: the median of the pictures that show
    one."""
    out = {}
    for k, name in enumerate(CLASSES):
        a, b = found == k, classes == k
        out[name] = float((a & b).sum() / max(int((a | b).sum()), 1))
    both, either = (((found > 0) & (classes > 0)).sum((1, 2)), ((found > 0) | (classes > 0)).sum((1, 2)))
    shown = (classes > 0).float().mean((1, 2)) > 0.01
    return out | {"outline": float((both / either.clamp(min=1))[shown].median())}


def temperature(logits, classes):
    """What logits are to be divided by so that they are as sure as they are right (Guo et al. 2017)."""
    pixels = logits.permute(0, 2, 3, 1).reshape(-1, len(CLASSES))[:: 1 + logits.numel() // 20_000_000]
    truth = classes.reshape(-1)[:: 1 + logits.numel() // 20_000_000]
    losses = [float(F.cross_entropy(pixels / float(t), truth)) for t in TEMPERATURES]
    return float(TEMPERATURES[int(np.argmin(losses))])


def calibration_error(logits, classes):
    """Mean difference between how sure the most probable class is and how often it is right, over pixels that it takes for a person's."""
    sure, best = logits.softmax(1).max(1)
    on = best > 0
    sure, right = sure[on].numpy(), (best == classes)[on].numpy()
    bins = np.digitize(sure, SURE[1:-1])
    return sum(abs(float((sure - right)[bins == k].mean())) * float((bins == k).mean()) for k in np.unique(bins))


if __name__ == "__main__":
    main()
