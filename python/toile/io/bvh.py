"""Motion from BVH files (y up), retargeted by the roles of joints onto a body model.

It is retargeted with x left, y back, z up (`stance`), whatever the axes are in which the file and the model stand at rest.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import UserError
from .bounded import read_bytes
from .joints import joint_roles

MAX_BYTES = 200_000_000
LONGEST = 2.0  # s that a frame may last: 4 ms, a fast system's, read as seconds, are more

MIDDLE = ("root", "spine04", "spine02", "neck01", "head")  # roles (io.joints) that a file's joints are looked for in
SIDED = ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
BONES = {"upperarm01": "lowerarm01", "lowerarm01": "wrist", "upperleg01": "lowerleg01", "lowerleg01": "foot"}
LEG = ("upperleg01.L", "lowerleg01.L", "foot.L")
LEAP, LONE = np.radians(15), 3.0  # from a calibration pose: so far at least, and so many times as far as a frame later
ENDS = {"wrist": "lowerarm01", "foot": "lowerleg01"}  # end joints follow their limb


@dataclass(frozen=True)
class Bvh:
    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray  # (j,3)
    rotations: np.ndarray  # (T,j,3,3) world rotations
    root: np.ndarray  # (T,3)
    frame_time: float  # s


def read_bvh(path):
    """Parses a BVH file; UserError names the file and what is wrong."""
    path = Path(path)
    head, found, tail = read_bytes(path, MAX_BYTES).decode("utf-8", errors="replace").partition("MOTION")
    if not found or "HIERARCHY" not in head:
        raise UserError(f"{path}: not a BVH file, HIERARCHY or MOTION is missing")
    try:
        names, parents, offsets, channels = hierarchy(head.split())
        words = tail.split()
        count, frame_time = int(words[1]), float(words[4])
        values = np.array(words[5:], dtype=np.float64)
        width = sum(map(len, channels))
        if count < 1:
            raise ValueError(f"Frames: {count}")
        if not 0 < frame_time <= LONGEST:
            asked = ": it is in seconds, not in milliseconds" if frame_time > LONGEST else ""
            raise ValueError(f"Frame Time: {frame_time:g}{asked}")
        if len(values) != count * width:
            raise ValueError(f"{len(values)} numbers for {count} frames of {width} channels")
        if not np.isfinite(values).all():
            frame, channel = divmod(int(np.flatnonzero(~np.isfinite(values))[0]), width)
            raise ValueError(f"frame {frame}, channel {channel}: {values[frame * width + channel]}")
    except (ValueError, IndexError, KeyError) as reason:
        raise UserError(f"{path}: broken BVH: {reason}") from reason
    rotations, root = play(values.reshape(count, width), parents, channels)
    return Bvh(names, parents, offsets, rotations, root, frame_time)


def hierarchy(words):
    """Joint names, parents, offsets (j,3) and channel names from the HIERARCHY section."""
    names, parents, offsets, channels, stack = [], [], [], [], []
    i, ending = 0, False
    while i < len(words):
        word = words[i]
        if word in ("ROOT", "JOINT"):
            opened = words.index("{", i)
            names.append(" ".join(words[i + 1 : opened]))
            parents.append(stack[-1] if stack else -1)
            channels.append([])
            offsets.append([np.nan] * 3)
            i = opened
        elif word == "End":
            ending = True
            i += 2
        elif word == "{":
            stack.append(len(names) - 1)
            i += 1
        elif word == "}":
            stack.pop()
            ending = False
            i += 1
        elif word == "OFFSET":
            if not ending:
                offsets[stack[-1]] = [float(w) for w in words[i + 1 : i + 4]]
            i += 4
        elif word == "CHANNELS":
            n = int(words[i + 1])
            channels[-1] = words[i + 2 : i + 2 + n]
            if not all(re.fullmatch("[XYZ](position|rotation)", name) for name in channels[-1]):
                raise ValueError(f"channels {' '.join(channels[-1])[:60]}")
            i += 2 + n
        else:
            i += 1
    for name, offset in zip(names, offsets):
        if not np.isfinite(offset).all():
            raise ValueError(f"joint {name}: its OFFSET is missing or not finite")
    return tuple(names), tuple(parents), np.array(offsets), channels


def play(values, parents, channels):
    """World rotations (T,j,3,3) and root positions (T,3)."""
    from scipy.spatial.transform import Rotation

    T = len(values)
    world, root, at = np.empty((T, len(parents), 3, 3)), np.zeros((T, 3)), 0
    for j, names in enumerate(channels):
        local = np.broadcast_to(np.eye(3), (T, 3, 3))
        for name in names:
            axis = "XYZ".index(name[0].upper())
            if name.endswith("position"):
                root[:, axis] += values[:, at] * (parents[j] < 0)
            else:
                local = local @ Rotation.from_rotvec(np.radians(values[:, at, None]) * np.eye(3)[axis]).as_matrix()
            at += 1
        world[:, j] = local if parents[j] < 0 else world[:, parents[j]] @ local
    return world, root


def matches(bvh):
    """{role: index of the BVH's joint}, and the roles that the file lacks."""
    at = {role: i for i, role in reversed(list(enumerate(joint_roles(bvh.names))))}
    wanted = [*MIDDLE, *(f"{role}.{side}" for role in SIDED for side in "LR")]
    return {role: at[role] for role in wanted if role in at}, [role for role in wanted if role not in at]


def check_rest(path, bvh, found):
    """UserError: the trunk does not rise along y from the hips at rest, or a limb's bone has no length and so no direction."""
    places = rest_places(bvh)
    top = next((role for role in reversed(MIDDLE) if role in found), "root")
    rise = places[found[top]] - places[found["root"]]
    axis = np.abs(rise).argmax()
    if rise.any() and (axis != 1 or rise[1] < 0):
        along = ("-" if rise[axis] < 0 else "") + "xyz"[axis]
        names = " to ".join(bvh.names[found[role]] for role in ("root", top))
        raise UserError(f"{path}: at rest {names} leads along {along}: a BVH file is taken to be y up: write it so")
    for role in found:
        joint, dot, side = role.partition(".")
        end = f"{BONES.get(joint)}{dot}{side}"
        if end in found and np.array_equal(places[found[role]], places[found[end]]):
            raise UserError(f"{path}: the bone from {bvh.names[found[role]]} to {bvh.names[found[end]]} has no length")


def starts_at(bvh):
    """The first frame that is not a lone calibration pose: 1 where a joint leaps from frame 0 to 1 and none does so from there on."""
    if len(bvh.root) < 3:
        return 0
    leap, after = (turn(bvh.rotations[i], bvh.rotations[i + 1]).max() for i in (0, 1))
    return int(leap > max(LEAP, LONE * after))


def stance(places, up, left):
    """Rotation (3,3) that takes x left, y back, z up to the axes in which a skeleton stands at rest, `up` (0, 1, 2) its own up.

    `places` {role: (3,)} of its joints: its left is the level axis nearest to the way from those of the right to those of the
    left, or `left` (3,) where none are paired.
    """
    pairs = [role for role in SIDED if {f"{role}.L", f"{role}.R"} <= places.keys()]
    across = sum((places[f"{role}.L"] - places[f"{role}.R"] for role in pairs), np.zeros(3))
    across[up] = 0
    if across.any():
        axis = np.abs(across).argmax()
        left = np.sign(across[axis]) * np.eye(3)[axis]
    upwards = np.eye(3)[up]
    return np.column_stack([left, np.cross(upwards, left), upwards])


def stance_of_model(model, J, up):
    """`stance` of a body model with rest joints J (K,3), `up` ("x", "y", "z") its up; turned as the packaged one without pairs."""
    axis = "xyz".index(up)
    places = dict(reversed(list(zip(model.joint_roles, J))))  # of several joints of a role the first
    return stance(places, axis, np.eye(3)[(axis + 1) % 3])


def stance_of_file(bvh, found):
    """`stance` of a BVH file, whose up is y; its left is x without pairs."""
    places = rest_places(bvh)
    return stance({role: places[j] for role, j in found.items()}, 1, np.eye(3)[0])


def rest_places(bvh):
    """Joints (j,3) of a BVH file at rest."""
    places = bvh.offsets.copy()
    for j, parent in enumerate(bvh.parents):
        if parent >= 0:
            places[j] += places[parent]
    return places


def facing(bvh, pick, found):
    """World rotations (T,j,3,3) of the frames `pick`, z up, the whole clip turned so that it starts facing -y."""
    S = stance_of_file(bvh, found)
    world = S.T @ bvh.rotations[pick] @ S
    return rotate_z(-heading(world[0, found["root"]])) @ world


def turn(a, b):
    """Angles (j,) between two sets of rotations (j,3,3) [rad]."""
    return np.arccos(np.clip((np.einsum("jik,jik->j", a, b) - 1) / 2, -1, 1))


def heading(R):
    """Angle about z from -y to where rotation R faces."""
    front = R @ [0, -1.0, 0]
    return np.arctan2(front[0], -front[1])


def rotate_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def retarget(world, bvh, model, J, found, lowest=None):
    """Local rotations (T,K,3,3) of a body `model` with rest joints J (K,3), x left, y back, z up: limbs take the file's bone
    directions, trunk and head its turns from its rest. `lowest` [rad]: upper arms are lifted to hang at most so far below
    their rest."""
    names, parents, T = model.joint_roles, model.parents, len(world)
    places = rest_places(bvh) @ stance_of_file(bvh, found)
    G, align = np.empty((T, len(names), 3, 3)), {}
    for k, name in enumerate(names):
        above = np.broadcast_to(np.eye(3), (T, 3, 3)) if parents[k] < 0 else G[:, parents[k]]
        if name not in found:
            G[:, k] = above
            continue
        joint, dot, side = name.partition(".")
        if joint in BONES and f"{BONES[joint]}.{side}" in found and f"{BONES[joint]}.{side}" in names:
            ours = J[names.index(f"{BONES[joint]}.{side}")] - J[k]
            theirs = places[found[f"{BONES[joint]}.{side}"]] - places[found[name]]
            align[name] = shortest(ours, theirs)
        G[:, k] = world[:, found[name]] @ align.get(f"{ENDS.get(joint, joint)}.{side}", np.eye(3))
        if joint == "upperarm01" and lowest is not None and f"lowerarm01.{side}" in names:
            G[:, k] = raised(G[:, k], above, J[names.index(f"lowerarm01.{side}")] - J[k], lowest)
    local = G.copy()
    for k, p in enumerate(parents):
        if p >= 0:
            local[:, k] = np.swapaxes(G[:, p], 1, 2) @ G[:, k]
    return local


def shortest(a, b):
    """Rotation (3,3) that takes direction a to direction b by the shortest way."""
    from scipy.spatial.transform import Rotation

    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis = np.cross(a, b)
    s = np.linalg.norm(axis)
    angle = np.arctan2(s, a @ b)
    return Rotation.from_rotvec(axis / s * angle if s > 1e-9 else np.zeros(3)).as_matrix()


def raised(G, above, bone, lowest):
    """Lifts upper arms sideways until they hang at most `lowest` [rad] below their rest, seen from the chest."""
    from scipy.spatial.transform import Rotation

    bone = bone / np.linalg.norm(bone)
    sign = np.sign(bone[0])
    d = np.swapaxes(above, 1, 2) @ (G @ bone)[..., None]
    d = d[..., 0]
    low = np.arctan2(-bone[2], abs(bone[0])) + lowest
    angle = np.arctan2(-d[:, 2], sign * d[:, 0])  # below the horizontal, in the frontal plane
    angle = np.where(angle < -np.pi / 2, angle + 2 * np.pi, angle)
    lift = np.maximum(angle - low, 0)
    fix = Rotation.from_rotvec(np.outer(lift, [0, -sign, 0])).as_matrix()
    return above @ fix @ np.swapaxes(above, 1, 2) @ G


def floor_path(bvh, pick, model, J, found):
    """Root shifts (T,3) [m] from the first of `pick`, z up, scaled by leg length; zero where the file or the model has no legs."""
    if not set(LEG) <= set(model.joint_roles) & found.keys():
        return np.zeros((len(pick), 3))
    length = lambda joints: np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()
    ours, theirs = J[[model.joint(role) for role in LEG]], rest_places(bvh)[[found[role] for role in LEG]]
    S = stance_of_file(bvh, found)
    path = length(ours) / length(theirs) * (bvh.root[pick] - bvh.root[pick[0]]) @ S
    first = S.T @ bvh.rotations[pick[0], found["root"]] @ S
    return path @ rotate_z(-heading(first)).T
