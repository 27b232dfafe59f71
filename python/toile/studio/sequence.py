"""The truth of one sequence: body and shirt moved and checked, before anything is seen by a camera.

It lies on disk, in files that are each written whole: body, motion, the settled cloth, then blocks of BLOCK frames. A
simulation that was killed goes on after the last block, to the same bits; nobody holds more than a block in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ..scene import BodyModel
from ..store import load_record, save_record
from . import motion as motions
from . import truth as checks
from .body import TruthBody, make_body
from .cloth import ClothSimulation
from .garment import SIZES, put_on
from .touch import HAND, vertices_of

BLOCK = 50  # frames
STEPS = ("body_step_mm", "body_bend_mm", "garment_step_mm")  # what `check_motion` measures of a block


@dataclass(frozen=True)
class Settled:
    """The garment at rest on the body in its rest pose, and what the simulation was begun with."""

    flat: np.ndarray  # (G,3) the garment's rest shape before placement
    rest: np.ndarray  # (G,3) placed
    faces: np.ndarray  # (m,3)
    cloth_rest: np.ndarray  # (G,3) the simulation's rest shape
    first_body: np.ndarray  # (n,3) the simulation's first body
    body: np.ndarray  # (n,3) its last
    vertices: np.ndarray  # (G,3) float32, in the world
    velocities: np.ndarray  # (G,3) float32


@dataclass(frozen=True)
class Block:
    """Consecutive frames. Positions are float32: what is checked is what is stored."""

    vertices: np.ndarray  # (b,n,3)
    rotations: np.ndarray  # (b,K,3)
    translation: np.ndarray  # (b,3)
    garment: np.ndarray | None  # (b,G,3)
    velocities: np.ndarray | None  # (G,3) float32: the cloth's after the last frame
    per_frame: tuple  # one dict of measures a frame
    steps: dict  # largest steps [mm], from the block before on


class Sequence:
    """One seed's sequence in `folder`; made by `simulate`, then read frame by frame."""

    def __init__(self, folder, options, seed):
        self.folder, self.options, self.frames = folder, options, options.frames
        streams = [np.random.default_rng([seed, i]) for i in range(2)]
        self.body = self._kept("body", TruthBody, lambda: make_body(options.subject, streams[0]), model=BodyModel)
        self.ground = -self.body.rest[:, 2].min()
        self.motion = self._kept("motion", motions.Motion, lambda: self._make_motion(streams[1]))
        self.block = lru_cache(2)(self._block)

    def _make_motion(self, rng):
        return motions.make_motion(self.options.motion, self.body, self.frames, rng)

    def _kept(self, name, kind, make, **records):
        """The record FOLDER/NAME.npz, made when it is not there."""
        path = self.folder / f"{name}.npz"
        if not path.exists():
            save_record(path, make())
        return load_record(path, kind, **records)

    def _path(self, number):
        return self.folder / f"{number:06d}.npz"

    def _block(self, number):
        return load_record(self._path(number), Block)

    @property
    def clothed(self):
        return self.options.garment is not None

    @cached_property
    def settled(self):
        """The garment where `simulate` has dressed the body; None for a bare one."""
        return load_record(self.folder / "settled.npz", Settled) if self.clothed else None

    @property
    def draped(self):
        """(G,3) the garment settled on the truth body in its rest pose, without translation."""
        return self.settled.vertices.astype(np.float64) - [0, 0, self.ground]

    def block_of(self, number):
        """The block that holds a frame, and its place there."""
        return self.block(number // BLOCK), number % BLOCK

    def frame(self, number):
        """Body (n,3) and garment (G,3) or None, float64 [m]."""
        block, i = self.block_of(number)
        return block.vertices[i].astype(np.float64), block.garment[i].astype(np.float64) if self.clothed else None

    def blocks(self):
        return (self.block(number) for number in range(-(-self.frames // BLOCK)))

    def simulate(self, progress):
        """Makes and checks what is missing; raises TruthRejected where a bound is broken."""
        if self.clothed and not (self.folder / "settled.npz").exists():
            save_record(self.folder / "settled.npz", self._dress(progress))
        cloth = None
        for number in range(-(-self.frames // BLOCK)):
            if not self._path(number).exists():
                before = self.block(number - 1) if number else None
                if self.clothed and cloth is None:
                    cloth = self._cloth(number, before)
                save_record(self._path(number), self._make_block(number, before, cloth, progress))
            progress("simulate", min((number + 1) * BLOCK, self.frames), self.frames)

    def _dress(self, progress):
        lift = np.array([0, 0, self.ground])
        size = SIZES[self.options.subject]
        dressing = lambda i, n: progress("dress", i, n)  # noqa: E731
        flat, rest, F, sim = put_on(self.options.garment, self.body, size, lift, dressing)
        vertices = sim.vertices.astype(np.float32)
        return Settled(flat, rest, F, sim.rest, sim.first_body, sim.body, vertices, sim.velocities)

    def _cloth(self, number, before):
        """The simulation as it stands before a block."""
        s = self.settled
        cloth = ClothSimulation(s.cloth_rest, s.faces, s.first_body, self.body.skin_faces)
        if before is None:
            cloth.go_on_from(s.vertices, s.velocities, s.body)
        else:
            last = self._pose(motions.RAMP + number * BLOCK - 1)[0]
            cloth.go_on_from(before.garment[-1], before.velocities, last)
        return cloth

    def _pose(self, k):
        return motions.world_pose(self.motion, self.body, self.ground, k)

    def _make_block(self, number, before, cloth, progress):
        """Frames of one block (the first with the ramp before it), moved, then checked."""
        first, end = number * BLOCK, min((number + 1) * BLOCK, self.frames)
        poses = [self._pose(motions.RAMP + k) for k in range(first, end)]
        V, rotations, translation = map(np.array, zip(*poses))
        vertices = V.astype(np.float32)
        seen = vertices if before is None else np.concatenate([before.vertices[-2:], vertices])
        steps = checks.check_motion(seen, None, first + len(vertices) - len(seen))
        block = Block(vertices, rotations, translation, None, None, (), steps)
        if cloth is None:
            return block
        if before is None:
            for k in range(motions.RAMP):
                cloth.frame(self._pose(k)[0])
        garment, per_frame = [], []
        for k in range(first, end):
            garment.append(cloth.frame(V[k - first]).astype(np.float32))
            per_frame.append(self._check(garment[-1], vertices[k - first], k))
            progress("simulate", k + 1, self.frames)
        garment = np.array(garment)
        worn = garment if before is None else np.concatenate([before.garment[-2:], garment])
        steps |= checks.check_motion(seen, worn, first + len(vertices) - len(seen))
        return replace(block, garment=garment, velocities=cloth.velocities, per_frame=tuple(per_frame), steps=steps)

    @cached_property
    def _hands(self):
        return np.concatenate([vertices_of(self.body, HAND, side) for side in "LR"])

    @cached_property
    def _edges(self):
        return checks.unique_edges(self.settled.faces)

    def _check(self, garment, vertices, number):
        s, cloth, body = self.settled, garment.astype(np.float64), vertices.astype(np.float64)
        return checks.check_frame(cloth, s.faces, s.rest, self._edges, body, self.body.skin_faces, self._hands, number)

    def measures(self):
        """(figures of the whole sequence, measures of every frame)."""
        steps, per_frame, sliding = [], [], None
        for block in self.blocks():
            steps.append(block.steps)
            per_frame += block.per_frame
            if self.clothed:
                sliding = sliding or checks.Sliding(block.garment[0], block.vertices[0])
                sliding.add(block.garment, block.vertices)
        known = [name for name in STEPS if any(name in s for s in steps)]
        figures = {name: max(s.get(name, 0.0) for s in steps) for name in known}
        if self.clothed:
            figures |= summary(per_frame)
            figures["sliding_p90_mm"] = 1e3 * float(np.quantile(sliding.largest, 0.9))
        figures["missing_joints"] = list(self.motion.missing)
        figures["offset_max_mm"] = 1e3 * float(np.linalg.norm(self.body.offset, axis=1).max())
        return figures, per_frame


def summary(per_frame):
    """Worst frame of each figure."""
    worst = {k: max(f[k] for f in per_frame) for k in ("strain_p99", "strain_max", "self_pairs")}
    return worst | {
        "clearance_min_mm": min(f["clearance_mm"] for f in per_frame),
        "hand_cloth_min_mm": min(f["hand_cloth_mm"] for f in per_frame),
        "self_piercing_frames": sum(f["self_pairs"] > 0 for f in per_frame),
    }
