"""Meshes: OBJ with a UV topology of its own, and everything else that trimesh reads without reordering."""

from __future__ import annotations

from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats, as_faces, as_floats, as_vertices
from ..scene import Mesh
from .bounded import MESH_BYTES, check_file, read_bytes, reason_of
from .files import replace_file
from .off import read_off
from .polygons import polygons_in, read_polygons, triangles_in
from .triangulation import triangles_of

MAX_FACES = 20_000_000
OBJ_BYTES = 512 << 20
KINDS = (".ply", ".obj", ".off", ".stl")
HEAD = 64  # bytes in which a PLY says its format
NO_UV = -1  # a face's corner without one
FAR = 200  # times its own extent that a mesh may lie from the origin before float32 rounds away more than 1e-5 of it


def read_mesh(path: Path | str) -> Mesh:
    """A Mesh, its vertices in file order. UserError names the file and the first bad vertex or face."""
    path = check_file(path, MESH_BYTES)
    if path.suffix.lower() not in KINDS:
        raise UserError(f"{path}: not a mesh that is read: {', '.join(KINDS)}")
    try:
        mesh = _read_obj(path) if path.suffix.lower() == ".obj" else _read_by_trimesh(path)
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{path}: cannot be read as a mesh: {reason_of(error)}") from None
    return check_mesh(path, mesh)


def check_mesh(path: Path, mesh: Mesh) -> Mesh:
    """The mesh itself, or a UserError."""
    n = len(mesh.vertices)
    if n == 0 or len(mesh.faces) == 0:
        cloud = ": a cloud of points, expected a surface" if n else ""
        raise UserError(f"{path}: the mesh has {n} vertices and {len(mesh.faces)} faces{cloud}")
    if len(mesh.faces) > MAX_FACES:
        raise UserError(f"{path}: {len(mesh.faces)} faces, at most {MAX_FACES} are read")
    bad = np.flatnonzero(~np.isfinite(mesh.vertices).all(1))
    if len(bad):
        raise UserError(f"{path}: vertex {bad[0]} is not finite")
    bad = np.flatnonzero(((mesh.faces < 0) | (mesh.faces >= n)).any(1))
    if len(bad):
        raise UserError(f"{path}: face {bad[0]} names a vertex that is not there ({n} vertices)")
    return mesh


def _read_by_trimesh(path: Path) -> Mesh:
    vertices, faces, counts, elements = _arrays_of(path)
    vertices, faces = np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int32).reshape(-1, 3)
    for element, found in (("vertex", len(vertices)), ("face", len(counts))):
        said = elements.get(element, {}).get("length", 0)
        if found < said:  # text that was cut off reads as a smaller mesh
            raise UserError(f"{path}: its header says {said} of element {element}, it holds {found}")
    labels = _ply_labels(path, elements, len(vertices), faces, counts)
    return Mesh(vertices, faces, face_labels=labels, confidence=_ply_confidence(path, elements, len(vertices)))


def _arrays_of(path: Path) -> tuple[Any, Any, Any, Any]:
    """Vertices and triangles; of a PLY also how many corners the polygons have that these are of (p,), and the raw elements. trimesh's mesh
    object would hash them all."""
    import trimesh

    if path.suffix.lower() == ".ply":
        with open(path, "rb") as file:
            try:
                found = trimesh.exchange.ply.load_ply(file, fix_texture=False, skip_materials=True)
            except ValueError:  # as of a binary file whose length is not what as many corners for all faces make
                file.seek(0)
                if b"format ascii" in file.read(HEAD):
                    raise
                return read_polygons(path)
        elements = found["metadata"]["_ply_raw"]
        if "tristrips" in elements:
            raise UserError(f"{path}: element tristrips: strips of triangles are not read: save it as faces")
        if "faces" not in found:
            return found["vertices"], np.zeros((0, 3)), (), {}
        polygons = polygons_in(found)
        if polygons is None:
            return read_polygons(path)
        if np.shape(polygons)[1:] == (3,):
            return found["vertices"], polygons, np.full(len(polygons), 3), elements
        return found["vertices"], *triangles_in(found["vertices"], polygons), elements
    if path.suffix.lower() == ".off":
        return *read_off(path), (), {}
    loaded = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    return *_welded(np.asarray(loaded.vertices), np.asarray(loaded.faces)), (), {}


