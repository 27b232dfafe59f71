"""What reconstructions add to a person and lose of one: floor, clutter, webs between arm and trunk, bare shoulders."""

from __future__ import annotations

import numpy as np

from .surface import smooth_noise, vertex_normals

PITCH = 0.015  # m, edges of the floor's triangles
FLOOR_RADIUS, FLOOR_NOISE = (0.25, 0.45), 0.002  # m
PIECE_RADIUS = (0.01, 0.04)  # m
BESIDE = (0.04, 0.25)  # m between the person and a piece that drifts
STAND = (0.45, 0.7)  # m from the middle of the stage, of pieces that stay
WEB_GAP = (0.006, 0.07)  # m between arm and trunk that a web closes
WEB_ROWS, WEB_THICKNESS = 24, 0.012  # stations along the upper arm; m between front and back
SHOULDER_RADIUS, SHOULDER_SLOPE = 0.09, 0.55  # m about the joint; least z of the normals that are lost


def spoilt_scan(V, F, outer, joints, model, amounts, seed, number):
    """The scan V (s,3), F (t,3) with the faults that `amounts` ask for; `joints` (K,3) of `model` in this frame."""
    fixed, rng = np.random.default_rng([seed, 8]), np.random.default_rng([seed, 9, number])
    at = lambda name: joints[model.joint(name)]
    if amounts.shoulders:
        F = without_shoulders(V, F, [at(f"upperarm01.{s}") for s in "LR"], [at(f"clavicle.{s}") for s in "LR"], fixed)
    pieces = [(V, F)]
    if amounts.webs:
        pieces += [web(outer, at(f"upperarm01.{s}"), at(f"lowerarm01.{s}"), at("spine01")) for s in "LR"]
    if amounts.floor:
        pieces.append(floor_piece(float(outer.body[:, 2].min()), fixed, rng))
    for k in range(amounts.clutter):
        pieces.append(staying_piece(fixed) if k % 2 else drifting_piece(V, F, rng))
    return joined(pieces)


def joined(pieces):
    start = np.cumsum([0, *(len(V) for V, _ in pieces)])
    return np.concatenate([V for V, _ in pieces]), np.concatenate([F + n for (_, F), n in zip(pieces, start)])


def without_shoulders(V, F, joints, inner, rng):
    """Drops triangles that look up about the shoulders: no camera stood above them."""
    T = V[F]
    n = np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0])
    up = n[:, 2] / np.maximum(np.linalg.norm(n, axis=1), 1e-12)
    centre = T.mean(1)
    keep = np.ones(len(F), bool)
    for outer_end, inner_end in zip(joints, inner):
        middle = outer_end + 0.25 * (inner_end - outer_end)
        ragged = 1 + 0.2 * np.tanh(smooth_noise(centre - middle, 0.04, rng))
        d = np.linalg.norm((centre - middle)[:, :2], axis=1) * ragged
        above = (centre[:, 2] > middle[2] - 0.03) & (centre[:, 2] < middle[2] + 0.15)
        keep &= ~((d < SHOULDER_RADIUS) & above & (up > SHOULDER_SLOPE))
    return F[keep]


def floor_piece(height, fixed, rng):
    """A ragged piece of floor about the middle of the stage; its outline stays, its bumps do not."""
    radius, middle = fixed.uniform(*FLOOR_RADIUS), fixed.uniform(-0.12, 0.12, 2)
    axis = np.arange(-1.5 * radius, 1.5 * radius, PITCH)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) < radius * (1 + 0.25 * smooth_noise(np.stack([x, y, 0 * x], -1).reshape(-1, 3), 0.15, fixed)
                                        .reshape(x.shape))  # fmt: skip
    n = len(axis)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    whole = (inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, 1:] & inside[1:, :-1]).ravel()
    quads = np.stack([a, b, c, d], -1).reshape(-1, 4)[whole]
    V = np.stack([x + middle[0], y + middle[1], height + rng.normal(0, FLOOR_NOISE, x.shape)], -1).reshape(-1, 3)
    return V, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def blob(at, rng):
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2)
    V = np.asarray(ball.vertices)
    bumps = 1 + 0.25 * smooth_noise(V, 0.5, rng)
    return at + V * bumps[:, None] * (rng.uniform(*PIECE_RADIUS) * rng.uniform(0.5, 1.5, 3)), np.asarray(ball.faces)


def drifting_piece(V, F, rng):
    """A lump beside the person, elsewhere in every frame."""
    v = rng.integers(len(V))
    return blob(V[v] + rng.uniform(*BESIDE) * vertex_normals(V, F)[v], rng)


def staying_piece(rng):
    """A lump at the border of the stage that stays."""
    angle = rng.uniform(0, 2 * np.pi)
    r = rng.uniform(*STAND)
    return blob(np.array([r * np.cos(angle), r * np.sin(angle), rng.uniform(0.1, 1.7)]), rng)


def web(outer, shoulder, elbow, spine):
    """A skin over the gap between upper arm and trunk, front and back, where it is narrow: V, F; empty where none is."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    triangles = o3d.core.Tensor(outer.faces.astype(np.uint32))
    scene.add_triangles(o3d.core.Tensor(outer.vertices.astype(np.float32)), triangles)
    t = np.linspace(0.0, 0.9, WEB_ROWS)[:, None]
    start = shoulder + t * (elbow - shoulder)
    inwards = np.array([spine[0], spine[1], 0]) - np.array([shoulder[0], shoulder[1], 0])
    inwards /= np.linalg.norm(inwards)
    forward = np.cross(inwards, elbow - shoulder)
    forward *= 0.5 * WEB_THICKNESS / np.linalg.norm(forward)
    rows = []
    for side in (-1, 1):
        origin = start + side * forward
        rays = np.concatenate([origin, np.broadcast_to(inwards, origin.shape)], 1).astype(np.float32)
        hits = scene.list_intersections(o3d.core.Tensor(rays))
        ray, depth = hits["ray_ids"].numpy(), hits["t_hit"].numpy().astype(np.float64)
        rows.append([gap(origin[k], inwards, np.sort(depth[ray == k])) for k in range(WEB_ROWS)])
    V, F = [], []
    for k in range(WEB_ROWS - 1):
        quad = [rows[0][k], rows[0][k + 1], rows[1][k], rows[1][k + 1]]
        if all(g is not None for g in quad):
            n = len(V)
            V += [p for g in quad for p in g]
            F += [[n, n + 3, n + 1], [n, n + 2, n + 3], [n + 4, n + 5, n + 7], [n + 4, n + 7, n + 6]]
    return np.array(V).reshape(-1, 3), np.array(F, np.int64).reshape(-1, 3)


def gap(origin, direction, depth):
    """Ends of the widest stretch of air after the arm (two points), where it is as wide as a web can be; else None."""
    near = depth[depth < 0.3]
    if len(near) < 2:
        return None
    widths = np.diff(near)
    k = int(widths.argmax())
    if not WEB_GAP[0] < widths[k] < WEB_GAP[1]:
        return None
    return origin + near[k] * direction, origin + near[k + 1] * direction
