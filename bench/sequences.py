"""Sequences with truth: one person moves for 50 frames, scanned anew in each.   python -m bench.sequences OUT --seed S

OUT/seq_L1 and OUT/seq_L3: motion between neighbouring frames as levels 1 and 3 move joints and root, with the level's
shape: joints swing by 4 or 8 degrees about the template's pose, so that errors can be held against those of pairs.
template.npz holds src_v, src_f, ext, hand; 000.npz ... hold tgt_v, tgt_f (noise1) and gt_v.
"""

import argparse
from pathlib import Path

import igl
import numpy as np

from .person import JOINTS, SyntheticPerson, barycentric
from .problems import POSE, SHAPE, SHIFT, TARGET, corrupt, remesh

FRAMES = 50
SWING = {1: 4.0, 3: 8.0}  # degree: amplitude of a joint about each axis
SAMPLINGS = 3  # meshings of the surface that take turns, so that no two neighbouring scans share a connectivity


def swings(level, rng):
    """A function of the frame: angles (J,3) [degree] about the template's pose, whose rms step is the level's."""
    shape = (len(JOINTS), 3)
    mean_speed = 2 * np.arcsin(POSE[level] / (np.sqrt(2) * SWING[level]))  # phase a frame [rad]
    speed = mean_speed * rng.uniform(0.8, 1.2, shape)
    phase = rng.uniform(0, 2 * np.pi, shape)
    return lambda t: SWING[level] * np.sin(speed * t + phase)


def samplings(person, vertices, rng):
    """[(rows on the cage (p, n), faces)]: meshings of the outside at rest."""
    V, F = person.surface(person.rest)
    rows, _ = person._outside[True]
    out = []
    for _ in range(SAMPLINGS):
        P, T = remesh(*person.surface(person.rest, fine=False), vertices, rng)
        _, face, at = igl.point_mesh_squared_distance(P, V, F)[:3]
        bary = barycentric(at, V[F[face]])
        out.append((sum(rows[F[face, k]].multiply(bary[:, k, None]) for k in range(3)).tocsr(), T))
    return out


def frames(person, template, level, seed, count=FRAMES, corruption="noise1"):
    """Yields dicts tgt_v, tgt_f, gt_v."""
    rng = np.random.default_rng([seed, level, 50])
    angles, a = swings(level, rng), SHAPE[level]
    phenotype = {p: float(np.clip(0.5 + rng.uniform(-a, a), 0, 1)) for p in person.phenotypes} if a else {}
    drift = rng.normal(size=3)
    drift *= np.sqrt(3) * SHIFT[level] / np.linalg.norm(drift)
    meshings = samplings(person, TARGET, rng)
    for t in range(1, count + 1):
        sway = drift * np.sin(0.2 * t) / 0.2  # as fast at first as the level shifts, then back
        cage = person.pose(dict(zip(JOINTS, angles(t))), phenotype, sway)
        rows, faces = meshings[t % SAMPLINGS]
        V, F = corrupt(rows @ cage, faces, corruption, rng)
        yield dict(tgt_v=V, tgt_f=F, gt_v=template.points @ cage)


def main():
    parse = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parse.add_argument("out", type=Path)
    parse.add_argument("--seed", type=int, default=1)
    parse.add_argument("--frames", type=int, default=FRAMES)
    arguments = parse.parse_args()
    write(arguments.out, SyntheticPerson(), arguments.seed, arguments.frames)


def write(out, person, seed, count=FRAMES):
    template = person.template("14k")
    for level in (1, 3):
        folder = out / f"seq_L{level}"
        folder.mkdir(parents=True, exist_ok=True)
        src = dict(src_v=template.points @ person.rest, src_f=template.faces.astype(np.int32))
        np.savez_compressed(folder / "template.npz", ext=template.exterior, hand=template.hand, **src)
        for t, frame in enumerate(frames(person, template, level, seed, count)):
            np.savez_compressed(folder / f"{t:03d}.npz", **frame)


if __name__ == "__main__":
    main()
