"""MakeHuman's base mesh and a rig of it, as MakeHuman and MPFB lay them out, become a body model file.

    mpfb/data/rigs/standard/rig.NAME.json       bones: head, parent        weights.NAME.json beside it
    mpfb/data/3dobjs/base.obj                   the base mesh, or a character that was exported with all its vertices

Taken: of the mesh the group `body`, with its texture coordinates; bones and their weights. A bone begins where the rig says:
in the middle of a joint's cube or of some vertices, or at a vertex, all of the mesh itself, so that the skeleton fits the
character. Bones without a vertex stay. MakeHuman's unit is the decimetre; y is up.

Left: the helpers (skirts, tights, hair, the joints' cubes), eyes, teeth and tongue, which are helpers too; targets, so that
there is no shape basis; the bones' rolls.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Floats
from ..scene import Mesh
from .bounded import read_bytes, reason_of
from .figures import joint_keypoints, parents_first
from .mesh import OBJ_BYTES, read_mesh

BYTES = 256 << 20
BODY = "body"
UNIT = 0.1  # m
PLACES = ("base.obj", "../../3dobjs/base.obj")  # of the mesh, seen from the rig


def makehuman_fields(rig: Path, mesh: Path | None) -> tuple[str, dict[str, Any]]:
    """The kind of model and the fields of its body model file. UserError names the file and the field."""
    mesh = mesh or _base_mesh(rig)
    bones, weights = _bones(rig), _weights(rig)
    base, groups = read_mesh(mesh), _groups(mesh)
    if BODY not in groups:
        raise UserError(f"{mesh}: no group {BODY!r}: not MakeHuman's base mesh")
    order, parents = _tree(rig, bones)
    heads = [_head(rig, name, bones[name], base, mesh, groups) for name in order]
    kept, faces, face_uv = _body(base, groups[BODY])
    fields = {
        "v_template": UNIT * base.vertices[kept], "f": faces, "parents": parents, "J": UNIT * np.array(heads),
        **_sparse(rig, weights, order, kept, len(base.vertices)), "joint_names": np.array(order), "units": "m", "up": "y",
    }  # fmt: skip
    if base.uv is not None and face_uv is not None and (face_uv >= 0).all():
        fields |= {"uv": base.uv, "f_uv": face_uv}
    return "MakeHuman", fields | joint_keypoints(order)


def _base_mesh(rig: Path) -> Path:
    found = next((rig.parent / place for place in PLACES if (rig.parent / place).is_file()), None)
    if found is None:
        raise UserError(f"{rig}: no base.obj beside it nor in ../../3dobjs: name the mesh by --mesh")
    return found


def _document(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(read_bytes(path, BYTES))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not JSON: {reason_of(error)}") from None
    if not isinstance(found, dict):
        raise UserError(f"{path}: expected an object")
    return found


def _bones(rig: Path) -> dict[str, Any]:
    """{bone: its description}; newer rigs hold them in `bones`."""
    found = _document(rig)
    bones = found.get("bones", found)
    if not isinstance(bones, dict) or not bones or not all(isinstance(b, dict) and "head" in b for b in bones.values()):
        raise UserError(f"{rig}: bones: expected an object of bones, each with a head: not a rig of MakeHuman's")
    return bones


def _tree(rig: Path, bones: dict[str, Any]) -> tuple[list[str], Any]:
    """The bones, each after its parent, and the parents (K,) in that order."""
    names = list(bones)
    parents = [str(bone.get("parent") or "") for bone in bones.values()]
    strange = next((k for k, parent in enumerate(parents) if parent and parent not in bones), None)
    if strange is not None:
        raise UserError(f"{rig}: bones.{names[strange]}.parent: there is no bone {parents[strange]!r}")
    tree = parents_first([names.index(parent) if parent else -1 for parent in parents])
    if tree is None:
        raise UserError(f"{rig}: bones: a bone is its own ancestor")
    return [names[k] for k in tree[0]], tree[1]


def _weights(rig: Path) -> dict[str, Any]:
    """{bone: [[vertex, weight], ...]} of the file that belongs to the rig."""
    path = rig.with_name("weights." + rig.name.removeprefix("rig."))
    if not rig.name.startswith("rig.") or not path.is_file():
        raise UserError(f"{rig}: its weights, {path.name}, are not beside it")
    weights = _document(path).get("weights")
    if not isinstance(weights, dict):
        raise UserError(f"{path}: weights: expected an object, a list of [vertex, weight] a bone")
    return weights


def _groups(path: Path) -> dict[str, Any]:
    """Vertices (k,) of each group `g` of an OBJ, ascending."""
    found: dict[str, set[int]] = {}
    group = ""
    for line in read_bytes(path, OBJ_BYTES).decode(errors="replace").splitlines():
        if line.startswith("g "):
            group = line[2:].strip()
        elif line.startswith("f "):
            found.setdefault(group, set()).update(int(word.partition("/")[0]) - 1 for word in line.split()[1:])
    if any(min(vertices) < 0 for vertices in found.values()):
        raise UserError(f"{path}: f: vertices counted from the end, as MakeHuman's base mesh has none")
    return {name: np.array(sorted(vertices)) for name, vertices in found.items()}


def _head(rig: Path, name: str, bone: dict[str, Any], base: Mesh, mesh: Path, groups: dict[str, Any]) -> Floats:
    """Where a bone begins (3,), in the mesh's unit."""
    head = bone["head"]
    strategy = head.get("strategy") if isinstance(head, dict) else None
    if strategy == "CUBE":
        at = groups.get(str(head.get("cube_name")))
        if at is None:
            raise UserError(f"{rig}: bones.{name}.head.cube_name: {mesh} has no group {head.get('cube_name')!r}")
    elif strategy in ("MEAN", "VERTEX"):
        key = "vertex_indices" if strategy == "MEAN" else "vertex_index"
        at = np.atleast_1d(np.array(head.get(key, ())))
        if at.ndim != 1 or not len(at) or at.dtype.kind not in "iu" or at.min() < 0 or at.max() >= len(base.vertices):
            raise UserError(
                f"{rig}: bones.{name}.head.{key}: expected vertices of {mesh}, which has {len(base.vertices)}"
            )
    else:
        raise UserError(f"{rig}: bones.{name}.head.strategy: {strategy!r}, expected CUBE, MEAN or VERTEX")
    return base.vertices[at].mean(0)


