"""Garment templates of a capture: meshes that are cleaned or refused before any stage sees them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels import boundary_loops
from ..kernels.arrays import Anything
from ..scene import Mesh
from .bounded import read_bytes
from .mesh import OBJ_BYTES, read_mesh

MATERIAL_BYTES = 1 << 20
UV_SLACK = 1e-4  # exporters round: so far outside 0..1 a UV is moved onto its border


@dataclass(frozen=True)
class Template:
    """A garment's rest mesh. `kept` (g,) are the file's vertices that it has, in their order; `warnings` say what was left out."""

    mesh: Mesh
    kept: np.ndarray
    warnings: tuple[str, ...] = ()


def read_template(path: Path, garment: str) -> Any:
    """The Template of the garment of that name; vertices of no face are left out. UserError names the file, and the vertex,
    face or UV."""
    mesh = read_mesh(path)
    _check_faces(path, mesh)
    kept = np.unique(mesh.faces)
    warnings: tuple[str, ...] = ()
    if len(kept) < len(mesh.vertices):
        number = np.full(len(mesh.vertices), -1, np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        lost = np.flatnonzero(number < 0)
        mesh = Mesh(mesh.vertices[kept], number[mesh.faces], mesh.uv, mesh.face_uv)
        some = f"vertex {lost[0]} belongs" if len(lost) == 1 else f"vertices {_some(lost)} belong"
        warnings += (f"{path}: {some} to no face of garment '{garment}': left out",)
    against = _turned_faces(path, mesh.faces)
    if against.any():
        mesh, some = _with_faces_turned(mesh, against), _some(np.flatnonzero(against))
        warnings += (
            f"{path}: {int(against.sum())} faces of garment '{garment}' are turned against their neighbours ({some}): turned back",
        )
    warnings += tuple(f"{path}: garment '{garment}': {text}?" for text in _odd_shape(mesh.faces, kept))
    loops = boundary_loops(mesh.faces)
    if not loops:
        raise UserError(f"{path}: the template of garment '{garment}' has no open loops")
    _check_seams(path, mesh, np.concatenate(loops), kept)
    return Template(Mesh(mesh.vertices, mesh.faces, _checked_uv(path, mesh.uv), mesh.face_uv), kept, warnings)


def texture_files(root: Path, path: Path) -> tuple[Path, ...]:
    """The material file and the picture that an OBJ names, `mtllib` and its first `map_Kd`; () where it names none, or a
    material file that is not there. UserError: a path that leaves the capture `root`, or a picture that is not there."""
    material = _material(root, path)
    if material is None or not material.is_file():
        return ()
    picture = _named(root, material, "map_Kd", MATERIAL_BYTES)
    if picture is None:
        return ()
    if not picture.is_file():
        raise UserError(f"{material}: map_Kd: no file '{picture.name}'")
    return material, picture


def lost_material(root: Path, path: Path) -> Path | None:
    """The material file that an OBJ names and that is not there; None where it names none, or one that is."""
    material = _material(root, path)
    return None if material is None or material.is_file() else material


def _material(root: Path, path: Path) -> Path | None:
    return _named(root, path, "mtllib", OBJ_BYTES) if path.suffix.lower() == ".obj" else None


def _named(root: Path, file: Path, key: str, limit: int) -> Path | None:
    """The path that the first line `key` of a file names, beside it and inside `root`."""
    for line in read_bytes(file, limit).decode("utf-8", errors="replace").split("\n"):
        words = line.split(None, 1)
        if len(words) == 2 and words[0] == key:
            name = words[1].strip()
            name = name.split()[-1] if name.startswith("-") else name  # options stand before it
            found = Path(os.path.realpath(file.parent / name.replace("\\", "/"))) if name.isprintable() else None
            if found is None or not found.is_relative_to(os.path.realpath(root)):
                raise UserError(f"{file}: {key}: {name!r} leaves the capture")
            return found
    return None


def _check_faces(path: Path, mesh: Mesh) -> None:
    a, b, c = mesh.faces.T
    twice = np.flatnonzero((a == b) | (b == c) | (c == a))
    if len(twice):
        raise UserError(f"{path}: face {twice[0]} names a vertex twice")


def _turned_faces(path: Path, faces: Anything) -> Anything:
    """Which faces (m,) look the other way than most of those they hang together with. UserError: a surface with one side alone,
    such as a Moebius strip."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    m = len(faces)
    a, b, same = _neighbours(faces)
    # every face twice, as it is (f) and turned (f + m), joined to those that look its way
    rows, columns = np.concatenate([a, a + m]), np.concatenate([b + m * same, b + m * ~same])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * m, 2 * m))
    side = connected_components(graph, directed=False)[1].reshape(2, m)
    both = np.flatnonzero(side[0] == side[1])
    if len(both):
        raise UserError(f"{path}: face {both[0]} belongs to a surface that has one side alone")
    part, turned = side.min(0), side[0] > side[1]
    share = np.bincount(part, turned) / np.maximum(np.bincount(part), 1)
    return turned ^ (share[part] > 0.5)


