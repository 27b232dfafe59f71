"""SMPL, SMPL-H and SMPL-X as they are distributed (`.pkl`, `.npz`) become a body model file.

Taken: `v_template`, `f`, `kintree_table`, `weights`, `J_regressor` (applied: joints and how they follow the shape),
`shapedirs` (the first of the shape, whose coefficients have unit variance), `vt` and `ft`. Joints, keypoints and segments are
named; y is up, lengths are metres.

Left: `posedirs` (the pose's correctives, which are not supported), expressions, hands' principal components.
Nothing of a pickle is run, see pickles.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Floats
from .bounded import read_npz
from .calibration.checked import numbers
from .pickles import plain, read_pickle

NEEDED = ("v_template", "f", "kintree_table", "weights", "J_regressor", "shapedirs")
BODY = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
    "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
FINGERS = ("index", "middle", "pinky", "ring", "thumb")  # in the models' order
HANDS = tuple(f"{side}_{finger}{i}" for side in ("left", "right") for finger in FINGERS for i in (1, 2, 3))
JOINTS = {  # by their count
    24: ("SMPL", (*BODY, "left_hand", "right_hand")),
    52: ("SMPL-H", (*BODY, *HANDS)),
    55: ("SMPL-X", (*BODY, "jaw", "left_eye_smplhf", "right_eye_smplhf", *HANDS)),
}
SHAPES = 300  # of SMPL-X's shapedirs, before the expressions
KEYPOINTS = {  # the packaged model's keypoint: joint
    "root": "pelvis", "spine05": "spine1", "spine03": "spine2", "neck01": "neck", "head": "head",
    "upperleg01": "hip", "lowerleg01": "knee", "foot": "ankle", "toe1-1": "foot", "clavicle": "collar",
    "upperarm01": "shoulder", "lowerarm01": "elbow", "wrist": "wrist",
}  # fmt: skip
# Vertices of both topologies, as smplx/vertex_ids.py of the models' authors numbers them: left, right, or the middle one.
POINTS = {
    6890: {
        "face.nose_tip": (332,), "face.ear": (583, 4071), "body.big_toe": (3216, 6617), "body.small_toe": (3226, 6624),
        "body.heel": (3387, 6787), "finger1-tip": (2746, 6191), "finger2-tip": (2319, 5782), "finger3-tip": (2445, 5905),
        "finger4-tip": (2556, 6016), "finger5-tip": (2673, 6133),
    },
    10475: {
        "face.nose_tip": (9120,), "face.ear": (6, 616), "body.big_toe": (5770, 8463), "body.small_toe": (5780, 8474),
        "body.heel": (8846, 8635), "finger1-tip": (5361, 8079), "finger2-tip": (4933, 7669), "finger3-tip": (5058, 7794),
        "finger4-tip": (5169, 7905), "finger5-tip": (5286, 8022),
    },
}  # fmt: skip
FINGER_NUMBERS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}


def smpl_fields(path: Path, shapes: int) -> tuple[str, dict[str, Any]]:
    """The kind of model and the fields of its body model file."""
    given = _read(path)
    v = numbers(path, "v_template", given["v_template"], (_rows(given, "v_template"), 3))
    n = len(v)
    tree = given["kintree_table"]
    if tree.ndim != 2 or tree.shape[0] != 2 or tree.shape[1] not in JOINTS or tree.dtype.kind not in "iu":
        raise UserError(
            f"{path}: kintree_table: {tree.dtype} {tree.shape}, expected (2, K) with K = 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X)"
        )
    kind, names = JOINTS[tree.shape[1]]
    parents = tree[0].astype(np.int64)
    parents[0] = -1  # stored as 2^32 - 1
    regressor = numbers(path, "J_regressor", given["J_regressor"], (len(names), n))
    basis = numbers(path, "shapedirs", given["shapedirs"], (n, 3, given["shapedirs"].size // max(3 * n, 1)))
    basis = basis[..., : min(shapes, SHAPES, basis.shape[2])]
    weights = numbers(path, "weights", given["weights"], (n, len(names)))
    fields = {
        "v_template": v, "f": given["f"].astype(np.int64), "parents": parents, "J": regressor @ v, "weights": weights,
        "shapedirs": basis, "J_shapedirs": np.einsum("kn,nis->kis", regressor, basis),
        "joint_names": np.array(names), "units": "m", "up": "y",
    }  # fmt: skip
    if "vt" in given and "ft" in given:
        fields |= {"uv": given["vt"], "f_uv": given["ft"].astype(np.int64)}
    return kind, fields | _keypoints(names, n) | _segments(names, parents, weights)


def _read(path: Path) -> dict[str, Any]:
    wanted = (*NEEDED, "vt", "ft")
    if path.suffix.lower() == ".npz":
        given = dict(read_npz(path, names=set(wanted)))
    else:
        found = read_pickle(path, dict)
        given = {name: plain(path, name, found[name]) for name in wanted if found.get(name) is not None}
    missing = [name for name in NEEDED if name not in given]
    if missing:
        raise UserError(f"{path}: {missing[0]} is missing: not a model of SMPL's kind")
    return given


def _rows(given: dict[str, Any], name: str) -> int:
    return len(given[name]) if given[name].ndim else 0


def _keypoints(names: tuple[str, ...], n: int) -> dict[str, Any]:
    """Keypoints by the packaged model's names: joints, and on the known topologies vertices."""
    joint, vertex = {}, {}
    for word, of in KEYPOINTS.items():
        sided = {f"body.{word}.{s[0].upper()}": f"{s}_{of}" for s in ("left", "right")}
        for name, there in ({f"body.{word}": of} if of in names else sided).items():
            joint[name] = names.index(there)
    for side in ("left", "right"):
        for finger, i in FINGER_NUMBERS.items():
            for k in (1, 2, 3):
                if f"{side}_{finger}{k}" in names:
                    joint[f"hand_{side}.finger{i}-{k}.{side[0].upper()}"] = names.index(f"{side}_{finger}{k}")
    for word, at in POINTS.get(n, {}).items():
        for index, side in zip(at, ("left", "right")):
            name = word if len(at) == 1 else f"{word}.{side[0].upper()}"
            vertex[f"hand_{side}.{name}" if word.startswith("finger") else name] = index
    found = [*joint, *vertex]
    return {
        "keypoint_names": np.array(found), "keypoint_joint": np.array([joint.get(name, -1) for name in found]),
        "keypoint_vertices": np.array(list(vertex.values()), np.int64),
        "keypoint_starts": np.concatenate([np.zeros(len(joint), int), np.arange(len(vertex) + 1)]),
    }  # fmt: skip


def _segments(names: tuple[str, ...], parents: Any, weights: Floats) -> dict[str, Any]:
    """Hands (what moves beyond the wrist) and, where the model has such joints, eyes."""
    owner = weights.argmax(1)
    lists = {}
    for name, wrist in (("hand_left", "left_wrist"), ("hand_right", "right_wrist")):
        tree = [names.index(wrist)]
        for k, parent in enumerate(parents):
            if parent in tree:
                tree.append(k)
        lists[name] = np.flatnonzero(np.isin(owner, tree[1:]))
    lists["eyes"] = np.flatnonzero(np.isin(owner, [k for k, name in enumerate(names) if "eye" in name]))
    lists = {name: vertices for name, vertices in lists.items() if len(vertices)}
    starts = np.cumsum([0, *(len(vertices) for vertices in lists.values())])
    joined = np.concatenate([*lists.values(), np.zeros(0, np.int64)]).astype(np.int64)
    return {"segment_names": np.array(list(lists), "U16"), "segment_vertices": joined, "segment_starts": starts}
