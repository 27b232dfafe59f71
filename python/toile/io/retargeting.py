"""Retargets figures by the roles of joints onto a body model.

They are retargeted with x left, y back, z up (`stance`), whatever the axes are in which the figure and the model stand at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import UserError
from .joints import joint_roles

MIDDLE = ("root", "spine04", "spine02", "neck01", "head")  # roles (io.joints) that a file's joints are looked for in
SIDED = ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
BONES = {"upperarm01": "lowerarm01", "lowerarm01": "wrist", "upperleg01": "lowerleg01", "lowerleg01": "foot"}
LEG = ("upperleg01.L", "lowerleg01.L", "foot.L")
LEAP, LONE = np.radians(15), 3.0  # from a calibration pose: so far at least, and so many times as far as a frame later
UPRIGHT = 0.7  # of a trunk's length along the axis that is up, in most frames
ENDS = {
    "wrist": "lowerarm01",
    "hand": "lowerarm01",
    "foot": "lowerleg01",
    "toe1-1": "lowerleg01",
}  # end joints follow their limb


@dataclass(frozen=True)
class MovingFigure:
    """A skeleton of any names and proportions and how it moves, in a unit of its own, as a BVH file or one of the SMPL family holds it."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray  # (j,3) from the joint above, at rest
    tips: dict[int, np.ndarray]  # {joint: (3,) from it to where its bone ends}, of joints that have none below
    rotations: np.ndarray  # (T,j,3,3) world rotations
    places: np.ndarray  # (T,j,3)
    frame_time: float  # s
    roles: tuple[str, ...] = ()  # of the joints; without them their names tell

    def __len__(self):
        return len(self.places)


def roles_of(figure):
    """{role: index of the figure's joint}, of several the first."""
    return {role: i for i, role in reversed(list(enumerate(figure.roles or joint_roles(figure.names))))}


def matches(figure):
    """{role: index of the figure's joint} of what is retargeted, and the roles that the file lacks."""
    at = roles_of(figure)
    wanted = [*MIDDLE, *(f"{role}.{side}" for role in SIDED for side in "LR")]
    return {role: at[role] for role in wanted if role in at}, [role for role in wanted if role not in at]


def standing(path, figure, found):
    """The figure, turned to y up where it rests and moves along another axis. UserError: it rests along an axis along which it does not
    move, a limb's bone has no length and so no direction, or the feet point backwards."""
    figure = upright(path, figure, found)
    places = rest_places(figure)
    for role in found:
        joint, dot, side = role.partition(".")
        end = f"{BONES.get(joint)}{dot}{side}"
        if end in found and np.array_equal(places[found[role]], places[found[end]]):
            raise UserError(
                f"{path}: the bone from {figure.names[found[role]]} to {figure.names[found[end]]} has no length"
            )
    feet = {role: foot_at_rest(figure, role, found) for role in ("foot.L", "foot.R")}
    if all(foot is not None and foot[1] > 0.5 * np.linalg.norm(foot) for foot in feet.values()):
        names = " and ".join(figure.names[found[role]] for role in feet)
        raise UserError(f"{path}: at rest {names} point backwards: left and right are swapped, or the file is mirrored")
    return figure


def upright(path, figure, found):
    """The figure with y up, by where its trunk leads at rest: Blender writes z up. UserError: most frames lead it elsewhere."""
    top = next((role for role in reversed(MIDDLE) if role in found), "root")
    rest, posed = (p[..., found[top], :] - p[..., found["root"], :] for p in (rest_places(figure), figure.places))
    axis = np.abs(rest).argmax()
    sign = np.sign(rest[axis])
    if not sign or (axis == 1 and sign > 0):
        return figure
    if np.median(sign * posed[:, axis] / np.maximum(np.linalg.norm(posed, axis=1), 1e-12)) < UPRIGHT:
        along = ("-" if sign < 0 else "") + "xyz"[axis]
        names = " to ".join(figure.names[found[role]] for role in ("root", top))
        raise UserError(
            f"{path}: at rest {names} leads along {along}, and in most frames does not: it has to rest standing"
        )
    flip = np.ones(3)
    flip[[axis, axis - 1]] = sign  # two, so that nothing is mirrored
    turn = np.roll(np.diag(flip), 1 - axis, axis=0)
    tips = {joint: tip @ turn.T for joint, tip in figure.tips.items()}
    turned = turn @ figure.rotations @ turn.T
    return replace(figure, offsets=figure.offsets @ turn.T, tips=tips, rotations=turned, places=figure.places @ turn.T)


