"""Slides over the frames of a block: measured where there are pictures, smooth over time between."""

import numpy as np


def over_time(numbers, slides, wanted, fps, settings):
    """Slides at the frames `wanted` (w,), from those measured at `numbers` (k,), each (g,2): the minimiser over all frames
    of sum |x - d|^2 + (slide_time fps)^4 |x''|^2 + (drift_time fps)^2 |x'|^2, an approximating spline. None where nothing was measured."""
    if not len(numbers):
        return None
    first, last = min(min(numbers), min(wanted)), max(max(numbers), max(wanted))
    count = last - first + 1
    A = np.zeros((count, count))
    at = np.asarray(numbers) - first
    A[at, at] = 1
    for order, cost in ((1, (settings.drift_time * fps) ** 2), (2, (settings.slide_time * fps) ** 4)):
        D = np.diff(np.eye(count), order, axis=0)
        A += cost * D.T @ D
    right = np.zeros((count, slides[0].size))
    right[at] = np.stack([d.ravel() for d in slides])
    x = np.linalg.solve(A, right)[np.asarray(wanted) - first]
    return x.reshape(len(wanted), *slides[0].shape)
