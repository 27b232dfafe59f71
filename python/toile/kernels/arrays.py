"""The one place where callers' arrays become the core's: C order, float64 or int32, shapes checked by name."""

import numpy as np
import scipy.sparse as sp

from .._core import InputError


def as_vertices(kernel, name, values):
    """(n,3) float64, C order; InputError names the argument."""
    array = _as_float64(kernel, name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (n, 3)")
    return array


def as_faces(kernel, name, values, width=3):
    """(m,width) int32, C order; integers only, so that no index is rounded silently."""
    array = _as_array(kernel, name, values)
    if array.ndim != 2 or array.shape[1] != width:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (m, {width})")
    return _as_int32(kernel, name, array)


def as_indices(kernel, name, values):
    """(k,) int32."""
    array = _as_array(kernel, name, values)
    if array.ndim != 1:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (k,)")
    return _as_int32(kernel, name, array)


def as_floats(kernel, name, values, shape):
    """float64 of a given shape; None in `shape` stands for any size."""
    array = _as_float64(kernel, name, values)
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
    if not fits:
        wanted = tuple("any" if size is None else size for size in shape)
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected {wanted}")
    return array


def as_pixels(kernel, name, values):
    """(H,W,C) float32, C order."""
    array = _as_array(kernel, name, values)
    if array.ndim != 3 or array.dtype.kind not in "fiub":
        raise InputError(f"{kernel}: {name} has shape {array.shape} of {array.dtype}, expected (H,W,C) numbers")
    return np.ascontiguousarray(array, dtype=np.float32)


def as_sparse(kernel, name, values, kind=sp.csr_matrix):
    """Sparse float64 rows (scipy's csr, or another `kind`), finite, with every index in range: the core trusts its
    structure."""
    try:
        matrix = kind(values, dtype=np.float64)
        matrix.check_format(full_check=True)
    except (ValueError, TypeError, IndexError) as error:
        raise InputError(f"{kernel}: {name} is not a sparse matrix of numbers: {error}") from None
    if not np.isfinite(matrix.data).all():
        raise InputError(f"{kernel}: {name} is not finite")
    if not matrix.has_canonical_format:  # a copy: the arrays may be the caller's
        matrix = matrix.copy()
        matrix.sum_duplicates()
    return matrix


def _as_array(kernel, name, values):
    """An array of whatever the caller gave; a ragged list or a mask, whose values would count, is refused."""
    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"{kernel}: {name} is a masked array")
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InputError(f"{kernel}: {name} is not an array: {error}") from None


def _as_float64(kernel, name, values):
    array = _as_array(kernel, name, values)
    if array.dtype.kind not in "fiub":
        raise InputError(f"{kernel}: {name} has dtype {array.dtype}, expected numbers")
    return np.asarray(array, dtype=np.float64, order="C")


def _as_int32(kernel, name, array):
    if array.size == 0:
        return np.ascontiguousarray(array, dtype=np.int32)
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{kernel}: {name} has dtype {array.dtype}, expected integers")
    if array.min() < np.iinfo(np.int32).min or array.max() > np.iinfo(np.int32).max:
        raise InputError(f"{kernel}: {name} holds indices beyond 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)
