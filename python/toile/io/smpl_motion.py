"""Motions of the SMPL family: `.npz` files with `poses` and `trans` as AMASS has them become figures that are retargeted as those of
BVH files are.

A pose is a rotation vector a joint, relative to the joint above, about the axes of the body at rest: x left, y up, z front. The
root's leads from these to the world, whose up is z in AMASS. Not used: shapes (`betas`), which is said; not read: soft tissue (`dmpls`), expressions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Anything, Floats
from ..scene import BodyModel
from .retargeting import BONES, MIDDLE, SIDED, UPRIGHT, MovingFigure, rest_places, retarget, shortest, stance_of_figure
from .smpl import BODY, FINGER_NUMBERS, JOINTS
from .smpl_rest import KINDS, names_of, offsets_of, parents_of
from .strays import angles

PARTS = ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")  # in the order of `poses`
PART_WIDTHS = (3, 63, 3, 6, 90)
RATES = ("mocap_framerate", "mocap_frame_rate")
FIELDS = ("poses", "trans", "betas", "surface_model_type", *RATES, *PARTS)
SPINE = {"spine1": "spine04", "spine2": "spine03", "spine3": "spine02"}
WORDS = {  # of either side
    "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "foot": "toe1-1", "collar": "clavicle",
    "shoulder": "upperarm01", "elbow": "lowerarm01", "hand": "hand", "eye_smplhf": "eye",
    **{f"{finger}{i}": f"finger{n}-{i}" for finger, n in FINGER_NUMBERS.items() for i in (1, 2, 3)},
}  # fmt: skip
LAST = {
    "toe1-1": "toes",
    "hand": "hands",
    "jaw": "the jaw",
    "eye": "eyes",
}  # what other joints turn goes on to those below
LAST |= {role: "fingers" for role in WORDS.values() if role.startswith("finger")}
SAME = 15.0  # degrees between limbs at rest up to which a body stands as the mean shape does
ENDS = {
    "wrist": "lowerarm01",
    "hand": "lowerarm01",
}  # see `retarget`: not feet, whose soles lie flat at rest here as in bodies
TURNED = np.radians(5)  # of a joint that is not followed, beyond which that is told
Y_UP = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])}  # a world's axes to x left, y up, z front


@dataclass(frozen=True)
class SmplMotion:
    """What a file holds, its numbers as they are given."""

    kind: str  # smpl, smplh or smplx, whose rest its joints have
    names: tuple[str, ...]
    rotations: Floats  # (T,j,3) [rad]
    trans: Floats  # (T,3) [m]
    fps: float
    up: str | None  # y or z where the file says it
    shaped: bool  # whether it tells of another shape than the mean one


def is_smpl(fields: dict[str, Anything]) -> bool:
    """Whether a .npz holds poses of the SMPL family."""
    return "poses" in fields or {"root_orient", "pose_body"} <= fields.keys()


def smpl_motion(path: Path, fields: dict[str, Anything]) -> SmplMotion:
    """Of the fields of a .npz. UserError names the file and the field."""
    if "trans" not in fields:
        raise UserError(f"{path}: trans is missing")
    fps, up = _rate(path, fields), fields.get("up")
    if up is not None and str(up) not in Y_UP:
        raise UserError(f"{path}: up is {up}, expected y or z")
    given = _numbers(path, fields)
    count = len(given["trans"])
    lengths = {name: len(values) for name, values in given.items()}
    for name, length in lengths.items():
        if length != count or not count:
            raise UserError(f"{path}: {name} has {length} frames, trans {count}, expected as many, and one at least")
    kind, names = _kind(path, fields, given)
    poses = given["poses"] if "poses" in given else _joined(given, len(names))
    vectors = poses.reshape(count, len(names), 3)
    betas = fields.get("betas", np.zeros(0))
    shaped = betas.dtype.kind in "fiu" and bool(np.any(betas))
    return SmplMotion(kind, names, vectors, given["trans"], fps, None if up is None else str(up), shaped)


def _rate(path: Path, fields: dict[str, Anything]) -> float:
    """Frames a second by whichever of both fields there is."""
    found = {name: fields[name] for name in RATES if name in fields}
    if not found:
        raise UserError(f"{path}: {RATES[0]} is missing, and so is {RATES[1]}: nothing tells how fast it is played")
    for name, value in found.items():
        if value.size != 1 or value.dtype.kind not in "fiu" or not 0 < float(value.reshape(())) <= 10_000:
            words = f"{value.reshape(-1)[0]}" if value.size == 1 else f"{value.dtype} {value.shape}"
            raise UserError(f"{path}: {name} is {words}, expected one rate above 0, up to 10000")
    rates = [float(value.reshape(())) for value in found.values()]
    if rates[0] != rates[-1]:
        raise UserError(f"{path}: {RATES[0]} is {rates[0]:g}, {RATES[1]} {rates[-1]:g}: they have to agree")
    return rates[0]


def _numbers(path: Path, fields: dict[str, Anything]) -> dict[str, Floats]:
    """The poses, their parts and the places as (T,n) finite numbers of widths that there are."""
    widths: dict[str, Any] = {name: (width,) for name, width in zip(PARTS, PART_WIDTHS)}
    widths |= {"poses": (66, *(3 * count for count in KINDS.values())), "trans": (3,)}
    given = {}
    for name in ("trans", "poses", *PARTS):
        if name not in fields:
            continue
        value = fields[name]
        if value.ndim != 2 or value.shape[1] not in widths[name] or value.dtype.kind not in "fiu":
            expected = " or ".join(f"(T,{width})" for width in widths[name])
            raise UserError(f"{path}: {name} is {value.dtype} {value.shape}, expected numbers {expected}")
        if not np.isfinite(value).all():
            row = int(np.flatnonzero(~np.isfinite(value).all(1))[0])
            raise UserError(f"{path}: {name} is not finite in frame {row}")
        given[name] = value.astype(np.float64)
    return given


def _kind(path: Path, fields: dict[str, Anything], given: dict[str, Floats]) -> tuple[str, tuple[str, ...]]:
    """Whose joints they are, told by `surface_model_type` or by how many there are, and their names."""
    said = fields.get("surface_model_type")
    said = None if said is None else said.item() if said.size == 1 else str(said.dtype)
    said = said.decode(errors="replace") if isinstance(said, bytes) else said
    if said is not None and said not in KINDS:
        raise UserError(f"{path}: surface_model_type is {said}, expected {', '.join(KINDS)}")
    if "poses" not in given:
        kind = said or ("smplx" if {"pose_jaw", "pose_eye"} & given.keys() else None)
        count = (KINDS["smplx"] if kind == "smplx" else KINDS["smplh"]) if "pose_hand" in given else len(BODY)
    else:
        count = given["poses"].shape[1] // 3
        kind = said or {joints: name for name, joints in KINDS.items()}.get(count)
        _check_parts(path, given)
    if kind is None:
        raise UserError(
            f"{path}: surface_model_type is missing: of {len(BODY)} joints nothing else tells whose they are"
        )
    if count not in (len(BODY), KINDS[kind]):
        raise UserError(f"{path}: poses have {count} joints, of surface_model_type {kind} {KINDS[kind]} are expected")
    return kind, BODY if count == len(BODY) else names_of(kind)


def _check_parts(path: Path, given: dict[str, Floats]) -> None:
    """UserError: the file's parts of the poses are not those of its `poses`, and nothing tells which is meant."""
    for name, columns in (("root_orient", slice(3)), ("pose_body", slice(3, 66))):
        if name in given and not np.allclose(given[name], given["poses"][:, columns], atol=1e-4):
            raise UserError(f"{path}: poses and {name} are not of one motion: leave one of them out")