def _welded(V: Anything, F: Anything) -> tuple[Anything, Anything]:
    """Corners at one place as one vertex, in the order in which they come: an STL says of no two triangles that they share one."""
    _, first, place = np.unique(V, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return V[first[order]], np.argsort(order)[place.ravel()][F]


def _ply_labels(path: Path, elements: Any, n: int, faces: Anything, counts: Anything) -> Any:
    """The property `label` (m,) uint8 of a PLY's polygons of `counts` (p,) corners, whose triangles carry it; that of its vertices as the
    faces' (two corners of three, else the first); None without either."""
    for element, count in (("face", len(counts)), ("vertex", n)):
        labels = _ply_property(elements.get(element, {}).get("data"), "label")
        if labels is None:
            continue
        labels = _ids(path, labels, count, element)
        if element == "face":
            return np.repeat(labels, np.maximum(np.asarray(counts) - 2, 0))
        return face_labels_of(labels, faces) if (faces < n).all() else labels
    return None


def _ids(path: Path, labels: Any, count: int, element: str) -> Any:
    """Labels (count,) uint8, one an element."""
    labels = np.asarray(labels).ravel()
    if len(labels) != count:
        raise UserError(f"{path}: label: {len(labels)} values, expected {count}, one a {element}")
    if labels.dtype.kind not in "iu" or labels.min(initial=0) < 0 or labels.max(initial=0) > 255:
        raise UserError(f"{path}: label: expected whole numbers from 0 to 255 (uchar), one a {element}")
    return labels.astype(np.uint8)


def face_labels_of(labels: Anything, faces: Anything) -> Any:
    """Labels (m,) of faces from those of vertices (n,): that of two corners of three, else the first's."""
    a, b, c = labels[faces].T
    return np.where(b == c, b, a)


def _ply_confidence(path: Path, elements: Any, n: int) -> Any:
    """The property `confidence` (n,) of a PLY's vertices; None without."""
    values = _ply_property(elements.get("vertex", {}).get("data"), "confidence")
    return None if values is None else _shares(path, values, n)


def _shares(path: Path, values: Any, n: int) -> Any:
    """A confidence (n,) float64, one a vertex."""
    values = np.asarray(values, dtype=np.float64).ravel()
    if len(values) != n or not ((values >= 0) & (values <= 1)).all():
        raise UserError(f"{path}: confidence: expected numbers from 0 to 1, one a vertex")
    return values


def _ply_property(data: Any, name: str) -> Any:
    """A property of a PLY's element as trimesh read it: a structured array of binary files, a dictionary of others."""
    names = data if isinstance(data, dict) else getattr(getattr(data, "dtype", None), "names", None) or ()
    return data[name] if name in names else None


class _Obj:
    """The `v`, `vt` and `f` lines of an OBJ as they are read."""

    def __init__(self) -> None:
        self.v: list[list[float]] = []
        self.vt: list[list[float]] = []
        self.f: list[tuple[int, int]] = []  # vertex and UV of each corner of all polygons
        self.sides: list[int] = []  # how many corners each has
        self.v_line: list[int] = []  # line numbers, for refusals
        self.vt_line: list[int] = []
        self.f_line: list[int] = []

    def read(self, number: int, words: list[str]) -> None:
        """One line that was split into words. ValueError: it is not OBJ."""
        if words[0] == "v":
            self.v.append([float(words[k]) for k in (1, 2, 3)])
            self.v_line.append(number)
        elif words[0] == "vt":
            self.vt.append([float(words[k]) for k in (1, 2)])
            self.vt_line.append(number)
        elif words[0] == "f":
            self.f += [_corner(w, len(self.v), len(self.vt)) for w in words[1:]]
            self.sides.append(len(words) - 1)
            self.f_line.append(number)

    def mesh(self, path: Path) -> Mesh:
        v, vt = np.array(self.v, np.float64).reshape(-1, 3), np.array(self.vt, np.float64).reshape(-1, 2)
        corners, sides = np.array(self.f, np.int64).reshape(-1, 2), np.array(self.sides, np.int64)
        triangles = triangles_of(v, corners[:, 0], sides)
        lines = np.repeat(self.f_line, np.maximum(sides - 2, 0))
        f, ft = corners[triangles, 0], corners[triangles, 1]
        has_uv = len(vt) > 0 and (ft != NO_UV).all()
        _refuse(path, self.v_line, ~np.isfinite(v).all(1), "a vertex that is not finite")
        _refuse(path, self.vt_line, ~np.isfinite(vt).all(1), "a UV that is not finite")
        _refuse(path, lines, _outside(f, len(v)), f"the face names a vertex that is not there ({len(v)} vertices)")
        if has_uv:
            _refuse(path, lines, _outside(ft, len(vt)), f"the face names a UV that is not there ({len(vt)} UVs)")
        return Mesh(v, f.astype(np.int32), vt if has_uv else None, ft.astype(np.int32) if has_uv else None)


def _read_obj(path: Path) -> Mesh:
    obj = _Obj()
    text = read_bytes(path, OBJ_BYTES).decode("utf-8-sig", errors="replace")
    for number, statement in _statements(text):
        words = statement.split()
        try:
            if words:
                obj.read(number, words)
        except (ValueError, IndexError):
            raise UserError(f"{path}: line {number}: {statement.strip()[:60]!r} is not OBJ") from None
    return obj.mesh(path)


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """(number of its last line, statement) of an OBJ without comments; a backslash at the end of a line carries it on to the next."""
    begun = ""
    for number, line in enumerate(StringIO(text, newline=None), 1):
        begun += line.partition("#")[0].rstrip()
        if begun.endswith("\\"):
            begun = f"{begun[:-1]} "
        else:
            yield number, begun
            begun = ""
    if begun:
        yield number, begun


def _corner(word: str, vertices: int, uvs: int) -> tuple[int, int]:
    """ "7/3/1" -> (6, 2); negative indices count from the end. ValueError for 0, and for one before the first."""
    v, t, *_ = [*word.split("/"), ""]
    return _index(v, vertices), _index(t, uvs) if t else NO_UV


def _index(text: str, count: int) -> int:
    i = int(text)
    if i == 0 or i < -count or i > MAX_FACES * 3:
        raise ValueError
    return i - 1 if i > 0 else count + i


def _outside(indices: Anything, count: int) -> Any:
    return ((indices < 0) | (indices >= count)).any(1)


def _refuse(path: Path, lines: Any, bad: Any, what: str) -> None:
    """UserError that names the line of the first that is `bad` (n,)."""
    if bad.any():
        raise UserError(f"{path}: line {lines[int(bad.argmax())]}: {what}")


def write_mesh(path: Path | str, mesh: Mesh) -> None:
    """Writes a mesh as a whole file: `.obj` (7 decimals, more for a mesh smaller than a centimetre, with its UVs, 6 decimals) or `.ply`
    (binary, float32 positions, its faces' labels and its vertices' confidence, no UVs; float64 positions for a mesh hundreds of times its extent from the origin).
    UserError: another ending, or what `read_mesh` would refuse. InputError: vertices or faces of another shape or type."""
    path = Path(path)
    write = {".obj": _obj, ".ply": _ply}.get(path.suffix.lower())
    if write is None:
        raise UserError(f"{path}: expected a file that ends in .obj or .ply")
    V, F = as_vertices("write_mesh", "vertices", mesh.vertices), as_faces("write_mesh", "faces", mesh.faces)
    labels = None if mesh.face_labels is None else _ids(path, mesh.face_labels, len(F), "face")
    confidence = None if mesh.confidence is None else _shares(path, mesh.confidence, len(V))
    uv, face_uv = _uvs(path, mesh, len(F)) if path.suffix.lower() == ".obj" else (None, None)
    sound = check_mesh(path, Mesh(V, F, uv, face_uv, labels, confidence=confidence))
    replace_file(path, lambda p: p.write_bytes(write(sound)))


def _uvs(path: Path, mesh: Mesh, m: int) -> tuple[Any, Any]:
    """UVs (t,2) and the three of each face (m,3), None for both where a mesh has none."""
    if mesh.uv is None and mesh.face_uv is None:
        return None, None
    if mesh.uv is None or mesh.face_uv is None:
        raise UserError(f"{path}: {'uv' if mesh.uv is None else 'face_uv'}: a mesh has both uv and face_uv, or neither")
    uv, corners = as_floats("write_mesh", "uv", mesh.uv, (None, 2)), as_faces("write_mesh", "face_uv", mesh.face_uv)
    if len(corners) != m:
        raise UserError(f"{path}: face_uv: {len(corners)} rows for {m} faces")
    bad = np.flatnonzero(~np.isfinite(uv).all(1))
    if len(bad):
        raise UserError(f"{path}: UV {bad[0]} is not finite")
    bad = np.flatnonzero(_outside(corners, len(uv)))
    if len(bad):
        raise UserError(f"{path}: face {bad[0]} names a UV that is not there ({len(uv)} UVs)")
    return uv, corners


def _obj(mesh: Mesh) -> bytes:
    decimals = _decimals(mesh.vertices)
    lines = [f"v {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f}" for x, y, z in mesh.vertices]
    if mesh.uv is None or mesh.face_uv is None:
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
    else:
        lines += [f"vt {u:.6f} {v:.6f}" for u, v in mesh.uv]
        corners = np.stack([mesh.faces, mesh.face_uv], 2).reshape(-1, 6) + 1
        lines += ["f {}/{} {}/{} {}/{}".format(*corner) for corner in corners]
    return ("\n".join(lines) + "\n").encode()


def _decimals(V: Floats) -> int:
    """7, a tenth of a micrometre; more for a mesh below a centimetre, which may count in kilometres, so that none is rounded away."""
    extent = float(np.ptp(V, axis=0).max(initial=0)) if len(V) else 0.0
    return 7 if extent >= 0.01 or extent == 0 else min(7 - int(np.floor(np.log10(extent))), 300)


def _ply(mesh: Mesh) -> Any:
    V, F = mesh.vertices, mesh.faces
    far = np.abs(V).max(initial=0) > FAR * np.abs(V - V[:1]).max(initial=0)
    real, kind = ("double", "<f8") if far else ("float", "<f4")
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(V)}\nproperty {real} x\nproperty {real} y\nproperty {real} z\n"
        + ("" if mesh.confidence is None else f"property {real} confidence\n")
        + f"element face {len(F)}\nproperty list uchar int vertex_indices\n"
    )
    labelled = mesh.face_labels is not None
    header += ("property uchar label\n" if labelled else "") + "end_header\n"
    rows = np.empty(len(F), dtype=[("count", "u1"), ("corners", "<i4", 3), *([("label", "u1")] if labelled else [])])
    rows["count"], rows["corners"] = 3, F
    if labelled:
        rows["label"] = mesh.face_labels
    columns = [V] if mesh.confidence is None else [V, mesh.confidence[:, None]]
    return header.encode() + np.hstack(columns).astype(kind).tobytes() + rows.tobytes()
