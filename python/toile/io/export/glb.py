"""glTF 2.0 binary through pygltflib: metres, y up, seconds from the clip's first frame.

A vertex with several UVs stands several times: the first n vertices of a mesh are the layer's in its order (`extras.vertices`
says n), those after repeat some of them on seams. With `points` every frame but the first is a morph target; with
`skeleton` a rest surface is moved by the four heaviest joints of each vertex, as many as every reader must know.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import UserError
from ...kernels import vertex_normals
from ...kernels.arrays import Anything, Floats
from ..bounded import read_bytes
from .clip import Clip, ClipLayer, ClipSkeleton, fewer, rest_surface
from .usd import GREYS, deviation_line

FLOAT, UINT, UBYTE, USHORT = 5126, 5125, 5121, 5123
KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963  # what a buffer view is for
INFLUENCES = 4
PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
LARGEST = 2**32 - 1  # bytes that the format can count
PICTURE_BYTES = 256 << 20


@dataclass(frozen=True)
class SplitLayer:
    """A layer whose every vertex has one UV."""

    vertex: Anything  # (q,) of the layer; the first n count up
    uv: Floats | None  # (q,2) v down
    faces: Anything  # (m,3) into these


class Builder:
    """The file as it grows: its tables, and its one buffer."""

    def __init__(self) -> None:
        try:
            import pygltflib
        except ImportError:
            raise UserError("--format glb: pygltflib is not installed: pip install 'toile[export]'") from None
        self.lib = pygltflib
        self.gltf = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0", generator="toile"))
        self.parts: list[bytes] = []
        self.length = 0

    def view(self, data: bytes, target: int | None = None) -> int:
        """The index of a new buffer view."""
        self.gltf.bufferViews.append(
            self.lib.BufferView(buffer=0, byteOffset=self.length, byteLength=len(data), target=target)
        )
        padded = data + bytes(-len(data) % 4)
        self.parts.append(padded)
        self.length += len(padded)
        if self.length > LARGEST - (1 << 20):
            raise UserError("--format glb: more than 4 GB: fewer --frames, or --motion skeleton")
        return len(self.gltf.bufferViews) - 1

    def accessor(self, array: Anything, kind: int = FLOAT, target: int | None = None, bounds: bool = False) -> int:
        """The index of a new accessor of (count,) or (count,width); `bounds`: with the least and largest of each column."""
        dtype = {FLOAT: np.float32, UINT: np.uint32, UBYTE: np.uint8, USHORT: np.uint16}[kind]
        array = np.ascontiguousarray(array, dtype)
        width = array.shape[1] if array.ndim == 2 else 1
        rows = array.reshape(len(array), width)
        found = self.lib.Accessor(
            bufferView=self.view(array.tobytes(), target), componentType=kind, count=len(array), type=KINDS[width]
        )
        if bounds:
            found.min, found.max = rows.min(0).tolist(), rows.max(0).tolist()
        self.gltf.accessors.append(found)
        return len(self.gltf.accessors) - 1

    def node(self, **fields: Any) -> int:
        self.gltf.nodes.append(self.lib.Node(**fields))
        return len(self.gltf.nodes) - 1

    def save(self, path: Path) -> None:
        self.gltf.buffers = [self.lib.Buffer(byteLength=self.length)]
        self.gltf.set_binary_blob(b"".join(self.parts))
        self.gltf.save_binary(str(path))


def write_glb(clip: Clip, path: Path, motion: str, progress: Callable[..., None]) -> list[str]:
    """Writes the file; returns how far layers that the skeleton moves lie from the registered ones."""
    clip, builder, notes = clip.with_y_up(), Builder(), []
    lib, gltf = builder.lib, builder.gltf
    start = clip.frames[0]
    times = builder.accessor((np.array(clip.frames) - start) / clip.fps, bounds=True)
    animation = lib.Animation(name=clip.name)
    roots = []
    if motion == "skeleton":
        assert clip.skeleton is not None
        roots.append(add_skeleton(builder, clip, clip.skeleton, times, animation))
    for i, layer in enumerate(clip.layers):
        n = len(layer.at(start))
        split = split_layer(layer, n)
        if motion == "skeleton":
            primitive, note = skinned(builder, clip, fewer(layer, INFLUENCES), split)
            notes.append(note)
        else:
            primitive = morphed(builder, clip, layer, split, progress, i)
        primitive.indices = builder.accessor(split.faces.ravel(), UINT, INDICES)
        primitive.material = add_material(builder, layer, i)
        mesh = lib.Mesh(name=layer.name, primitives=[primitive], extras={"vertices": n})
        moved = motion == "points" and len(clip.frames) > 1
        mesh.weights = [0.0] * (len(clip.frames) - 1) if moved else None
        gltf.meshes.append(mesh)
        skin = 0 if motion == "skeleton" else None
        roots.append(builder.node(name=layer.name, mesh=len(gltf.meshes) - 1, skin=skin))
        if moved:
            output = builder.accessor(np.eye(len(clip.frames))[:, 1:].ravel())
            channel(lib, animation, times, output, roots[-1], "weights")
    if animation.channels:
        gltf.animations.append(animation)
    gltf.scenes, gltf.scene = [lib.Scene(nodes=roots)], 0
    gltf.extras = {"first_frame": start, "fps": clip.fps}
    builder.save(path)
    return notes


def split_layer(layer: ClipLayer, n: int) -> SplitLayer:
    """Each of n vertices' first UV at its own place, its others after all vertices."""
    faces = np.asarray(layer.faces)
    if layer.uv is None or layer.face_uv is None:
        return SplitLayer(np.arange(n), None, faces)
    pairs, first, back = np.unique(
        np.stack([faces.ravel(), np.asarray(layer.face_uv).ravel()], 1), axis=0, return_index=True, return_inverse=True
    )
    by_use = np.argsort(first)  # pairs in the order in which faces name them
    _, leading = np.unique(pairs[by_use, 0], return_index=True)
    lead, rest = by_use[leading], np.delete(by_use, leading)
    place = np.empty(len(pairs), np.int64)
    place[lead] = pairs[lead, 0]
    place[rest] = n + np.arange(len(rest))
    vertex, uv = np.arange(n + len(rest)), np.zeros((n + len(rest), 2))
    vertex[n:] = pairs[rest, 0]
    uv[place] = np.asarray(layer.uv)[pairs[:, 1]] * [1, -1] + [0, 1]
    return SplitLayer(vertex, uv, place[np.ravel(back)].reshape(-1, 3))


