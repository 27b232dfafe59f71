"""The network: plain 3 x 3 convolutions down to a thirty-second of the picture, the picture's mean added there, and a decoder with
skips up to a half (U-Net, Ronneberger et al. 2015). Classes come out at the picture's own size. Filters that go channel by channel
have fewer weights, but take three times as long to train on a processor."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn

from . import CLASSES

WIDTHS = (16, 32, 64, 112, 144)  # at a half, quarter, eighth, sixteenth, thirty-second
DEPTHS = (1, 2, 2, 2, 2)


def conv(inputs, outputs, kernel=3, stride=1):
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )


class Clothes(nn.Module):
    """RGB (N,3,S,S) in about -2..2 -> logits (N,C,S,S); S a multiple of 32."""

    def __init__(self):
        super().__init__()
        self.stages = nn.ModuleList()
        for i, (wide, deep) in enumerate(zip(WIDTHS, DEPTHS)):
            down = conv(WIDTHS[i - 1] if i else 3, wide, stride=2)
            self.stages.append(nn.Sequential(down, *(conv(wide, wide) for _ in range(deep - 1))))
        self.whole = conv(WIDTHS[-1], WIDTHS[-1], 1)
        self.joins = nn.ModuleList(conv(a + b, b) for a, b in zip(WIDTHS[:0:-1], WIDTHS[-2::-1]))
        self.last = nn.Conv2d(WIDTHS[0], len(CLASSES), 3, padding=1)

    def forward(self, x):
        kept = []
        for stage in self.stages:
            x = stage(x)
            kept.append(x)
        x = x + self.whole(x.mean((2, 3), keepdim=True))
        for join, skip in zip(self.joins, kept[-2::-1]):
            x = join(torch.cat([twice(x), skip], 1))
        return twice(self.last(x))


def twice(x):
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
