"""Skinned figures of glTF 2.0 (`.glb`, `.gltf`) become a body model file: the first skin and the mesh that wears it.

Taken: positions, triangles, joints and their weights (all sets), texture coordinates, the nodes' names and tree. Vertices that
were split for their textures are joined. The rest pose is the bind pose, moved into the world as the skin's first joint is;
y is up, lengths are metres, as glTF says.

Left: materials, pictures, animations, morph targets, a shape basis (there is none). Refused: sparse accessors, buffers outside
the file's folder.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats
from .bounded import read_bytes, reason_of
from .figures import distinct, joint_keypoints, parents_first

BYTES = 1 << 30
TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
JSON, BIN = 0x4E4F534A, 0x004E4942


def gltf_fields(path: Path) -> tuple[str, dict[str, Any]]:
    """The kind of model and the fields of its body model file. UserError names the file and the field."""
    try:
        return _fields(_Gltf(path))
    except UserError:
        raise
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise UserError(f"{path}: not a glTF that can be read: {type(error).__name__}: {reason_of(error)}") from None


class _Gltf:
    """The document and its buffers."""

    def __init__(self, path: Path) -> None:
        self.path, data = path, read_bytes(path, BYTES)
        self.chunk = b""
        if data[:4] == b"glTF":
            text, self.chunk = _chunks(path, data)
        else:
            text = data
        try:
            self.tree = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise UserError(f"{path}: not glTF: {reason_of(error)}") from None
        self.buffers: dict[int, bytes] = {}

    def buffer(self, i: int) -> bytes:
        if i not in self.buffers:
            uri = self.tree["buffers"][i].get("uri")
            if uri is None:
                self.buffers[i] = self.chunk
            elif uri.startswith("data:"):
                self.buffers[i] = base64.b64decode(uri.partition(",")[2])
            elif Path(uri).name != uri:
                raise UserError(f"{self.path}: buffers.{i}.uri: {uri!r} lies outside the file's folder")
            else:
                self.buffers[i] = read_bytes(self.path.with_name(uri), BYTES)
        return self.buffers[i]

    def array(self, i: int) -> Anything:
        """(count, width) of an accessor; normalised integers as floats."""
        accessor = self.tree["accessors"][i]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise UserError(f"{self.path}: accessors.{i}: sparse accessors are not read")
        view = self.tree["bufferViews"][accessor["bufferView"]]
        dtype, width, count = (
            np.dtype(TYPES[accessor["componentType"]]),
            WIDTHS[accessor["type"]],
            int(accessor["count"]),
        )
        stride = int(view.get("byteStride", dtype.itemsize * width))
        start = int(view.get("byteOffset", 0)) + int(accessor.get("byteOffset", 0))
        data = self.buffer(view["buffer"])
        if min(start, stride, count) < 0 or start + stride * (count - 1) + dtype.itemsize * width > len(data):
            raise UserError(
                f"{self.path}: accessors.{i}: {count} entries, more than its buffer's {len(data)} bytes hold"
            )
        rows = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize)).copy()
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(rows / np.iinfo(dtype).max, -1.0)
        return rows


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, at)
        if at + 8 + length > len(data):
            raise UserError(f"{path}: ends at byte {len(data)}, in the middle of a chunk")
        found.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    if JSON not in found:
        raise UserError(f"{path}: no document in it")
    return found[JSON], found.get(BIN, b"")


def _fields(file: _Gltf) -> tuple[str, dict[str, Any]]:
    nodes, skins = file.tree.get("nodes", []), file.tree.get("skins", [])
    wearer = next((node for node in nodes if node.get("skin") == 0 and "mesh" in node), None)
    if not skins or wearer is None:
        raise UserError(f"{file.path}: skins: no mesh with a skin: not a rigged figure")
    joints = list(skins[0]["joints"])
    order, parents = _tree(file.path, nodes, joints)
    bind = file.array(skins[0]["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2).astype(float)
    place = np.linalg.inv(bind)[:, :3, 3]
    world = _world(nodes, joints[order[0]]) @ bind[order[0]]  # mesh to world, at the first joint
    mesh = _mesh(file, file.tree["meshes"][wearer["mesh"]], len(joints))
    rank = np.argsort(order)
    names = distinct([str(nodes[joints[k]].get("name", f"joint{k}")) for k in order])
    fields = {
        "v_template": _moved(world, mesh["v"]), "f": mesh["f"], "parents": parents, "J": _moved(world, place[order]),
        "weights_idx": rank[mesh["joints"]], "weights_val": mesh["weights"], "joint_names": np.array(names), "units": "m",
        "up": "y",
    }  # fmt: skip
    if mesh["uv"] is not None:
        fields |= {"uv": mesh["uv"], "f_uv": mesh["f_uv"]}
    return "glTF", fields | joint_keypoints(names)


def _tree(path: Path, nodes: list[Any], joints: list[int]) -> tuple[list[int], Any]:
    """Joints in an order in which each comes after its parent, and the parents (K,) in it; further roots hang on the first."""
    above = {child: i for i, node in enumerate(nodes) for child in node.get("children", ())}
    rank = {node: k for k, node in enumerate(joints)}

    def parent(k: int) -> int:
        node, steps = above.get(joints[k]), 0
        while node is not None and node not in rank:
            node, steps = above.get(node), steps + 1
            if steps > len(nodes):
                raise UserError(f"{path}: nodes: a node is its own ancestor")
        return -1 if node is None else rank[node]

    over = [parent(k) for k in range(len(joints))]
    tree = parents_first(over)
    if tree is None:
        raise UserError(f"{path}: nodes: a joint is its own ancestor")
    return tree


def _world(nodes: list[Any], node: int | None) -> Floats:
    """(4,4) of a node in the world."""
    above = {child: i for i, n in enumerate(nodes) for child in n.get("children", ())}
    T, steps = np.eye(4), 0
    while node is not None and steps <= len(nodes):
        T, node, steps = _local(nodes[node]) @ T, above.get(node), steps + 1
    return T


def _local(node: dict[str, Any]) -> Floats:
    from scipy.spatial.transform import Rotation

    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix() * np.array(
        node.get("scale", (1, 1, 1))
    )
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def _moved(T: Floats, points: Floats) -> Floats:
    return points @ T[:3, :3].T + T[:3, 3]


def _mesh(file: _Gltf, mesh: dict[str, Any], count: int) -> dict[str, Any]:
    """Vertices, faces, joints (n,B), weights (n,B), UVs of all its triangles, vertices of one place and weights joined."""
    V, F, I, W, UV, start = [], [], [], [], [], 0
    for i, part in enumerate(mesh["primitives"]):
        if part.get("mode", TRIANGLES) != TRIANGLES:
            raise UserError(f"{file.path}: primitives.{i}: only triangles are read")
        has, sets = part["attributes"], [k for k in range(4) if f"JOINTS_{k}" in part["attributes"]]
        V.append(file.array(has["POSITION"]).astype(float))
        I.append(np.concatenate([file.array(has[f"JOINTS_{k}"]) for k in sets], axis=1).astype(np.int64))
        W.append(np.concatenate([file.array(has[f"WEIGHTS_{k}"]) for k in sets], axis=1).astype(float))
        UV.append(file.array(has["TEXCOORD_0"]).astype(float) if "TEXCOORD_0" in has else None)
        rows = file.array(part["indices"]) if "indices" in part else np.arange(len(V[-1]))
        F.append(rows.reshape(-1, 3).astype(np.int64) + start)
        start += len(V[-1])
    wide = max(weights.shape[1] for weights in W)
    padded = lambda arrays: np.concatenate([np.pad(a, ((0, 0), (0, wide - a.shape[1]))) for a in arrays])
    v, f, idx, val = np.concatenate(V), np.concatenate(F), padded(I), padded(W)
    idx = np.where(val > 0, idx, 0)
    if idx.max(initial=0) >= count or f.max(initial=0) >= len(v):
        raise UserError(f"{file.path}: a face or weight names a vertex or joint that is not there")
    _, first, back = np.unique(np.c_[v, idx, val], axis=0, return_index=True, return_inverse=True)
    keep = np.sort(first)  # in the file's order
    new = np.argsort(np.argsort(first))[np.ravel(back)]
    total = val[keep].sum(1, keepdims=True)
    if (total <= 0).any():
        raise UserError(f"{file.path}: vertex {keep[int(total.argmin())]} has no weights")
    mapped = [part for part in UV if part is not None]
    uv = np.concatenate(mapped) * [1, -1] + [0, 1] if len(mapped) == len(UV) else None  # v upwards here
    return {"v": v[keep], "f": new[f], "joints": idx[keep], "weights": val[keep] / total, "uv": uv, "f_uv": f}
