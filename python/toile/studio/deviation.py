"""How a truth body leaves the pipeline's body model: a surface that no shape and pose of it reaches, joints elsewhere,
muscles that bulge where limbs bend, breathing. Measured and scaled by least squares that share nothing with our kernels.
"""

from __future__ import annotations

import numpy as np

from ..surface.operators import smooth_on
from .surface import smooth_noise, vertex_normals

LENGTH = 0.07  # m, correlation length of the offsets: longer ones are mostly shapes of the model
MOST = 1.6  # largest offset as a multiple of the mean, softly
OUTWARD, INWARD = 0.20, 0.30  # largest offsets as shares of the free space outside and of the thickness inside
LOWERED = np.radians(16)
REACH = 0.5  # m that space and thickness are looked for
FADING, SMOOTHED = 10, 20  # umbrella steps on the offsets, and on the normals they go along
ROUNDS = 6  # of scaling to the aim
RIDGE = 1e-3  # of the least squares on unit columns
MUSCLES = {  # name -> (bone's joints, place along it, side, radius [m], joint that bends, angle of full bulge [rad])
    "biceps": (("upperarm01", "lowerarm01"), 0.55, (0, -1, 0), 0.045, "lowerarm01", 1.2),
    "deltoid": (("upperarm01", "lowerarm01"), 0.12, (0, 0, 1), 0.05, "upperarm01", 0.9),
    "calf": (("lowerleg01", "foot"), 0.3, (0, 1, 0), 0.055, "lowerleg01", 1.0),
    "thigh": (("upperleg01", "lowerleg01"), 0.5, (0, -1, 0), 0.08, "upperleg01", 0.8),
}
BULGE = (0.6, 1.6)  # of the mean bulge: muscles differ


def trunk_and_limbs(model):
    """Share (n,) of each vertex that torso, arms and legs move; head, hands and feet are left out."""
    fine = ("finger", "metacarpal", "wrist", "toe", "foot", "head", "eye", "neck", "jaw", "tongue", "oris", "levator",
            "orbicularis", "temporalis", "risorius", "oculi", "special")  # fmt: skip
    small = np.array([n.startswith(fine) for n in model.joint_names])
    return 1 - (model.weights_val * small[model.weights_idx]).sum(1)


def surface_offset(model, neutral, rest, J, skin_faces, aim, rng):
    """Displacements (n,3) of `rest` (n,3) [m] so that, after the best shape and pose of `model`, the surface stays `aim`
    away on average over torso and limbs: smooth, outwards and inwards, within the room that the body leaves."""
    normals = vertex_normals(rest, skin_faces)
    directions = smooth_on(skin_faces, normals, SMOOTHED)  # shorter in creases, where normals cross
    along = (directions * normals).sum(1)
    where = smooth_on(skin_faces, trunk_and_limbs(model)[:, None], FADING)[:, 0]
    low, high = room(rest, skin_faces)
    lowered = model.skin(rest, J, arms_lowered(model), np.zeros(3))
    high = np.minimum(high, room(lowered, skin_faces)[1])
    fit = NormalFit(model, rest, J, normals, where > 0.5, skin_faces)
    field, most = aim * smooth_noise(neutral, LENGTH, rng), MOST * aim
    for _ in range(ROUNDS):
        field = most * np.tanh(fit.left(field * along) * where / most)
        field = smooth_on(skin_faces, np.clip(field, low, high)[:, None], FADING)[:, 0]
        field *= aim / fit.mean(fit.left(field * along))
    return unfolded(rest, skin_faces, field[:, None] * directions)


def unfolded(rest, faces, offset):
    """Offsets faded about the faces that they would turn over, until there is none."""
    normals = lambda V: np.cross(V[faces[:, 1]] - V[faces[:, 0]], V[faces[:, 2]] - V[faces[:, 0]])
    upright = normals(rest)
    while (turned := faces[(normals(rest + offset) * upright).sum(1) <= 0]).size:
        fade = np.ones((len(rest), 1))
        fade[turned.ravel()] = 0
        offset = offset * smooth_on(faces, fade, FADING)
    return offset


def arms_lowered(model):
    """Rotations (K,3) that bring the upper arms as near to the trunk as the studio's motions do."""
    rotations = np.zeros((len(model.J), 3))
    for side, sign in (("L", 1), ("R", -1)):
        rotations[model.joint(f"upperarm01.{side}"), 1] = sign * LOWERED
    return rotations


