"""The one place where callers' arrays become the core's: C order, float64 or int32, shapes checked by name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from .._core import InputError

Array = npt.ArrayLike  # what callers may give
Floats = npt.NDArray[np.float64]  # what kernels take and return
Ints = npt.NDArray[np.int32]
Pixels = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]
Anything = npt.NDArray[Any]


def as_vertices(kernel: str, name: str, values: Array) -> Floats:
    """(n,3) float64, C order; InputError names the argument."""
    array = _as_float64(kernel, name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (n, 3)")
    return array


def as_faces(kernel: str, name: str, values: Array, width: int = 3) -> Ints:
    """(m,width) int32, C order; integers only, so that no index is rounded silently."""
    array = _as_array(kernel, name, values)
    if array.ndim != 2 or array.shape[1] != width:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (m, {width})")
    return _as_int32(kernel, name, array)


def as_face_ids(kernel: str, name: str, values: Array) -> Ints:
    """(H,W) int32."""
    array = _as_array(kernel, name, values)
    if array.ndim != 2:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (H, W)")
    return _as_int32(kernel, name, array)


def as_indices(kernel: str, name: str, values: Array) -> Ints:
    """(k,) int32."""
    array = _as_array(kernel, name, values)
    if array.ndim != 1:
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected (k,)")
    return _as_int32(kernel, name, array)


def as_floats(kernel: str, name: str, values: Array, shape: tuple[int | None, ...]) -> Floats:
    """float64 of a given shape; None in `shape` stands for any size."""
    array = _as_float64(kernel, name, values)
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
    if not fits:
        wanted = tuple("any" if size is None else size for size in shape)
        raise InputError(f"{kernel}: {name} has shape {array.shape}, expected {wanted}")
    return array


def as_pixels(kernel: str, name: str, values: Array) -> Pixels:
    """(H,W,C) float32, C order."""
    array = _as_array(kernel, name, values)
    if array.ndim != 3 or array.dtype.kind not in "fiub":
        raise InputError(f"{kernel}: {name} has shape {array.shape} of {array.dtype}, expected (H,W,C) numbers")
    return np.ascontiguousarray(array, dtype=np.float32)


def as_mask(kernel: str, name: str, values: Array, size: tuple[int, ...]) -> Bools:
    """bool of this size, C order."""
    array = _as_array(kernel, name, values)
    if array.shape != size or array.dtype != bool:
        raise InputError(f"{kernel}: {name} has shape {array.shape} of {array.dtype}, expected {size} of bool")
    return np.ascontiguousarray(array)


def as_sparse(kernel: str, name: str, values: Any, kind: Callable[..., Any] = sp.csr_matrix) -> Any:
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


def _as_array(kernel: str, name: str, values: Array) -> Anything:
    """An array of whatever the caller gave; a ragged list or a mask, whose values would count, is refused."""
    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"{kernel}: {name} is a masked array")
    try:
        return np.asarray(values)
    except (ValueError, TypeError, RuntimeError) as error:  # the last two of torch: on a GPU, or with a gradient
        raise InputError(f"{kernel}: {name} is not an array: {error}") from None


def _as_float64(kernel: str, name: str, values: Array) -> Floats:
    array = _as_array(kernel, name, values)
    if array.dtype.kind not in "fiub":
        raise InputError(f"{kernel}: {name} has dtype {array.dtype}, expected numbers")
    return np.asarray(array, dtype=np.float64, order="C")


def _as_int32(kernel: str, name: str, array: Anything) -> Ints:
    if array.size == 0:
        return np.ascontiguousarray(array, dtype=np.int32)
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{kernel}: {name} has dtype {array.dtype}, expected integers")
    if array.min() < np.iinfo(np.int32).min or array.max() > np.iinfo(np.int32).max:
        raise InputError(f"{kernel}: {name} holds indices beyond 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)
