"""Motions of drawn features, and drivers that answer something."""

import numpy as np
import torch

from toile.avatar.drive.driver import Track, row_starts


def track(frames, stride=1, features=3, rate=1.0):
    frames = np.asarray(frames)
    own = np.diff(frames).min()
    return Track(frames, torch.randn(len(frames), features), row_starts(np.diff(frames) != own), stride // own, rate)


def wake(driver, motion):
    """A driver that was never trained, but answers more than the mean code, far within the range of any."""
    driver.projection.fit(motion.features)
    driver.code_range.mul_(1e3)
    for p in [*driver.models.parameters(), *driver.models.buffers()]:
        torch.nn.init.normal_(p, std=0.3)
