"""The network: inverted residuals (Sandler et al. 2018) down to a sixteenth of the picture, the picture's mean added there, and
a narrow decoder with skips up to a half. Classes come out at the picture's own size."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from . import CLASSES

WIDTHS = (16, 32, 56, 96)  # at a half, quarter, eighth, sixteenth
DEPTHS = (1, 2, 3, 5)
EXPANSION = 3


def conv(inputs, outputs, kernel, stride=1, groups=1, active=True):
    layers = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, *([nn.ReLU6(inplace=True)] if active else []))


class Inverted(nn.Module):
    """Widened, filtered channel by channel, narrowed."""

    def __init__(self, inputs, outputs, stride=1, kernel=3):
        super().__init__()
        wide = EXPANSION * inputs
        self.steps = nn.Sequential(
            conv(inputs, wide, 1), conv(wide, wide, kernel, stride, wide), conv(wide, outputs, 1, active=False)
        )
        self.adds = stride == 1 and inputs == outputs

    def forward(self, x):
        return x + self.steps(x) if self.adds else self.steps(x)


class Clothes(nn.Module):
    """RGB (N,3,S,S) in about -2..2 -> logits (N,C,S,S); S a multiple of 16."""

    def __init__(self):
        super().__init__()
        self.first = conv(3, WIDTHS[0], 3, 2)
        self.stages = nn.ModuleList()
        for i, (wide, deep) in enumerate(zip(WIDTHS, DEPTHS)):
            kernel = 5 if i == len(WIDTHS) - 1 else 3
            blocks = [Inverted(WIDTHS[i - 1], wide, 2, kernel)] if i else [Inverted(wide, wide)]
            self.stages.append(nn.Sequential(*blocks, *(Inverted(wide, wide, 1, kernel) for _ in range(deep - 1))))
        self.whole = conv(WIDTHS[-1], WIDTHS[-1], 1)
        self.narrow = nn.ModuleList(conv(a + b, b, 1) for a, b in zip(WIDTHS[:0:-1], WIDTHS[-2::-1]))
        self.smooth = nn.ModuleList(Inverted(b, b) for b in WIDTHS[-2::-1])
        self.last = nn.Conv2d(WIDTHS[0], len(CLASSES), 3, padding=1)

    def forward(self, x):
        x, kept = self.first(x), []
        for stage in self.stages:
            x = stage(x)
            kept.append(x)
        x = x + self.whole(x.mean((2, 3), keepdim=True))
        for narrow, smooth, skip in zip(self.narrow, self.smooth, kept[-2::-1]):
            x = smooth(narrow(torch.cat([twice(x), skip], 1)))
        return twice(self.last(x))


def twice(x):
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
