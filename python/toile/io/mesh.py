"""Meshes: OBJ with a UV topology of its own, and everything else that trimesh reads without reordering."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import UserError
from ..scene import Mesh

MAX_FACES = 20_000_000


def read_mesh(path):
    """A Mesh, its vertices in file order. UserError names the file and the first bad vertex or face."""
    path = Path(path)
    try:
        mesh = _read_obj(path) if path.suffix.lower() == ".obj" else _read_by_trimesh(path)
    except UserError:
        raise
    except Exception as error:
        raise UserError(f"{path}: cannot be read as a mesh: {error}") from None
    return check_mesh(path, mesh)


def check_mesh(path, mesh):
    """The mesh itself, or a UserError."""
    n = len(mesh.vertices)
    if n == 0 or len(mesh.faces) == 0:
        raise UserError(f"{path}: the mesh has {n} vertices and {len(mesh.faces)} faces")
    if len(mesh.faces) > MAX_FACES:
        raise UserError(f"{path}: {len(mesh.faces)} faces, at most {MAX_FACES} are read")
    bad = np.flatnonzero(~np.isfinite(mesh.vertices).all(1))
    if len(bad):
        raise UserError(f"{path}: vertex {bad[0]} is not finite")
    bad = np.flatnonzero(((mesh.faces < 0) | (mesh.faces >= n)).any(1))
    if len(bad):
        raise UserError(f"{path}: face {bad[0]} names a vertex that is not there ({n} vertices)")
    return mesh


def _read_by_trimesh(path):
    import trimesh

    loaded = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    data = loaded.metadata.get("_ply_raw", {}).get("face", {}).get("data", {}) if loaded.metadata else {}
    labels = data["label"] if isinstance(data, dict) and "label" in data else None
    return Mesh(
        np.array(loaded.vertices, dtype=np.float64),
        np.array(loaded.faces, dtype=np.int32).reshape(-1, 3),
        face_labels=None if labels is None else np.asarray(labels, np.uint8).ravel(),
    )


def _read_obj(path):
    """`v`, `vt` and `f` lines; polygons become fans."""
    v, vt, f, ft = [], [], [], []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "v":
                v.append([float(w) for w in words[1:4]])
            elif words[0] == "vt":
                vt.append([float(w) for w in words[1:3]])
            elif words[0] == "f":
                corners = [_corner(w, len(v), len(vt)) for w in words[1:]]
                for a, b in zip(corners[1:], corners[2:]):
                    f.append([corners[0][0], a[0], b[0]])
                    ft.append([corners[0][1], a[1], b[1]])
        except ValueError:
            raise UserError(f"{path}: line {number}: {line.strip()[:60]!r} is not OBJ") from None
    faces, face_uv = np.array(f, np.int32).reshape(-1, 3), np.array(ft, np.int32).reshape(-1, 3)
    has_uv = len(vt) > 0 and len(face_uv) > 0 and (face_uv >= 0).all()
    return Mesh(
        np.array(v, np.float64).reshape(-1, 3),
        faces,
        uv=np.array(vt, np.float64) if has_uv else None,
        face_uv=face_uv if has_uv else None,
    )


def _corner(word, vertices, uvs):
    """ "7/3/1" -> (6, 2); negative indices count from the end."""
    parts = word.split("/")
    v = int(parts[0])
    t = int(parts[1]) if len(parts) > 1 and parts[1] else 0
    return v - 1 if v > 0 else vertices + v, (t - 1 if t > 0 else uvs + t) if t else -1


def write_ply(path, vertices, faces):
    """Binary PLY."""
    import trimesh

    trimesh.Trimesh(vertices, faces, process=False).export(path)
