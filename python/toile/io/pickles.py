"""Pickles of others, of which only data are taken: numbers, text, lists, dictionaries, numpy arrays, scipy's sparse matrices
and chumpy's arrays. Nothing is imported but numpy's array types and nothing is run; everything else is refused by name.

A sparse matrix or chumpy array comes as a `State`, its fields as they were saved: `plain` makes an array of it.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything
from .bounded import read_bytes, reason_of

BYTES = 2 << 30
SPARSE = ("csc_matrix", "csr_matrix", "csc_array", "csr_array")
CHUMPY = {"chumpy.ch": ("Ch",), "chumpy.reordering": ("Select",)}
ARRAYS = re.compile(r"numpy\._?core\.(multiarray|numeric)")  # of numpy 1 and 2


class State:
    """An object of a class that is not imported: its name and the fields that it was saved with."""

    kind = ""

    def __new__(cls, *_: Any) -> Any:
        return super().__new__(cls)

    def __setstate__(self, state: Any) -> None:
        parts = state if isinstance(state, tuple) else (state,)
        self.fields = {key: value for part in parts if isinstance(part, dict) for key, value in part.items()}


class _Sparse(State):
    kind = "sparse"


class _SparseRows(State):
    kind = "sparse rows"


class _Chumpy(State):
    kind = "chumpy"


class _Select(State):
    kind = "select"


def _reconstruct(cls: Any, base: Any, state: Any) -> Any:
    """copyreg's, for our stand-ins alone."""
    if not (isinstance(cls, type) and issubclass(cls, State)):
        raise pickle.UnpicklingError("an object that is no array")
    return cls()


def _empty(kind: Any, shape: Any, code: Any) -> Anything:
    """numpy's, which always starts from an empty array and fills it by its state."""
    if kind is not np.ndarray or tuple(shape) != (0,):
        raise pickle.UnpicklingError("an array that is none")
    return np.ndarray((0,), "b")


def _from_buffer(buffer: Any, dtype: Any, shape: Any, order: Any = "C", *_: Any) -> Anything:
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


def _encoded(text: str, encoding: str = "utf-8", *_: Any) -> bytes:
    """What protocol 2 calls to hold bytes."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"text of encoding {encoding!r}")
    return text.encode("latin1")


def _scalar(dtype: Any, data: Any = None) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or not isinstance(data, (bytes, str)):
        raise pickle.UnpicklingError("a number that is none")
    return np.frombuffer(data.encode("latin1") if isinstance(data, str) else data, dtype, 1)[0]


class _Restricted(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        if ARRAYS.fullmatch(module) and name in ("_reconstruct", "_frombuffer", "scalar"):
            return {"_reconstruct": _empty, "_frombuffer": _from_buffer, "scalar": _scalar}[name]
        if (module, name) == ("_codecs", "encode"):
            return _encoded
        if (module, name) in (("copy_reg", "_reconstructor"), ("copyreg", "_reconstructor")):
            return _reconstruct
        if module in ("__builtin__", "builtins") and name == "object":
            return object
        if module.startswith("scipy.sparse.") and name in SPARSE:
            return _Sparse if name.startswith("csc") else _SparseRows
        if name in CHUMPY.get(module, ()):
            return _Select if name == "Select" else _Chumpy
        raise pickle.UnpicklingError(f"it would import {module}.{name}: only plain data are read")

    def persistent_load(self, pid: Any) -> Any:
        raise pickle.UnpicklingError("it names objects outside the file")


def read_pickle(path: Path | str, kind: Any = None) -> Any:
    """What a pickle holds, of plain data; with `kind` (dict, ...) that and nothing else. UserError names the file and what it
    would have imported."""
    try:
        value = _Restricted(io.BytesIO(read_bytes(path, BYTES)), encoding="latin1").load()
    except (UserError, MemoryError):
        raise
    except Exception as error:
        raise UserError(f"{path}: not a pickle of plain data: {reason_of(error)}") from None
    if kind is not None and not isinstance(value, kind):
        raise UserError(f"{path}: holds a {type(value).__name__}, expected a {kind.__name__}")
    return value


def plain(path: Path | str, field: str, value: Any) -> Anything:
    """An array of numbers or text, out of an array, a list, a sparse matrix (made dense) or a chumpy array."""
    try:
        array = np.asarray(_dense(value))
        if array.dtype.hasobject:
            raise ValueError("holds objects")
    except (ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        raise UserError(f"{path}: {field}: not an array: {reason_of(error)}") from None
    return array


def _dense(value: Any) -> Any:
    if not isinstance(value, State):
        return value
    fields = value.fields
    if value.kind.startswith("sparse"):
        from scipy import sparse

        shape = tuple(int(n) for n in fields.get("_shape", fields.get("shape", ())))
        if math.prod(shape) > BYTES // 8:
            raise ValueError(f"a matrix of {shape}")
        make = sparse.csc_matrix if value.kind == "sparse" else sparse.csr_matrix
        matrix = make((fields["data"], fields["indices"], fields["indptr"]), shape=shape)
        matrix.check_format(full_check=True)
        return matrix.toarray()
    if value.kind == "select":
        picked = np.ravel(_dense(fields["a"]))[np.asarray(fields["idxs"])]
        return picked.reshape(fields.get("preferred_shape") or picked.shape)
    return _dense(fields["x"])