def attributes(builder: Builder, layer: ClipLayer, split: SplitLayer, V: Anything) -> Any:
    """The primitive of vertices V with normals and UVs."""
    found = builder.lib.Attributes(
        POSITION=builder.accessor(V[split.vertex], target=VERTICES, bounds=True),
        NORMAL=builder.accessor(normals(layer, V)[split.vertex], target=VERTICES),
    )
    if split.uv is not None:
        found.TEXCOORD_0 = builder.accessor(split.uv, target=VERTICES)
    return builder.lib.Primitive(attributes=found, mode=4)


def normals(layer: ClipLayer, V: Anything) -> Floats:
    """Unit normals (n,3); those of vertices without faces point upwards."""
    N = vertex_normals(np.ascontiguousarray(V, np.float64), np.ascontiguousarray(layer.faces, np.int32))
    length = np.linalg.norm(N, axis=1, keepdims=True)
    unit: Floats = np.where(length > 0.5, N / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])
    return unit


def morphed(
    builder: Builder, clip: Clip, layer: ClipLayer, split: SplitLayer, progress: Callable[..., None], i: int
) -> Any:
    """The first frame's vertices, and each other frame's as a morph target."""
    # as rounded, so that what is added leads back to the frame
    first = layer.at(clip.frames[0]).astype(np.float32).astype(np.float64)
    primitive, at_first = attributes(builder, layer, split, first), normals(layer, first)
    for k, frame in enumerate(clip.frames[1:]):
        V = layer.at(frame)
        target = {
            "POSITION": builder.accessor((V - first)[split.vertex], target=VERTICES, bounds=True),
            "NORMAL": builder.accessor((normals(layer, V) - at_first)[split.vertex], target=VERTICES),
        }
        primitive.targets = [*(primitive.targets or []), builder.lib.Attributes(**target)]
        progress("export", i * len(clip.frames) + k + 2, len(clip.layers) * len(clip.frames))
    return primitive


