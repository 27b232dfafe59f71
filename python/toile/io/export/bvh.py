"""The tracked pose as BVH: y up, metres, joints in the skeleton's order, rotations as Z, X, Y about the joint's own axes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import UserError
from ...kernels.arrays import Floats
from .clip import Clip, ClipSkeleton

ORDER = "ZXY"


def write_bvh(clip: Clip, path: Path) -> list[str]:
    """BVH knows no gaps: the frame before stands for one that is missing. Returns a line that says so."""
    from scipy.spatial.transform import Rotation

    skeleton = clip.with_y_up().skeleton
    if skeleton is None:
        raise UserError(f"--format bvh: {clip.name} has no skeleton")
    numbers, step = even_frames(clip.frames)
    rows = []
    for number in numbers:
        rotations, translation = skeleton.pose(number)
        angles = Rotation.from_rotvec(rotations).as_euler(ORDER, degrees=True)
        order = depth_first(skeleton)
        rows.append(np.concatenate([skeleton.offsets[0] + translation, angles[order].ravel()]))
    head = "\n".join(["HIERARCHY", *hierarchy(skeleton, spelled(skeleton.names), 0, 0)])
    body = "\n".join(" ".join(f"{value:.8f}" for value in row) for row in rows)
    path.write_text(f"{head}\nMOTION\nFrames: {len(rows)}\nFrame Time: {step / clip.fps:.8f}\n{body}\n")
    held = len(numbers) - len(clip.frames)
    return [f"{held} missing frames hold the pose before them: BVH knows no gaps"] if held else []


def even_frames(frames: tuple[int, ...]) -> tuple[list[int], int]:
    """Frames from the first to the last at an even step, the one before in place of each that is missing; and the step."""
    step = int(np.gcd.reduce(np.diff(frames))) if len(frames) > 1 else 1
    wanted = np.arange(frames[0], frames[-1] + 1, step)
    return [frames[i] for i in np.searchsorted(frames, wanted, side="right") - 1], step


def children(skeleton: ClipSkeleton, k: int) -> list[int]:
    return [c for c, parent in enumerate(skeleton.parents) if parent == k]


def depth_first(skeleton: ClipSkeleton, k: int = 0) -> list[int]:
    """The joints in the order in which a BVH's hierarchy, and so its channels, name them."""
    return [k, *(j for child in children(skeleton, k) for j in depth_first(skeleton, child))]


def spelled(names: Sequence[str]) -> list[str]:
    """Joints' names as a BVH tells them apart: each is one word."""
    found: list[str] = []
    for name in names:
        word = "_".join(name.split())
        while word in found:
            word += "_"
        found.append(word)
    return found


def hierarchy(skeleton: ClipSkeleton, names: Sequence[str], k: int, depth: int) -> list[str]:
    """Lines of joint k and those under it, all called by `names`."""
    pad, below = "\t" * depth, children(skeleton, k)
    offset = skeleton.offsets[k] if depth else np.zeros(3)
    places = "6 Xposition Yposition Zposition" if depth == 0 else "3"
    lines = [
        f"{pad}{'JOINT' if depth else 'ROOT'} {names[k]}",
        f"{pad}{{",
        f"{pad}\tOFFSET {words(offset)}",
        f"{pad}\tCHANNELS {places} " + " ".join(f"{axis}rotation" for axis in ORDER),
    ]
    for child in below:
        lines += hierarchy(skeleton, names, child, depth + 1)
    if not below:
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET {words(np.zeros(3))}", f"{pad}\t}}"]
    return [*lines, f"{pad}}}"]


def words(values: Floats) -> str:
    return " ".join(f"{value:.8f}" for value in values)