def _neighbours(faces: Anything) -> tuple[Any, Any, Any]:
    """Pairs of faces that alone share an edge, and whether they run along it the same way, as faces do that look opposite ways."""
    half = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    _, edge, count = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    pairs = order[count[edge.ravel()[order]] == 2].reshape(-1, 2)
    corners = np.sort(faces, axis=1)[pairs // 3]
    pairs = pairs[(corners[:, 0] != corners[:, 1]).any(1)]  # no face that stands twice
    a, b = pairs.T
    return a // 3, b // 3, half[a, 0] == half[b, 0]


def _odd_shape(faces: Anything, kept: Anything) -> list[str]:
    """What is said of a surface that hangs together otherwise than cloth: fins, loose parts. `kept` (g,): its vertices' numbers in
    the file."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    said = []
    once = np.unique(np.sort(faces, axis=1), axis=0)
    edges, count = np.unique(once[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2), axis=0, return_counts=True)
    fins = np.flatnonzero(count > 2)
    if len(fins):
        (a, b), more = kept[edges[fins[0]]], f" and {len(fins) - 1} edges more" if len(fins) > 1 else ""
        said.append(
            f"the edge from vertex {a} to {b} belongs to {count[fins[0]]} faces{more}: is it a pocket or a seam allowance"
        )
    n = len(kept)
    part = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=(n, n)), directed=False)[1]
    sizes = np.bincount(part[faces[:, 0]])
    if len(sizes) > 1:
        least = sizes.argmin()
        loose = f"the least of {sizes[least]} faces at vertex {kept[(part == least).argmax()]}"
        said.append(f"{len(sizes)} parts that do not hang together, {loose}: is each of them cloth")
    return said


def _with_faces_turned(mesh: Mesh, turned: Anything) -> Mesh:
    """The mesh with those faces' corners in the opposite order."""
    face_uv = None if mesh.face_uv is None else np.where(turned[:, None], mesh.face_uv[:, ::-1], mesh.face_uv)
    return Mesh(mesh.vertices, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces), mesh.uv, face_uv)


def _check_seams(path: Path, mesh: Mesh, border: Anything, kept: Anything) -> None:
    """Coincident vertices of the border are a seam that was never sewn, which would count as an opening."""
    _, first, count = np.unique(mesh.vertices[border], axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        at = mesh.vertices[border[first[count > 1][0]]]
        pair = kept[border[(mesh.vertices[border] == at).all(1)][:2]]
        raise UserError(
            f"{path}: vertices {pair[0]} and {pair[1]} lie at one place of its border: weld them, UVs have seams of their own"
        )


def _checked_uv(path: Path, uv: Anything | None) -> Anything | None:
    if uv is None:
        return None
    bad = np.flatnonzero(~((uv >= -UV_SLACK) & (uv <= 1 + UV_SLACK)).all(1))
    if len(bad):
        u, v = uv[bad[0]]
        raise UserError(f"{path}: UV {bad[0]} is ({u:g}, {v:g}), expected 0 to 1")
    return np.clip(uv, 0, 1)


def _some(indices: Anything) -> str:
    """The first of many numbers, in words."""
    return ", ".join(map(str, indices[:3])) + (f" and {len(indices) - 3} more" if len(indices) > 3 else "")