def skinned(builder: Builder, clip: Clip, layer: ClipLayer, split: SplitLayer) -> tuple[Any, str]:
    """The rest surface with its joints and weights, and how far that lies from the layer."""
    assert clip.skeleton is not None and layer.joints is not None and layer.weights is not None
    rest, off = rest_surface(clip, layer)
    primitive = attributes(builder, layer, split, rest)
    weights = np.zeros((len(layer.weights), INFLUENCES), np.float32)
    joints = np.zeros(weights.shape, np.int64)
    weights[:, : layer.weights.shape[1]] = layer.weights
    joints[:, : layer.joints.shape[1]] = np.where(layer.weights > 0, layer.joints, 0)
    weights /= weights.sum(1, keepdims=True)
    kind = UBYTE if len(clip.skeleton.names) <= 256 else USHORT
    primitive.attributes.JOINTS_0 = builder.accessor(joints[split.vertex], kind, VERTICES)
    primitive.attributes.WEIGHTS_0 = builder.accessor(weights[split.vertex], target=VERTICES)
    return primitive, deviation_line(layer, off)


def add_skeleton(builder: Builder, clip: Clip, skeleton: ClipSkeleton, times: int, animation: Any) -> int:
    """Nodes of the joints, their skin and their motion; returns the root's node."""
    from scipy.spatial.transform import Rotation

    first, count = len(builder.gltf.nodes), len(skeleton.names)
    for k, name in enumerate(skeleton.names):
        below = [first + c for c, parent in enumerate(skeleton.parents) if parent == k]
        builder.node(name=name, translation=skeleton.offsets[k].tolist(), children=below)
    inverse = np.tile(np.eye(4), (count, 1, 1))
    inverse[:, 3, :3] = -np.asarray(skeleton.J)  # columns after one another
    matrices = builder.accessor(inverse.reshape(count, 16))
    joints = [first + k for k in range(count)]
    builder.gltf.skins.append(builder.lib.Skin(inverseBindMatrices=matrices, joints=joints, skeleton=first))
    poses = [skeleton.pose(frame) for frame in clip.frames]
    shift = skeleton.offsets[0] + np.array([translation for _, translation in poses])
    channel(builder.lib, animation, times, builder.accessor(shift), first, "translation")
    turns = np.array([rotations for rotations, _ in poses])
    for k in np.flatnonzero(np.any(turns != 0, axis=(0, 2))):
        quaternions = Rotation.from_rotvec(turns[:, k]).as_quat()
        channel(builder.lib, animation, times, builder.accessor(continuous(quaternions)), first + int(k), "rotation")
    return first


def continuous(quaternions: Floats) -> Floats:
    """The same turns (T,4), each with the sign that is nearer to the one before."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.concatenate([[1.0], np.where(np.cumsum(flips) % 2, -1.0, 1.0)])
    return quaternions * signs[:, None]


def channel(lib: Any, animation: Any, times: int, output: int, node: int, path: str) -> None:
    """Adds a motion of a node to the animation, linear between frames."""
    animation.samplers.append(lib.AnimationSampler(input=times, output=output, interpolation="LINEAR"))
    target = lib.AnimationChannelTarget(node=node, path=path)
    animation.channels.append(lib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))


def add_material(builder: Builder, layer: ClipLayer, i: int) -> int:
    """A rough, two-sided material: the layer's picture, which goes into the file, or a grey."""
    lib, gltf = builder.lib, builder.gltf
    rough = lib.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=1.0)
    if layer.texture is None:
        rough.baseColorFactor = [GREYS[i % len(GREYS)]] * 3 + [1.0]
    else:
        data, kind = read_bytes(layer.texture, PICTURE_BYTES), PICTURES[layer.texture.suffix.lower()]
        gltf.images.append(lib.Image(bufferView=builder.view(data), mimeType=kind, name=layer.name))
        gltf.samplers = gltf.samplers or [lib.Sampler()]
        gltf.textures.append(lib.Texture(source=len(gltf.images) - 1, sampler=0))
        rough.baseColorTexture = lib.TextureInfo(index=len(gltf.textures) - 1)
    gltf.materials.append(lib.Material(name=layer.name, pbrMetallicRoughness=rough, doubleSided=True))
    return len(gltf.materials) - 1