def _joined(given: dict[str, Floats], joints: int) -> Floats:
    """`poses` of their parts; 0 where a part of the face is not there."""
    count, wanted = len(given["root_orient"]), PARTS[:2] if joints == len(BODY) else PARTS
    if joints == KINDS["smplh"]:
        wanted = (*PARTS[:2], "pose_hand")
    none = {name: np.zeros((count, width)) for name, width in zip(PARTS, PART_WIDTHS)}
    return np.concatenate([given.get(name, none[name]) for name in wanted], axis=1)


def with_smpl_roles(model: BodyModel) -> BodyModel:
    """The model; where its joints are called as SMPL's, each with a role of its own, so that all of them are followed."""
    if model.joint_names not in [names for _, names in JOINTS.values()]:
        return model
    return replace(model, joint_roles=tuple(role_of(name) for name in model.joint_names))


def role_of(name: str) -> str:
    """The role of one of SMPL's joints."""
    side, _, word = name.partition("_")
    if side in ("left", "right"):
        return f"{WORDS.get(word, word)}.{side[0].upper()}"
    return {"pelvis": "root", "neck": "neck01", **SPINE}.get(name, name)


def figure_of(path: Path, motion: SmplMotion, model: BodyModel, J: Floats) -> tuple[MovingFigure, tuple[str, ...]]:
    """The motion as a figure, y up, and what a user should know of its axes. At rest it stands as the mean shape does, or as the body
    `model` with rest joints J (K,3), x left, y back, z up, where that is of the same kind: then all turns are taken as they are.
    UserError: nothing tells which axis is up."""
    from scipy.spatial.transform import Rotation

    names, parents = motion.names, parents_of(motion.names)
    mean = offsets_of(motion.kind, names)
    offsets = _rest(motion.kind, names, parents, mean, model, J)
    turns = Rotation.from_rotvec(motion.rotations.reshape(-1, 3)).as_matrix().reshape(*motion.rotations.shape, 3)
    places = np.zeros(motion.rotations.shape)
    for j, parent in enumerate(parents):
        if parent >= 0:
            places[:, j] = places[:, parent] + turns[:, parent] @ offsets[j]
            turns[:, j] = turns[:, parent] @ turns[:, j]
    up = motion.up or _up(path, places[:, names.index("neck")])
    C, roles = Y_UP[up], tuple(role_of(name) for name in names)
    places += motion.trans[:, None]
    said = () if up == "z" or motion.up else ("y is taken as the motion's axis up, as its trunk rises; AMASS's is z",)
    if motion.shaped:
        whose = "the mean shape" if offsets is mean else "the avatar itself"
        said = (*said, f"the motion's betas are not used: how far it walks is scaled as if it were of {whose}")
    return MovingFigure(names, parents, offsets, {}, C @ turns, places @ C.T, 1 / motion.fps, roles), said


