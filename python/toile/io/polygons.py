"""Polygons of PLY, also of binary ones whose faces have unlike numbers of corners, which trimesh takes for as many as the first has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything
from .bounded import MESH_BYTES, read_bytes
from .triangulation import triangles_of

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
CORNERS = ("vertex_indices", "vertex_index")

Properties = dict[str, tuple[np.dtype, ...]]  # {property: its type, or those of a list's length and its items}


def polygons_in(found: Any) -> Any:
    """The corners of each face of a PLY as trimesh's `load_ply` found it, (m,k) or lists of unlike lengths; None where it read as many for all
    from a binary file as the first has, and others have another number."""
    data = found["metadata"]["_ply_raw"].get("face", {}).get("data")
    names = data if isinstance(data, dict) else getattr(getattr(data, "dtype", None), "names", None) or ()
    rows = next((data[name] for name in CORNERS if name in names), found["faces"])
    if rows.dtype.names is None:
        return rows
    return None if (rows["f0"] != rows["f0"][:1]).any() else rows["f1"]


def triangles_in(vertices: Anything, polygons: Any) -> tuple[Anything, Anything]:
    """Triangles (m,3) of polygons, each its corners, in their order; and how many corners each polygon has (p,)."""
    corners = np.concatenate([np.zeros(0, np.int64), *polygons]).astype(np.int64)
    counts = np.array([len(polygon) for polygon in polygons], np.int64)
    return corners[triangles_of(vertices, corners, counts)], counts


def read_polygons(path: Path) -> tuple[Anything, Anything, Anything, dict[str, dict[str, Any]]]:
    """Vertices (n,3), triangles (m,3) of the polygons in their order, how many corners each of these has (p,), and the elements as trimesh
    gives them. UserError: the file ends too early, or goes on."""
    data = read_bytes(path, MESH_BYTES)
    elements: dict[str, dict[str, Any]] = {}
    at = data.index(b"\n", data.index(b"end_header")) + 1
    for name, count, properties in _header(data[:at].decode("ascii", "replace")):
        try:
            values, at = _element(data, at, count, properties)
        except (ValueError, IndexError):
            raise UserError(f"{path}: ends in the middle of its {count} of element {name}") from None
        elements[name] = {"length": count, "data": values}
    if at != len(data):
        raise UserError(f"{path}: {len(data) - at} bytes follow what its header says")
    vertex, face = elements["vertex"]["data"], elements["face"]["data"]
    polygons = next(face[name] for name in CORNERS if name in face)
    vertices = np.stack([vertex[axis] for axis in "xyz"], 1)
    return vertices, *triangles_in(vertices, polygons), elements


def _header(text: str) -> list[tuple[str, int, Properties]]:
    """[(element, count, its properties)]"""
    lines = [line.split() for line in text.splitlines()]
    order = ">" if ["format", "binary_big_endian"] in [words[:2] for words in lines] else "<"
    found: list[tuple[str, int, Properties]] = []
    for words in lines:
        if words[:1] == ["element"]:
            found.append((words[1], int(words[2]), {}))
        elif words[:1] == ["property"]:
            types = words[2:4] if words[1] == "list" else words[1:2]
            found[-1][2][words[-1]] = tuple(np.dtype(order + TYPES[kind]) for kind in types)
    return found


def _element(data: bytes, at: int, count: int, properties: Properties) -> tuple[dict[str, Any], int]:
    """{property: values} of the `count` entries from byte `at` on, and where they end. ValueError, IndexError: before."""
    if all(len(types) == 1 for types in properties.values()):
        row = np.dtype([(name, types[0]) for name, types in properties.items()])
        rows = np.frombuffer(data, row, count, at)
        return {name: rows[name] for name in properties}, at + rows.nbytes
    values: dict[str, list[Any]] = {name: [] for name in properties}
    for _ in range(count):
        for name, types in properties.items():
            length = int(np.frombuffer(data, types[0], 1, at)[0]) if len(types) == 2 else 1
            if length < 0:
                raise ValueError
            at += types[0].itemsize if len(types) == 2 else 0
            values[name].append(np.frombuffer(data, types[-1], length, at).tolist())
            at += length * types[-1].itemsize
    return {name: np.ravel(v) if len(properties[name]) == 1 else v for name, v in values.items()}, at
