"""The truth garments: newton's T-shirt, dressed by growing the body into it, or garments cut from the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import UserError
from .cloth import ClothSimulation
from .cut import CUTS, cut_garment
from .outfit import LayersBelow, Settled, upper_border
from .surface import open_loops

SIZES = {"fitted": 1.05, "logo": 1.08, "loose": 1.14, "child": 1.10, "tall": 1.08, "heavy": 1.12}
SIZED = ("child", "tall", "heavy")  # whose shirt is as large as they are; the others wear one size
GROWTH, LOWERING, SETTLING = 20, 8, 12  # frames: body grows, arms go to the A-pose, cloth comes to rest
BAND = 0.015  # m below the upper border: the waistband, which the body holds
SHRINK = 0.35  # distance from the bone line while the shirt is put on; 0.6 fails for a third of the bodies


def newton_shirt():
    """newton's `unisex_shirt.usd` (6436 vertices, four open loops): V (n,3) [m], z up, facing -y, and F (m,3)."""
    import newton
    import newton.usd
    from pxr import Usd

    stage = Usd.Stage.Open(str(Path(newton.__file__).parent / "examples/assets/unisex_shirt.usd"))
    mesh = newton.usd.get_mesh(stage.GetPrimAtPath("/root/shirt"))
    V = np.asarray(mesh.vertices, np.float64) * 0.01
    return np.stack([V[:, 0], -V[:, 2], V[:, 1]], 1), np.asarray(mesh.indices, np.int32).reshape(-1, 3)


def named_loops(V, F):
    """neck, hem, sleeve_left, sleeve_right -> vertex cycle, told apart by where they lie (x = body's left)."""
    loops = open_loops(F)
    if len(loops) != 4:
        raise UserError(f"studio: a T-shirt has four open loops, this garment has {len(loops)}")
    centre = np.array([V[c].mean(0) for c in loops])
    left, right = int(centre[:, 0].argmax()), int(centre[:, 0].argmin())
    rest = sorted({0, 1, 2, 3} - {left, right}, key=lambda i: centre[i, 2])
    return {"hem": loops[rest[0]], "neck": loops[rest[1]], "sleeve_left": loops[left], "sleeve_right": loops[right]}


def place(V, F, body, size):
    """Scales the shirt by `size` and moves it onto the body in its rest pose."""
    V = V * size
    loops = named_loops(V, F)
    torso = torso_vertices(body)
    shoulder = lambda P: P[(np.abs(P[:, 0]) > 0.09) & (np.abs(P[:, 0]) < 0.13), 2].max()
    neck = neck_ring(body)
    V = V - [V[:, 0].mean(), 0, 0]
    V[:, 2] += shoulder(torso) + 0.005 - shoulder(V)
    chest_z = body.J[body.model.joint("spine01"), 2]
    at_chest = lambda P: P[np.abs(P[:, 2] - chest_z) < 0.02]
    middle = lambda P: 0.5 * (P[:, 1].min() + P[:, 1].max())
    dy_neck = neck[:, 1].mean() - V[loops["neck"], 1].mean()
    shirt_chest = at_chest(V)
    dy_chest = middle(at_chest(torso)) - middle(shirt_chest[np.abs(shirt_chest[:, 0]) < 0.15])
    V[:, 1] += 0.7 * dy_neck + 0.3 * dy_chest
    return V


def torso_vertices(body):
    W = body.dense_weights
    columns = [i for i, n in enumerate(body.model.joint_names) if n.startswith(("spine", "clavicle", "shoulder"))]
    return body.rest[W[:, columns].sum(1) > 0.5]


def neck_ring(body):
    """Vertices around the base of the neck."""
    W = body.dense_weights
    share = W[:, [body.model.joint("neck01"), body.model.joint("neck02")]].sum(1)
    return body.rest[share > 0.5]


def arms_through_sleeves(V, F, body):
    """Rotations (K,3) that turn the upper arms about y until they point through the sleeve hems."""
    loops = named_loops(V, F)
    rotations = np.zeros((len(body.J), 3))
    for side, sign in (("L", 1), ("R", -1)):
        target = V[loops["sleeve_left" if side == "L" else "sleeve_right"]].mean(0)
        shoulder, elbow = body.J[body.model.joint(f"upperarm01.{side}")], body.J[body.model.joint(f"lowerarm01.{side}")]
        slope = lambda d: np.arctan2(-d[2], sign * d[0])
        turn = slope(target - shoulder) - slope(elbow - shoulder)
        rotations[body.model.joint(f"upperarm01.{side}"), 1] = sign * turn
    return rotations


