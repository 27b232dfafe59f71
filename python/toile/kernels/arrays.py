"""The one place where callers' arrays become the core's: C order, float64 or int32, shapes checked by name."""

import numpy as np

from .._core import InputError


def as_vertices(kernel, name, values):
    """(n,3) float64, C order; InputError names the argument."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (n, 3)")
    return array


def as_faces(kernel, name, values, width=3):
    """(m,width) int32, C order; integers only, so that no index is rounded silently."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != width:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (m, {width})")
    return _as_int32(kernel, name, array)


def as_indices(kernel, name, values):
    """(k,) int32."""
    array = np.asarray(values)
    if array.ndim != 1:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (k,)")
    return _as_int32(kernel, name, array)


def as_floats(kernel, name, values, shape):
    """float64 of a given shape; None in `shape` stands for any size."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
    if not fits:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected {tuple('any' if s is None else s for s in shape)}")
    return array


def _as_int32(kernel, name, array):
    if array.size == 0:
        return np.ascontiguousarray(array, dtype=np.int32)
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{kernel}: {name} has dtype {array.dtype}, expected integers")
    if array.min() < np.iinfo(np.int32).min or array.max() > np.iinfo(np.int32).max:
        raise InputError(f"{kernel}: {name} holds indices beyond 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)
