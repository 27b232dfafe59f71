"""Trains the network that labels pictures of people, on renders alone, and writes it as an ONNX file.

    python -m toile.studio.segmenter.train OUT.onnx --views VIEWS.npz ... [--aside VIEWS.npz] [--from NETWORK.onnx] [--minutes 60]
        [--photographs FOLDER]

VIEWS are made by `toile.studio.segmenter.views`; on those of other people, set aside, it is learnt how sure the network may be.
The learning rate falls by the clock, so that no two runs end alike. A run that was killed goes on from OUT.pt; `--from` begins with
the weights of a network that this program wrote. PHOTOGRAPHS are of what is no person.
"""

from __future__ import annotations

import argparse
import math
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from . import CLASSES
from .batches import drawn, read_photographs
from .check import answers, temperature
from .export import export, read_network
from .network import Clothes
from .views import SIZE, read_views

PHASES = ((0.78, 128), (1.0, 192))  # up to which share of the time the pictures are how large [px]
RATE, DECAY = 2.5e-3, 1e-3
KEPT = 0.995  # of the averaged weights a step
LATER = 64  # batches after which one is shown again, mirrored: to draw one takes as long as to learn from it
SAVED = 500  # steps between checkpoints
ASIDE = 160  # pictures on which the temperature is found
SETTLING = 60  # batches from which the averaged network's normalisation is taken


def main():
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--views", type=Path, nargs="+", required=True)
    parser.add_argument("--aside", type=Path)
    parser.add_argument("--from", dest="start", type=Path)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument(
        "--photographs", type=Path, help="a folder: backgrounds and prints are cut out of its pictures too"
    )
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    torch.manual_seed(asked.seed)
    training = Course(asked.out.with_suffix(".pt"), 60 * asked.minutes)
    if asked.start is not None:
        training.begin_with(read_network(asked.start).state_dict())
    photographs = read_photographs(asked.photographs) if asked.photographs else ()
    network = training.run(read_views(asked.views), asked.seed, photographs)
    if asked.aside is not None:
        soften(network, temperature(*answers(network, read_views([asked.aside]), ASIDE, asked.seed)))
    export(network, asked.out, SIZE)


class Course:
    """A Clothes on its way: `run` gives the running mean of its weights after so many seconds, those of earlier runs that
    ended early counted in. Everything is kept in the file `kept` meanwhile."""

    def __init__(self, kept, seconds):
        self.kept, self.seconds, self.spent, self.step = kept, seconds, 0.0, 0
        self.network = Clothes().to(memory_format=torch.channels_last)
        self.mean = torch.optim.swa_utils.AveragedModel(
            self.network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(KEPT)
        )
        self.optimizer = torch.optim.AdamW(self.network.parameters(), RATE, weight_decay=DECAY)
        if kept.exists():
            found = torch.load(kept, weights_only=True)
            self.spent, self.step = found["spent"], found["step"]
            for name in ("network", "mean", "optimizer"):
                getattr(self, name).load_state_dict(found[name])

    def begin_with(self, weights):
        """Unless a checkpoint was found, which goes on."""
        if self.step > 0:
            print(f"{self.kept} is there and goes on: --from is not read")
        else:
            self.network.load_state_dict(weights)
            self.mean.module.load_state_dict(weights)

    def save(self):
        found = {name: getattr(self, name).state_dict() for name in ("network", "mean", "optimizer")}
        part = self.kept.with_suffix(".part")
        torch.save(found | {"spent": self.spent, "step": self.step}, part)
        part.replace(self.kept)

    def run(self, views, seed, photographs=()):
        started, saved, earlier, losses = time.time() - self.spent, self.step, [], []
        size_at = lambda share: next((size for until, size in PHASES if share < until), SIZE)
        size = lambda: size_at((time.time() - started) / self.seconds)
        shown = iter(drawn(views, [seed, self.step], size, photographs))
        while self.spent < self.seconds:
            fresh = next(shown)
            losses.append(self.learn(*fresh))
            earlier.append(fresh)
            if len(earlier) > LATER:
                self.learn(*(tensor.flip(-1) for tensor in earlier.pop(0)))
            self.spent = time.time() - started
            if self.step >= saved + SAVED:
                share, saved = self.spent / self.seconds, self.step
                print(f"{self.step} steps, {100 * share:.1f} %, loss {np.mean(losses):.3f}", flush=True)
                losses.clear()
                self.save()
        torch.optim.swa_utils.update_bn((next(shown)[0] for _ in range(SETTLING)), self.mean.module)
        self.save()
        return self.mean.module.eval()

    def learn(self, pictures, classes):
        """One step; the loss."""
        share = min(self.spent / self.seconds, 1.0)
        warm, cool = min(1.0, (self.step + 1) / 200), 0.5 * (1 + math.cos(math.pi * share))
        for group in self.optimizer.param_groups:
            group["lr"] = RATE * warm * (0.01 + 0.99 * cool)
        value = loss(self.network(pictures.contiguous(memory_format=torch.channels_last)), classes)
        self.optimizer.zero_grad()
        value.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimizer.step()
        self.mean.update_parameters(self.network)
        self.step += 1
        return value.item()


def soften(network, heat):
    """Divides what a Clothes gives by `heat`, in place."""
    with torch.no_grad():
        for values in network.last.parameters():
            values /= heat
    print(f"temperature {heat:.2f}")


def loss(logits, classes):
    """Cross entropy, and one minus the classes' soft Dice over the batch (Milletari et al. 2016)."""
    entropy = F.cross_entropy(logits, classes)
    p, y = logits.softmax(1), F.one_hot(classes, len(CLASSES)).permute(0, 3, 1, 2).float()
    both, each = (p * y).sum((0, 2, 3)), (p + y).sum((0, 2, 3))
    return entropy + 0.5 * (1 - (2 * both + 100) / (each + 100)).mean()


if __name__ == "__main__":
    main()