def bone_line(body):
    """Per rest vertex (n,3): its skin-weighted projection onto the bones (joint to mean of its children)."""
    J, parents = body.J, body.model.parents
    tip = np.array([J[parents == k].mean(0) if (parents == k).any() else J[k] for k in range(len(J))])
    axis = tip - J
    length2 = np.maximum((axis**2).sum(1), 1e-12)
    centre = np.zeros_like(body.rest)
    for idx, val in zip(body.model.weights_idx.T, body.model.weights_val.T):
        t = np.clip(((body.rest - J[idx]) * axis[idx]).sum(1) / length2[idx], 0, 1)
        centre += val[:, None] * (J[idx] + t[:, None] * axis[idx])
    return centre


def dress(V, F, body, under, worn, translation, progress):
    """Dresses the placed shirt V (in the body's rest frame): gives the simulation, settled in the rest (A) pose."""
    rotations = arms_through_sleeves(V, F, body)
    full = under.vertices(body.pose(rotations, translation), worn)
    line = body.model.skin(bone_line(body), body.J, rotations, translation)
    line = np.concatenate([line, line[nearest(full[len(line) :], full[: len(line)])]])
    grown = lambda t: line + (SHRINK + (1 - SHRINK) * t) * (full - line)
    sim = ClothSimulation(V + translation, F, grown(0.0), under.faces)
    sim.set_world(gravity=0.0, mu=0.1)
    for k in range(GROWTH):
        sim.frame(grown((k + 1) / GROWTH), damping=0.03)
        progress(k + 1, GROWTH + LOWERING + SETTLING)
    sim.set_world(gravity=9.81, mu=0.3)
    for k in range(LOWERING + SETTLING):
        s = max(0.0, 1 - (k + 1) / LOWERING)
        sim.frame(under.vertices(body.pose(rotations * s, translation), worn))
        progress(GROWTH + k + 1, GROWTH + LOWERING + SETTLING)
    return sim


def waistband(V, F):
    """Indices of the vertices within BAND of the upper border."""
    from scipy.spatial import cKDTree

    return np.flatnonzero(cKDTree(V[upper_border(V, F)]).query(V)[0] < BAND)


def nearest(points, among):
    from scipy.spatial import cKDTree

    return cKDTree(among).query(points)[1]


def settle(V, F, rest, under_V, under_F, progress, held=()):
    """Lets a garment V (n,3), of cloth whose shape is `rest` (n,3), that already lies around the rest pose come to rest:
    gives the simulation."""
    sim = ClothSimulation(rest, F, under_V, under_F, held=held)
    sim.move(V)
    for k in range(SETTLING):
        sim.frame(sim.body)
        progress(k + 1, SETTLING)
    return sim


def put_on(name, source, body, worn, size, translation, progress):
    """Puts a garment on the truth body in its rest pose, over what is `worn` (Settled, inner to outer): a Settled.
    `name`: one of CUTS. `source`: cut, newton, or an .obj (a shirt of four open loops, metres, z up, facing -y)."""
    standing = body.pose(np.zeros((len(body.J), 3)), translation)
    under, on = LayersBelow(standing, body.skin_faces, worn), [s.vertices.astype(np.float64) for s in worn]
    under_V = under.vertices(standing, on)
    if source == "cut":
        V, F = cut_garment(name, body, (under_V - translation, np.concatenate(under.faces)) if worn else None)
        held = waistband(V, F) if CUTS[name].held else ()
        cloth = (1 + CUTS[name].ease) * V
        return Settled.of(name, cloth, cloth, settle(V + translation, F, cloth, under_V, under.faces, progress, held))
    flat, F = newton_shirt() if source == "newton" else read_shirt(source)
    rest = place(flat, F, body, size)
    return Settled.of(name, flat, rest, dress(rest, F, body, under, on, translation, progress))


def size_of(subject, body):
    """How much larger than newton's shirt is what the subject wears."""
    if subject not in SIZED:
        return SIZES[subject]
    girth = lambda V: np.ptp(V[body.dense_weights[:, body.model.joint("spine03")] > 0.5], axis=0)[:2].sum()
    return SIZES[subject] * girth(body.rest) / girth(body.neutral)


def read_shirt(path):
    import trimesh

    if not Path(path).is_file():
        raise UserError(f"studio: garment {path!r}: no such file; expected newton, cut, or an .obj")
    mesh = trimesh.load(path, force="mesh", process=False, maintain_order=True)
    V, F = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    if not 0.3 < np.ptp(V[:, 2]) < 1.5:
        raise UserError(f"{path}: the garment is {np.ptp(V[:, 2]):.3g} m tall; a shirt in metres, z up, is expected")
    named_loops(V, F)
    return V, F
