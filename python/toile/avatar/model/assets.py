"""What an avatar needs besides its weights, read from AVATAR/assets and checked field by field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from pydantic import TypeAdapter, ValidationError

from ...errors import UserError
from ...io.bounded import read_json, read_npz
from ...io.camera import first_error, read_cameras
from ...io.files import load_record
from ...scene import Scene
from ...surface.layers import Layer
from .light import SIZE, TERMS

NUMBERS, INTEGERS = "fiub", "iu"  # kinds of numpy's types


def read_assets(folder, facts):
    """The arguments of Avatar after its settings, of a folder whose AVATAR/avatar.json holds these `facts`. UserError names the file and
    the field."""
    assets = Path(folder) / "assets"
    paths = [assets / f"layer{i}.npz" for i in range(layer_count(folder, facts))]
    missing = next((path for path in paths if not path.exists()), None)
    if missing is not None:
        raise UserError(f"{missing}: the file is missing")
    maps = CheckedArrays(assets / "maps.npz", read_npz(assets / "maps.npz"))
    J = maps.get("J", (None, 3))
    parents = maps.get("parents", (len(J),), INTEGERS)
    if len(J) == 0 or parents[0] != -1 or (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, len(J))).any():
        raise UserError(f"{maps.path}: parents: each joint's must be one before it, and -1 the root's")
    layers = [_layer(path, len(J)) for path in paths]
    texture, side = {}, facts["settings"].data.texture_size
    for layer in layers:
        texture[layer.name] = maps.get(f"mean_texture.{layer.name}", (3, side, side))
    valid = {layer.name: maps.get(f"valid.{layer.name}", (side, side)) for layer in layers}
    head = maps.get("head", (), INTEGERS) if "head" in maps.values else None
    if head is not None and not 0 <= head < len(J):
        raise UserError(f"{maps.path}: head: no joint {head}")
    return {
        "layers": layers,
        "J": J,
        "parents": parents,
        "cameras": list(read_cameras(assets / "cameras.json").values()),
        "scene": _scene(assets / "scene.json"),
        "mean_texture": {name: torch.from_numpy(values) for name, values in texture.items()},
        "valid": {name: torch.from_numpy(values) for name, values in valid.items()},
        "face_mean": maps.get("face_mean", (None, 3)) if "face_mean" in maps.values else None,
        "head": None if head is None else int(head),
        "poses": {"rotations": maps.get("rotations", (None, len(J), 3))},
        **_light(maps, layers, min(side, SIZE)),
    }


def _light(maps, layers, size):
    """Of light.py, maps of `size` texels; None of an avatar whose light is not told from what it falls on."""
    if "light" not in maps.values:
        return {"light": None, "mean_light": None}
    mean = {layer.name: maps.get(f"mean_light.{layer.name}", (3, size, size)) for layer in layers}
    for name, found in mean.items():
        if found.min() <= 0:
            raise UserError(f"{maps.path}: mean_light.{name}: {found.min()}, expected positive numbers")
    return {"light": maps.get("light", (TERMS, 3)), "mean_light": mean}


def layer_count(folder, facts):
    """How many layers AVATAR/avatar.json tells of."""
    layers = facts["architecture"].get("layers")
    if not layers or not isinstance(layers, list):
        raise UserError(f"{Path(folder) / 'avatar.json'}: architecture.layers: expected the avatar's layers")
    return len(layers)


def training_poses(folder):
    """What AvatarData.poses held of the frames that an avatar was trained on."""
    path = Path(folder) / "assets" / "maps.npz"
    fields = CheckedArrays(path, read_npz(path, names=("rotations", "translation", "usual")))
    rotations = fields.get("rotations", (None, None, 3))
    return {
        "rotations": rotations,
        "translation": fields.get("translation", (len(rotations), 3)),
        "usual": fields.get("usual", ()),
    }


class CheckedArrays:
    """Arrays by name; every refusal names the file and the field."""

    def __init__(self, path, values):
        self.path, self.values = path, values

    def get(self, name, shape, kinds=NUMBERS, limit=None):
        """Finite numbers of this shape, None for any length; integers below `limit`."""
        value = self.values.get(name)
        if value is None:
            raise UserError(f"{self.path}: {name} is missing")
        value = np.asarray(value)
        fits = value.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, value.shape))
        if not fits or value.dtype.kind not in kinds:
            wanted = tuple("any" if n is None else n for n in shape)
            raise UserError(f"{self.path}: {name} is {value.dtype} {value.shape}, expected numbers {wanted}")
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise UserError(f"{self.path}: {name} is not finite")
        if limit is not None and value.size and not (value.min() >= 0 and value.max() < limit):
            raise UserError(f"{self.path}: {name}: {value.min()} to {value.max()}, expected 0 to {limit - 1}")
        return value


def _layer(path, joints):
    layer = load_record(path, Layer)
    fields = CheckedArrays(path, vars(layer))
    if layer.kind not in ("body", "garment", "surface") or not isinstance(layer.name, str):
        raise UserError(f"{path}: kind: {layer.kind!r}, expected body, garment or surface")
    n, t = len(fields.get("rest", (None, 3))), len(fields.get("uv", (None, 2)))
    faces = fields.get("faces", (None, 3), INTEGERS, n)
    fields.get("face_uv", faces.shape, INTEGERS, t)
    weights = fields.get("skin_val", (n, None))
    fields.get("skin_idx", weights.shape, INTEGERS, joints)
    fields.get("label", (), INTEGERS)
    if layer.modes is not None:
        fields.get("modes", (None, n, 3))
    if not isinstance(layer.loops, dict):
        raise UserError(f"{path}: loops: expected vertices by name")
    for name, loop in layer.loops.items():
        CheckedArrays(path, {f"loops.{name}": np.asarray(loop)}).get(f"loops.{name}", (None,), INTEGERS, n)
    return layer


def _scene(path):
    try:
        scene = TypeAdapter(Scene).validate_python(read_json(path, dict))
    except ValidationError as error:
        raise first_error(path, error) from None
    if not 0 < scene.fps < float("inf"):
        raise UserError(f"{path}: fps: {scene.fps}, expected a positive number")
    return scene