def _body(base: Mesh, vertices: Any) -> tuple[Any, Any, Any]:
    """The body's vertices (n,) of the mesh's, its faces (m,3) over them, and the faces' UVs."""
    new = np.full(len(base.vertices), -1)
    new[vertices] = np.arange(len(vertices))
    own = (new[base.faces] >= 0).all(1)
    return vertices, new[base.faces[own]], None if base.face_uv is None else base.face_uv[own]


def _sparse(rig: Path, weights: dict[str, Any], order: list[str], kept: Any, count: int) -> dict[str, Any]:
    """`weights_idx`, `weights_val` (n,B) of the kept vertices, normalised."""
    from scipy.sparse import coo_array

    rows, columns, values = [], [], []
    for bone, pairs in weights.items():
        if bone not in order:
            raise UserError(f"{rig}: weights of {bone}: the rig has no such bone")
        table = _pairs(rig, bone, pairs, count)
        rows.append(table[:, 0].astype(int))
        columns.append(np.full(len(table), order.index(bone)))
        values.append(table[:, 1])
    at = tuple(map(np.concatenate, (rows, columns)))
    dense = coo_array((np.concatenate(values), at), shape=(count, len(order))).toarray()[kept]
    total = dense.sum(1)
    if (total <= 0).any():
        raise UserError(f"{rig}: vertex {kept[int(total.argmin())]} of the body has no weights")
    most = int((dense > 0).sum(1).max())
    idx = np.argsort(-dense, axis=1, kind="stable")[:, :most]
    return {"weights_idx": idx, "weights_val": np.take_along_axis(dense, idx, 1) / total[:, None]}


def _pairs(rig: Path, bone: str, pairs: Any, count: int) -> Floats:
    """A bone's vertices and weights (k,2)."""
    try:
        table = np.array(pairs or np.zeros((0, 2)), float)
    except (TypeError, ValueError):
        table = np.zeros(0)
    sound = table.ndim == 2 and table.shape[1] == 2 and np.isfinite(table).all() and (table >= 0).all()
    if not sound or table[:, 0].max(initial=0) >= count:
        raise UserError(f"{rig}: weights of {bone}: expected [vertex, weight] with vertices of the mesh ({count})")
    return table