def room(V, skin_faces):
    """Lowest and highest offset (n,) [m] along the normals: shares of what rays meet inside and outside."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(o3d.core.Tensor(V.astype(np.float32)), o3d.core.Tensor(skin_faces.astype(np.uint32)))
    normals = vertex_normals(V, skin_faces)

    def free(direction):
        rays = np.concatenate([V + 1e-3 * direction, direction], 1).astype(np.float32)
        t = scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy().astype(np.float64)
        return np.minimum(t, REACH)

    return -INWARD * free(-normals), OUTWARD * free(normals)


class NormalFit:
    """Least squares of shape and of every joint's rotation, linearised, to offsets along the normals of a body."""

    def __init__(self, model, rest, J, normals, counted, skin_faces):
        columns = [np.einsum("ni,nis->ns", normals, model.shapedirs)]
        dense = np.zeros((len(rest), len(J)))
        np.put_along_axis(dense, model.weights_idx, model.weights_val, axis=1)
        moved = subtree(model.parents) @ dense.T  # (K,n) share of a vertex that a joint's rotation moves
        for k in range(len(J)):
            if moved[k, counted].max() > 0.3:
                arm = np.cross(np.eye(3)[:, None], (rest - J[k])[None])  # (3,n,3)
                columns.append(np.einsum("ank,nk->na", arm, normals) * moved[k][:, None])
        columns.append(normals)  # translation
        area = vertex_areas(rest, skin_faces) * counted
        self.weight = area / area.sum()
        A = np.concatenate(columns, 1) * np.sqrt(self.weight)[:, None]
        scale = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
        self.A, self.all = A / scale, np.concatenate(columns, 1) / scale
        self.inverse = np.linalg.inv(self.A.T @ self.A + RIDGE**2 * np.eye(A.shape[1]))

    def left(self, offset):
        """The offsets (n,) that the fit leaves."""
        return offset - self.all @ (self.inverse @ (self.A.T @ (np.sqrt(self.weight) * offset)))

    def mean(self, offset):
        """Mean |offset| [m] over the counted surface."""
        return float(self.weight @ np.abs(offset))


def subtree(parents):
    """(K,K): 1 where joint k is joint j or above it."""
    T = np.eye(len(parents))
    for j, p in enumerate(parents):
        if p >= 0:
            T[:, j] += T[:, p]
    return T


def vertex_areas(V, F):
    """A third of the area of the faces about each vertex (n,)."""
    area = 0.5 * np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1)
    return np.bincount(F.ravel(), np.repeat(area, 3), minlength=len(V)) / 3


def moved_joints(J, names, mean, rng):
    """Joints (K,3) each 0.6 to 1.4 x `mean` [m] elsewhere; those of fingers, toes and eyes by a quarter of it."""
    direction = rng.standard_normal(J.shape)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    main = ("root", "spine", "pelvis", "clavicle", "shoulder", "upper", "lower", "wrist", "foot", "neck", "head")
    share = np.where([n.startswith(main) for n in names], 1.0, 0.25)
    return J + direction * (mean * share * rng.uniform(0.6, 1.4, len(J)))[:, None]


def no_muscles(n):
    return np.zeros((0, n, 3)), np.zeros(0, np.int64), np.zeros(0)


def muscles(model, normals, where, mean, rng):
    """Bulges of MUSCLES on both sides: displacements (b,n,3) [m] at full bend, their joints (b,), full angles (b,)."""
    fields, joints, angles = [], [], []
    for bone, along, side, radius, bends, angle in MUSCLES.values():
        height = mean * rng.uniform(*BULGE)
        for s in "LR":
            a, b = (model.J[model.joint(f"{j}.{s}")] for j in bone)
            at = a + along * (b - a)
            axis = (b - a) / np.linalg.norm(b - a)
            outward = np.array(side, float) - np.dot(side, axis) * axis
            d = model.v_template - at
            around = d - (d @ axis)[:, None] * axis
            facing = 0.5 + 0.5 * np.clip(normals @ (outward / np.linalg.norm(outward)), -1, 1)
            near = np.exp(-0.5 * ((d @ axis) / radius) ** 2) * (np.linalg.norm(around, axis=1) < 3 * radius)
            fields.append((height * near * facing**2 * where)[:, None] * normals)
            joints.append(model.joint(f"{bends}.{s}"))
            angles.append(angle)
    return np.array(fields), np.array(joints), np.array(angles)


def breath(model, normals, depth):
    """Displacement (n,3) [m] of a full breath: chest and belly move out by up to `depth`."""
    trunk = np.array([n.startswith(("spine", "clavicle", "shoulder")) for n in model.joint_names])
    share = (model.weights_val * trunk[model.weights_idx]).sum(1)
    middle = 0.5 * (model.J[model.joint("spine01"), 2] + model.J[model.joint("spine03"), 2])
    near = np.exp(-0.5 * ((model.v_template[:, 2] - middle) / 0.16) ** 2)
    front = np.clip(0.4 - normals[:, 1], 0, 1)  # the body faces -y
    return (depth * near * share * front)[:, None] * normals


def belly(model, rest, J, skin_faces, depth):
    """Displacement (n,3) [m] of a belly that stands out by up to `depth`, less at the sides and not at the back."""
    trunk = np.array([n.startswith(("spine", "root", "pelvis")) for n in model.joint_names])
    share = (model.weights_val * trunk[model.weights_idx]).sum(1)
    height = J[model.joint("spine04"), 2]
    near = np.exp(-0.5 * ((rest[:, 2] - height) / 0.11) ** 2)
    directions = smooth_on(skin_faces, vertex_normals(rest, skin_faces), SMOOTHED)
    front = np.clip(0.5 - directions[:, 1], 0, 1)
    return smooth_on(skin_faces, (depth * near * share * front)[:, None], FADING) * directions