def _rest(kind: str, names: Any, parents: Any, offsets: Floats, model: BodyModel, J: Floats) -> Floats:
    """(j,3) [m] from the joints above, x left, y up, z front: `offsets`, which are those of the mean shape, or those of the model."""
    own = next((k for k, (_, given) in JOINTS.items() if given == model.joint_names), None)
    if own is None or (own == KINDS["smplx"]) != (kind == "smplx"):
        return offsets
    places = np.stack([J[:, 0], J[:, 2], -J[:, 1]], axis=1)
    at = {name: k for k, name in enumerate(model.joint_names)}
    theirs = offsets.copy()
    for j, name in enumerate(names):
        if parents[j] >= 0 and name in at:
            theirs[j] = places[at[name]] - places[at[names[parents[j]]]]
    ends = [f"{role}.{side}" for role in BONES.values() for side in "LR"]
    limbs = [j for j, name in enumerate(names) if role_of(name) in ends]
    return theirs if angles(theirs[limbs], offsets[limbs]).max() <= SAME else offsets


def _up(path: Path, trunk: Floats) -> str:
    """The axis along which a trunk (T,3) rises in most frames, z or y."""
    rises = np.median(trunk / np.linalg.norm(trunk, axis=1, keepdims=True), axis=0)
    for axis in "zy":
        if rises["xyz".index(axis)] >= UPRIGHT:
            return axis
    words = "from pelvis to neck it leads in most frames neither along z, which is up in AMASS, nor along y"
    raise UserError(f'{path}: {words}: add a field up, "z" or "y", to say which is up')


