"""What holds of every result, and which exceptions are lawful."""

import numpy as np

from toile import kernels

LAWFUL = (kernels.InputError, kernels.SolveError, TypeError)


def finite(name, values, shape=None):
    values = np.asarray(values)
    assert shape is None or values.shape == shape, f"{name} has shape {values.shape}, expected {shape}"
    assert np.isfinite(values).all(), f"{name} is not finite"


def within(name, values, low, high):
    values = np.asarray(values)
    assert ((values >= low) & (values <= high)).all(), f"{name} lies beyond {low} to {high}"


def rows(F):
    return len(F) if np.iterable(F) else 0