def foot_at_rest(figure, role, found):
    """(3,) from the ankle `role` to its toes, or to its End Site, x left, y back, z up; None where the file has neither."""
    toes, ankle = roles_of(figure).get(role.replace("foot", "toe1-1")), found.get(role)
    if ankle is None or (toes is None and ankle not in figure.tips):
        return None
    places = rest_places(figure)
    foot = figure.tips[ankle] if toes is None else places[toes] - places[ankle]
    return foot @ stance_of_figure(figure, found)


def starts_at(figure):
    """The first frame that is not a lone calibration pose: 1 where a joint leaps from frame 0 to 1 and none does so from there on."""
    if len(figure) < 3:
        return 0
    leap, after = (turn(figure.rotations[i], figure.rotations[i + 1]).max() for i in (0, 1))
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


def stance_of_figure(figure, found):
    """`stance` of a figure, whose up is y; its left is x without pairs."""
    places = rest_places(figure)
    return stance({role: places[j] for role, j in found.items()}, 1, np.eye(3)[0])


def rest_places(figure):
    """Joints (j,3) of a figure at rest."""
    places = figure.offsets.copy()
    for j, parent in enumerate(figure.parents):
        if parent >= 0:
            places[j] += places[parent]
    return places


def facing(figure, pick, found):
    """World rotations (T,j,3,3) of the frames `pick`, z up, the whole clip turned so that it starts facing -y."""
    S = stance_of_figure(figure, found)
    world = S.T @ figure.rotations[pick] @ S
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


def retarget(world, figure, model, J, found, lowest=None, ends=ENDS):
    """Local rotations (T,K,3,3) of a body `model` with rest joints J (K,3), x left, y back, z up: limbs take the file's bone
    directions, trunk and head its turns from its rest. `lowest` [rad]: upper arms are lifted to hang at most so far below
    their rest. `ends` {joint: the limb whose rest it is turned with}: others turn as the file's from their rest."""
    names, parents, T = model.joint_roles, model.parents, len(world)
    places = rest_places(figure) @ stance_of_figure(figure, found)
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
        G[:, k] = world[:, found[name]] @ align.get(f"{ends.get(joint, joint)}.{side}", np.eye(3))
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
    if s < 1e-9:  # the same, or opposite: then about any axis across
        axis = np.cross(a, np.eye(3)[np.abs(a).argmin()])
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arctan2(s, a @ b)).as_matrix()


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


def floor_path(figure, pick, model, J, found):
    """Root shifts (T,3) [m] from where the body stands, z up, scaled by leg length: the first of `pick` is there, or as much lower as
    the file's hips are above the lowest of the joints `found` than at rest, which may sit. Zero where the file or the model has no legs."""
    if not set(LEG) <= set(model.joint_roles) & found.keys():
        return np.zeros((len(pick), 3))
    length = lambda joints: np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()
    rest = rest_places(figure)
    ours, theirs = J[[model.joint(role) for role in LEG]], rest[[found[role] for role in LEG]]
    path = clip_places(figure, pick, found)[:, found["root"]]
    height = lambda places: places[found["root"], 1] - places[list(found.values()), 1].min()
    lower = max(height(rest) - height(figure.places[pick[0]]), 0.0)
    return length(ours) / length(theirs) * (path - path[0] - [0, 0, lower])


def clip_places(figure, pick, found):
    """Joints (T,j,3) in the frames `pick` as `facing` turns them, in the file's unit."""
    S = stance_of_figure(figure, found)
    first = S.T @ figure.rotations[pick[0], found["root"]] @ S
    return figure.places[pick] @ S @ rotate_z(-heading(first)).T