def followed(figure: MovingFigure, model: BodyModel) -> tuple[dict[str, int], tuple[str, ...]]:
    """{role: index of the figure's joint} of what `retarget` takes, and what of the wanted the figure lacks. Toes are left out where
    the body has several a foot."""
    own = model.joint_roles
    several = sum(role.startswith("toe") and role.endswith(".L") for role in own) > 1
    found = {
        role: j
        for j, role in enumerate(figure.roles)
        if role in own and not role.startswith("finger") and not (several and role.startswith("toe"))
    }
    wanted = {*MIDDLE, *(f"{role}.{side}" for role in SIDED for side in "LR")}
    found |= {role: j for j, role in enumerate(figure.roles) if role in wanted}
    fingers = any(role.startswith("finger") for role in own) and not any(r.startswith("finger") for r in figure.roles)
    return found, ("fingers",) if fingers else ()


def not_followed(motion: SmplMotion, figure: MovingFigure, found: dict[str, int], model: BodyModel) -> tuple[str, ...]:
    """What a user should know of joints that turn in the motion, and in the body do not."""
    taken = {*found} | {role for side in "LR" for role in _fingers(figure.roles, model.joint_roles, side)}
    turned = np.linalg.norm(motion.rotations, axis=2).max(0) > TURNED
    left = [role.partition(".")[0] for j, role in enumerate(figure.roles) if turned[j] and role not in taken]
    named = sorted({LAST[word] for word in left if word in LAST})
    return (f"the motion turns {', '.join(named)}, which do not follow it: they rest",) if named else ()


def _fingers(theirs: tuple[str, ...], ours: tuple[str, ...], side: str) -> list[str]:
    """Roles of the fingers' joints that both skeletons have, from the wrist on; none where a palm does not tell how it lies."""
    roles = [f"finger{n}-{i}.{side}" for n in range(1, 6) for i in (1, 2, 3)]
    palm = {f"wrist.{side}", f"finger2-1.{side}", f"finger5-1.{side}"}
    return [role for role in roles if role in theirs and role in ours] if palm <= {*theirs} & {*ours} else []


def retarget_with_fingers(
    world: Floats, figure: MovingFigure, model: BodyModel, J: Floats, found: dict[str, int], lowest: float | None = None
) -> Floats:
    """`retarget`, and the fingers: seen from the palm, their bones take the figure's directions; soles lie as the figure's."""
    local = retarget(world, figure, model, J, found, lowest, ENDS)
    theirs = dict(zip(figure.roles, rest_places(figure) @ stance_of_figure(figure, found)))
    ours = dict(zip(model.joint_roles, J))
    for side in "LR":
        turns: dict[str, Floats] = {}  # of bones (T,3,3), seen from the body's palm
        roles = _fingers(figure.roles, model.joint_roles, side)
        palm = _palm(theirs, side) @ _palm(ours, side).T if roles else np.eye(3)  # the body's to the figure's
        for role in roles:
            finger, i = role[: role.index("-")], int(role[role.index("-") + 1])
            first = min(i, 2)  # the last joint's bone has no end: it is turned as the one before
            ends = f"{finger}-{first}.{side}", f"{finger}-{first + 1}.{side}"
            bones = [joints[ends[1]] - joints[ends[0]] for joints in (ours, theirs)] if {*ends} <= {*roles} else None
            rest = shortest(palm @ bones[0], bones[1]) if bones else np.eye(3)
            seen = np.swapaxes(world[:, figure.roles.index(f"wrist.{side}")], 1, 2) @ world[:, figure.roles.index(role)]
            turns[role] = palm.T @ seen @ rest @ palm
            above = turns.get(f"{finger}-{i - 1}.{side}", np.eye(3))
            local[:, model.joint(role)] = np.swapaxes(above, -1, -2) @ turns[role]
    return local


def _palm(places: dict[str, Floats], side: str) -> Floats:
    """(3,3) whose columns are a palm's axes: to the knuckles, to the index finger's side, and across both."""
    wrist, index, little = (places[f"{role}.{side}"] for role in ("wrist", "finger2-1", "finger5-1"))
    along = (index + little) / 2 - wrist
    across = np.cross(along, index - little)
    axes = np.stack([along, np.cross(across, along), across], axis=1)
    return axes / np.linalg.norm(axes, axis=0)
