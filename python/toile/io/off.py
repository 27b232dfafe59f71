"""OFF: the text of Geomview's meshes. http://www.geomview.org/docs/html/OFF.html"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats
from .bounded import MESH_BYTES, read_bytes
from .triangulation import triangles_of

HEADER = re.compile("(ST)?C?N?OFF")  # what normals, colours and textures add follows a vertex's place

Line = tuple[int, list[str]]  # its number in the file, its words


def read_off(path: Path) -> tuple[Floats, Anything]:
    """Vertices (n,3) in the file's order, and triangles (m,3) int64 of its polygons in theirs. UserError names the file and the line
    that is not OFF, or what its header says and the file lacks."""
    text = read_bytes(path, MESH_BYTES).decode("utf-8-sig", errors="replace")
    numbered = ((number, line.partition("#")[0].split()) for number, line in enumerate(text.splitlines(), 1))
    (n, m), lines = _counts(path, [(number, words) for number, words in numbered if words])
    if len(lines) < n + m:
        raise UserError(f"{path}: its header says {n} vertices and {m} faces, {len(lines)} lines follow")
    V = np.array([_vertex(path, line) for line in lines[:n]], np.float64).reshape(-1, 3)
    faces = [_face(path, line) for line in lines[n : n + m]]
    corners = np.array([corner for face in faces for corner in face], np.int64)
    return V, corners[triangles_of(V, corners, [len(face) for face in faces])]


def _counts(path: Path, lines: list[Line]) -> tuple[tuple[int, int], list[Line]]:
    """How many vertices and faces there are, and the lines that follow; the counts may stand beside the keyword."""
    if not lines or not HEADER.fullmatch(lines[0][1][0]):
        raise UserError(f"{path}: expected OFF, COFF, NOFF or the like as its first word")
    number, words = lines[0]
    rest = [(number, words[1:]), *lines[1:]] if words[1:] else lines[1:]
    try:
        n, m = (int(word) for word in rest[0][1][:2])
        if min(n, m) < 0:
            raise ValueError
    except (ValueError, IndexError):
        raise UserError(f"{path}: expected the numbers of vertices and of faces, as text, after {words[0]}") from None
    return (n, m), rest[1:]


def _vertex(path: Path, line: Line) -> list[float]:
    number, words = line
    try:
        return [float(words[k]) for k in range(3)]
    except (ValueError, IndexError):
        raise UserError(f"{path}: line {number}: expected a vertex, {' '.join(words)[:60]!r} is none") from None


def _face(path: Path, line: Line) -> list[int]:
    """The corners of a polygon, after which its colour may follow."""
    number, words = line
    try:
        return [int(words[k]) for k in range(1, int(words[0]) + 1)]
    except (ValueError, IndexError):
        raise UserError(f"{path}: line {number}: expected a face, {' '.join(words)[:60]!r} is none") from None
