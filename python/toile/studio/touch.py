"""Hands brought onto the shirt: a contact that a single tracked surface cannot represent."""

from __future__ import annotations

import numpy as np

from .motion import FPS, RAMP, BodyMotion, elbow_axis, faces, smoothstep
from .surface import vertex_normals

GAP = 0.028  # m between palm and skin: the cloth and its contact margin on both sides fit in between
HAND = ("wrist", "finger", "metacarpal")  # joints whose vertices are the hand
CLEAR = 0.020  # m that every part of the hand keeps from the trunk
DRAG = 0.04  # m that the palm rubs up and down
REACH_BY = 10  # captured frames until the hands lie on the shirt


def touch_motion(body, n, rng):
    """Both hands go to the belly and rub it; they arrive REACH_BY frames (or half the clip) after the ramp."""
    low, high = (hand_pose(body, dz) for dz in (-DRAG / 2, DRAG / 2))
    rub = 0.5 + 0.5 * np.sin(2 * np.pi * (0.7 * np.arange(n) / FPS + rng.uniform()))
    arrive = RAMP + min(REACH_BY, max(1, (n - RAMP) // 2))
    reach = smoothstep(np.arange(1, n + 1) / arrive)
    R = reach[:, None, None] * (low + rub[:, None, None] * (high - low))
    return BodyMotion(R, np.zeros((n, 3)), faces(n, rng, speech=False), grounded=False)


def hand_pose(body, dz):
    """Rotations (K,3) of both arms that lay the palms on the belly, `dz` above its middle."""
    rotations = np.zeros((len(body.J), 3))
    for side in "LR":
        rotations += arm_on_belly(body, side, dz)
    return rotations


def arm_on_belly(body, side, dz):
    """One arm by least squares over shoulder, elbow, forearm twist and wrist."""
    from scipy.optimize import least_squares
    from scipy.spatial import cKDTree

    model, J, sign = body.model, body.J, 1 if side == "L" else -1
    k = {n: model.joint(f"{n}.{side}") for n in ("upperarm01", "lowerarm01", "lowerarm02", "wrist")}
    hand = vertices_of(body, HAND, side)[::3]
    arm = vertices_of(body, ("lowerarm",), side)
    palm = np.nonzero(np.isin(hand, palm_vertices(body, side)))[0]
    trunk = np.nonzero(body.dense_weights[:, [n.startswith(("spine", "root", "pelvis", "upperleg")) for n in
                                             model.joint_names]].sum(1) > 0.9)[0]  # fmt: skip
    points, normals = dense_surface(body, trunk)
    tree = cKDTree(points)
    middle = body.rest[trunk[on_belly(body, trunk, sign * 0.10, dz)]]
    some = np.r_[hand, arm[::3]]
    axis = elbow_axis(body, side)
    twist = J[k["wrist"]] - J[k["lowerarm01"]]
    twist = twist / np.linalg.norm(twist)

    def rotations(p):
        R = np.zeros((len(J), 3))
        R[k["upperarm01"]] = p[:3]
        R[k["lowerarm01"]] = p[3] * axis
        R[k["lowerarm02"]] = p[4] * twist
        R[k["wrist"]] = p[5:8]
        return R

    def residuals(p):
        x = posed(body, some, rotations(p))
        near = tree.query(x)[1]
        height = ((x - points[near]) * normals[near]).sum(1)
        target = x[palm].mean(0) - middle
        inside = np.maximum(CLEAR - height, 0)
        lift = height[palm] - GAP
        return np.r_[30 * inside, 2 * lift, 4 * target[[0, 2]], 0.02 * p]

    start = np.zeros(8)
    start[0], start[3] = np.radians(-20), np.radians(60)
    return rotations(least_squares(residuals, start, max_nfev=40).x)


def dense_surface(body, trunk):
    """Points and outward normals: vertices, edge middles and centres of the faces whose corners are all in `trunk`."""
    chosen = np.zeros(len(body.rest), bool)
    chosen[trunk] = True
    F = body.skin_faces[chosen[body.skin_faces].all(1)]
    N = vertex_normals(body.rest, body.model.f)
    corners = np.array([[1, 0, 0], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3, 1 / 3, 1 / 3]])
    P, n = (np.einsum("ck,fkd->fcd", corners, A[F]).reshape(-1, 3) for A in (body.rest, N))
    return P, n / np.linalg.norm(n, axis=1, keepdims=True)


def vertices_of(body, prefixes, side):
    names = body.model.joint_names
    columns = [n.startswith(prefixes) and n.endswith("." + side) for n in names]
    return np.nonzero(body.dense_weights[:, columns].sum(1) > 0.6)[0]


def palm_vertices(body, side):
    """Vertices of the hand's middle on the inner side."""
    hand = vertices_of(body, ("wrist", "metacarpal"), side)
    knuckles = [body.J[body.model.joint(f"finger{f}-1.{side}")] for f in (2, 5)]
    wrist = body.J[body.model.joint(f"wrist.{side}")]
    inner = np.cross(knuckles[0] - wrist, knuckles[1] - wrist) * (1 if side == "L" else -1)
    facing = vertex_normals(body.rest, body.model.f)[hand] @ (inner / np.linalg.norm(inner))
    thumb = body.J[body.model.joint(f"finger1-2.{side}")] - 0.5 * (knuckles[0] + knuckles[1])
    return hand[facing * np.sign(thumb @ inner) > 0.5]


def on_belly(body, trunk, x, dz):
    """Index into `trunk` of the front vertex nearest to (x, belly height + dz)."""
    P = body.rest[trunk]
    z = body.J[body.model.joint("spine03"), 2] + dz
    return int(np.where(P[:, 1] < body.J[0, 1], (P[:, 0] - x) ** 2 + (P[:, 2] - z) ** 2, np.inf).argmin())


def posed(body, vertices, rotations):
    from ..kinematics import blend_skinning

    R, x = body.model.joint_transforms(body.J, rotations, np.zeros(3))
    idx, val = body.model.weights_idx[vertices], body.model.weights_val[vertices]
    return blend_skinning(body.rest[vertices], body.J, R, x, idx, val)
