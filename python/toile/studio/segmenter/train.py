"""Trains the network that labels pictures of people, on renders alone, and writes it as an ONNX file.

    python -m toile.studio.segmenter.train OUT.onnx [--captures CAPTURE ...] [--views 2400] [--minutes 35] [--seed 7]

CAPTURES are studio captures whose people are shown too: their cloth was simulated (`toile studio`, any subject and seed). Views
are kept in OUT.views.npz, the weights so far in OUT.pt.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from ..body import PHENOTYPES
from . import CLASSES
from .looks import Looks
from .network import Clothes
from .people import people
from .views import PersonView, view

SIZE = 256  # px
A_PERSON = 3  # views of each person as it stands
WARDROBES = 2  # of each subject
PHASES = ((0.6, 128), (0.8, 192), (1.0, SIZE))  # up to which share of the time the pictures are how large [px]
BATCH, RATE, DECAY = 16, 4e-3, 1e-3
KEPT = 0.99  # of the averaged weights a step
SETTLING = 20  # batches from which the averaged network's normalisation is taken
MEAN, STD = (123.675, 116.28, 103.53), (58.395, 57.12, 57.375)


def main():
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--captures", type=Path, nargs="*", default=[])
    parser.add_argument("--views", type=int, default=2400)
    parser.add_argument("--minutes", type=float, default=35.0)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    torch.set_num_threads(2)
    kept = asked.out.with_suffix(".views.npz")
    if not kept.exists():
        np.savez(kept, *many_views(asked.views, asked.captures, asked.seed))
    with np.load(kept) as found:
        views = [found[name] for name in found.files]
    export(train(views, 60 * asked.minutes, asked.seed, asked.out.with_suffix(".pt")), asked.out)


def many_views(count, captures, seed):
    """The fields of `count` PersonViews or a few more, stacked."""
    rng = np.random.default_rng(seed)
    views = []
    for person in people(WARDROBES * tuple(PHENOTYPES), captures, rng):
        views += [view(person, SIZE, rng) for _ in range(A_PERSON)]
        if len(views) >= count:
            return [np.stack([getattr(v, name) for v in views]) for name in PersonView.__dataclass_fields__]


def train(views, seconds, seed, kept):
    """A Clothes trained for so many seconds on views (stacked fields): the running mean of its weights, `kept` on the way."""
    torch.manual_seed(seed)
    rng = np.random.default_rng([seed, 1])
    looks, network = Looks(SIZE, rng), Clothes().to(memory_format=torch.channels_last)
    mean = torch.optim.swa_utils.AveragedModel(network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(KEPT))
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    looks.size, ahead = PHASES[0][1], ThreadPoolExecutor(1)
    coming = ahead.submit(batch, views, looks, rng)
    start, step, told = time.monotonic(), 0, 0.0
    while (spent := (time.monotonic() - start) / seconds) < 1:
        warm, cool = min(1.0, (step + 1) / 100), 0.5 * (1 + np.cos(np.pi * spent))
        for group in optimizer.param_groups:
            group["lr"] = RATE * warm * (0.01 + 0.99 * cool)
        looks.size = next(size for until, size in PHASES if spent < until)
        pictures, classes = coming.result()
        coming = ahead.submit(batch, views, looks, rng)
        with torch.autocast("cpu", torch.bfloat16):
            logits = network(pictures)
        value = loss(logits.float(), classes)
        optimizer.zero_grad()
        value.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
        mean.update_parameters(network)
        told = 0.98 * told + 0.02 * value.item() if step else value.item()
        step += 1
        if step % 50 == 0:
            print(f"{step} steps, {100 * spent:.0f} %, loss {told:.3f}", flush=True)
            torch.save(mean.module.state_dict(), kept)
    torch.optim.swa_utils.update_bn((batch(views, looks, rng)[0] for _ in range(SETTLING)), mean.module)
    return mean.module.eval()


def batch(views, looks, rng):
    """Pictures (B,3,S,S) normalised and classes (B,S,S)."""
    pairs = [looks.picture([field[i] for field in views]) for i in rng.integers(len(views[0]), size=BATCH)]
    pictures = np.stack([(picture - np.array(MEAN)) / STD for picture, _ in pairs]).astype(np.float32)
    classes = torch.from_numpy(np.stack([label for _, label in pairs]).astype(np.int64))
    return torch.from_numpy(pictures).permute(0, 3, 1, 2), classes


def loss(logits, classes):
    """Cross entropy, and one minus the classes' soft Dice over the batch (Milletari et al. 2016)."""
    entropy = F.cross_entropy(logits, classes)
    p, y = logits.softmax(1), F.one_hot(classes, len(CLASSES)).permute(0, 3, 1, 2).float()
    both, each = (p * y).sum((0, 2, 3)), (p + y).sum((0, 2, 3))
    return entropy + 0.5 * (1 - (2 * both + 100) / (each + 100)).mean()


def export(network, path):
    """Writes the network as ONNX: `image` (N,3,S,S) normalised, `logits` (N,C,S,S)."""
    network = network.to(memory_format=torch.contiguous_format)
    batch_axis = {"image": {0: "n"}, "logits": {0: "n"}}
    torch.onnx.export(
        network,
        torch.zeros(1, 3, SIZE, SIZE),
        path,
        input_names=["image"],
        output_names=["logits"],
        dynamic_axes=batch_axis,
        dynamo=False,
        opset_version=17,
    )


if __name__ == "__main__":
    main()
