"""The truth of one sequence: body and garments moved and checked, before anything is seen by a camera.

It lies on disk, in files that are each written whole: body, motion, the settled cloth, then blocks of BLOCK frames. A
simulation that was killed goes on after the last block, to the same bits; nobody holds more than a block in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from ..io.files import load_record, save_record
from ..scene import BodyModel
from . import motion
from . import truth as checks
from .body import TruthBody, make_body
from .garment import put_on, size_of
from .motions import make_motion
from .outfit import Outfit, Settled, split
from .surface import unique_edges
from .touch import HAND, vertices_of

BLOCK = 50  # frames
STEPS = ("body_step_mm", "body_bend_mm", "garment_step_mm")  # what `check_motion` measures of a block


@dataclass(frozen=True)
class FrameBlock:
    """Consecutive frames. Positions are float32: what is checked is what is stored."""

    vertices: np.ndarray  # (b,n,3)
    rotations: np.ndarray  # (b,K,3)
    translation: np.ndarray  # (b,3)
    garment: np.ndarray | None  # (b,G,3) the vertices of all garments, one after the other, inner to outer
    velocities: np.ndarray | None  # (G,3) float32: the cloth's after the last frame
    per_frame: tuple  # one dict of measures a frame
    steps: dict  # largest steps [mm], from the block before on


class Sequence:
    """One seed's sequence in `folder`; made by `simulate`, then read frame by frame."""

    def __init__(self, folder, options, seed):
        self.folder, self.options, self.frames = folder, options, options.frames
        streams = [np.random.default_rng([seed, i]) for i in range(2)]
        self.body = self._kept(
            "body", TruthBody, lambda: make_body(options.subject, streams[0], options.amounts), model=BodyModel
        )
        self.ground = -self.body.rest[:, 2].min()
        self.motion = self._kept("motion", motion.BodyMotion, lambda: self._make_motion(streams[1]))
        self.block = lru_cache(2)(self._block)

    def _make_motion(self, rng):
        return make_motion(self.options.motion, self.body, self.frames, rng)

    def _kept(self, name, kind, make, **records):
        """The record FOLDER/NAME.npz, made when it is not there."""
        path = self.folder / f"{name}.npz"
        if not path.exists():
            save_record(path, make())
        return load_record(path, kind, **records)

    def _path(self, number):
        return self.folder / f"{number:06d}.npz"

    def _block(self, number):
        return load_record(self._path(number), FrameBlock)

    @property
    def clothed(self):
        return bool(self.options.garments)

    @cached_property
    def settled(self):
        """The garments, inner to outer, where `simulate` has dressed the body; none for a bare one."""
        return [load_record(self._settled(name), Settled) for name, _ in self.options.garments]

    def _settled(self, name):
        return self.folder / f"settled.{name}.npz"

    def draped(self, settled):
        """(G,3) a garment settled on the truth body in its rest pose, without translation."""
        return settled.vertices.astype(np.float64) - [0, 0, self.ground]

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
        for i, (name, source) in enumerate(self.options.garments):
            if not self._settled(name).exists():
                worn = [load_record(self._settled(n), Settled) for n, _ in self.options.garments[:i]]
                save_record(self._settled(name), self._put_on(name, source, worn, progress))
        cloth = None
        for number in range(-(-self.frames // BLOCK)):
            if not self._path(number).exists():
                before = self.block(number - 1) if number else None
                if self.clothed and cloth is None:
                    cloth = self._cloth(number, before)
                save_record(self._path(number), self._make_block(number, before, cloth, progress))
            progress("simulate", min((number + 1) * BLOCK, self.frames), self.frames)

    def _put_on(self, name, source, worn, progress):
        lift, size = np.array([0, 0, self.ground]), size_of(self.options.subject, self.body)
        return put_on(name, source, self.body, worn, size, lift, lambda i, n: progress(f"dress {name}", i, n))

    def _cloth(self, number, before):
        """The garments' simulations as they stand before a block."""
        standing = self.body.pose(np.zeros((len(self.body.J), 3)), [0, 0, self.ground])
        cloth = Outfit(self.settled, standing, self.body.skin_faces, self.body.trunk_faces)
        if before is not None:
            last = self._pose(motion.RAMP + number * BLOCK - 1)[0]
            cloth.go_on_from(before.garment[-1], before.velocities, last)
        return cloth

    def _pose(self, k):
        return motion.world_pose(self.motion, self.body, self.ground, k)

    def _make_block(self, number, before, cloth, progress):
        """Frames of one block (the first with the ramp before it), moved, then checked."""
        first, end = number * BLOCK, min((number + 1) * BLOCK, self.frames)
        poses = [self._pose(motion.RAMP + k) for k in range(first, end)]
        V, rotations, translation = map(np.array, zip(*poses))
        vertices = V.astype(np.float32)
        seen = vertices if before is None else np.concatenate([before.vertices[-2:], vertices])
        steps = checks.check_motion(seen, None, first + len(vertices) - len(seen))
        block = FrameBlock(vertices, rotations, translation, None, None, (), steps)
        if cloth is None:
            return block
        if before is None:
            for k in range(motion.RAMP):
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
        return [unique_edges(s.faces) for s in self.settled]

    def _check(self, garment, vertices, number):
        """Each garment against the body and the garments under it; the worst of all."""
        under, faces, found = vertices.astype(np.float64), self.body.skin_faces, []
        for s, V, edges in zip(self.settled, split(garment.astype(np.float64), self.settled), self._edges):
            worn = s.name, V, s.faces, s.rest, edges
            bounds = self.options.pairs, self.options.strain
            found.append(checks.check_frame(*worn, under, faces, self._hands, number, *bounds))
            under, faces = np.concatenate([under, V]), np.concatenate([faces, s.faces + len(under)])
        return {name: worst(f[name] for f in found) for name, worst in checks.WORST.items()}

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
    worst = {k: max(f[k] for f in per_frame) for k in ("strain_p99", "strain_max", "self_pairs", "pairs")}
    return worst | {
        "clearance_min_mm": min(f["clearance_mm"] for f in per_frame),
        "hand_cloth_min_mm": min(f["hand_cloth_mm"] for f in per_frame),
        "self_piercing_frames": sum(f["self_pairs"] > 0 for f in per_frame),
    }
