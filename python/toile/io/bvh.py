"""Reads BVH files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import UserError
from .bounded import read_bytes
from .retargeting import MovingFigure

MAX_BYTES = 200_000_000
CLIP = re.compile(r"\s*Frames?\s*:\s*([-+\d]+)\s+Frame\s*Time\s*:\s*(\S+)", re.I)
LONGEST = 2.0  # s that a frame may last: 4 ms, a fast system's, read as seconds, are more


def read_bvh(path):
    """The MovingFigure of a BVH file; UserError names the file and what is wrong."""
    path = Path(path)
    head, found, tail = read_bytes(path, MAX_BYTES).decode("utf-8", errors="replace").partition("MOTION")
    if not found or "HIERARCHY" not in head:
        raise UserError(f"{path}: not a BVH file, HIERARCHY or MOTION is missing")
    try:
        names, parents, offsets, tips, channels = hierarchy(head.split())
        clip = CLIP.match(tail)
        if not clip:
            raise ValueError("after MOTION expected 'Frames: N' and 'Frame Time: SECONDS'")
        count, frame_time = int(clip[1]), float(clip[2])
        values = np.array(tail[clip.end() :].split(), dtype=np.float64)
        width = sum(map(len, channels))
        if count < 1:
            raise ValueError(f"Frames: {count}")
        if not 0 < frame_time <= LONGEST:
            asked = ": it is in seconds, not in milliseconds" if frame_time > LONGEST else ""
            raise ValueError(f"Frame Time: {frame_time:g}{asked}")
        if len(values) != count * width:
            raise ValueError(f"{len(values)} numbers for {count} frames of {width} channels")
        if not np.isfinite(values).all():
            frame, channel = divmod(int(np.flatnonzero(~np.isfinite(values))[0]), width)
            raise ValueError(f"frame {frame}, channel {channel}: {values[frame * width + channel]}")
    except (ValueError, IndexError, KeyError) as reason:
        raise UserError(f"{path}: broken BVH: {reason}") from reason
    rotations, places = play(values.reshape(count, width), parents, offsets, channels)
    return MovingFigure(names, parents, offsets, tips, rotations, places, frame_time)


def hierarchy(words):
    """Joint names, parents, offsets (j,3), those of End Sites {joint: (3,)}, and channel names from the HIERARCHY section."""
    names, parents, offsets, tips, channels, stack = [], [], [], {}, [], []
    i, ending = 0, False
    while i < len(words):
        word = words[i]
        if word in ("ROOT", "JOINT"):
            opened = words.index("{", i)
            names.append(" ".join(words[i + 1 : opened]))
            parents.append(stack[-1] if stack else -1)
            channels.append([])
            offsets.append([np.nan] * 3)
            i = opened
        elif word == "End":
            ending = True
            i += 2
        elif word == "{":
            stack.append(len(names) - 1)
            i += 1
        elif word == "}":
            stack.pop()
            ending = False
            i += 1
        elif word == "OFFSET":
            (tips if ending else offsets)[stack[-1]] = np.array(words[i + 1 : i + 4], dtype=np.float64)
            i += 4
        elif word == "CHANNELS":
            n = int(words[i + 1])
            channels[-1] = words[i + 2 : i + 2 + n]
            for name in channels[-1]:
                if not re.fullmatch("[XYZ](position|rotation)", name):
                    raise ValueError(
                        f"joint {names[-1]}: channel {name[:30]}: expected positions and rotations about X, Y, Z"
                    )
            i += 2 + n
        else:
            i += 1
    for name, offset in zip(names, offsets):
        if not np.isfinite(offset).all():
            raise ValueError(f"joint {name}: its OFFSET is missing or not finite")
    return tuple(names), tuple(parents), np.array(offsets), tips, channels


def play(values, parents, offsets, channels):
    """World rotations (T,j,3,3) and places (T,j,3) of joints. Any joint may have channels of its place, which stand for its OFFSET:
    of many files a joint above the hips rests at the origin, and the hips walk. Below another joint such that are 0 throughout
    say nothing."""
    from scipy.spatial.transform import Rotation

    T, at = len(values), 0
    world, places = np.empty((T, len(parents), 3, 3)), np.empty((T, len(parents), 3))
    for j, names in enumerate(channels):
        turn, place = np.broadcast_to(np.eye(3), (T, 3, 3)), np.tile(offsets[j], (T, 1))
        above, given = parents[j], list(zip(names, values.T[at:]))
        placed = above < 0 or any(of.any() for name, of in given if name.endswith("position"))
        for name, of in given:
            axis = "XYZ".index(name[0])
            if name.endswith("rotation"):
                turn = turn @ Rotation.from_rotvec(np.radians(of[:, None]) * np.eye(3)[axis]).as_matrix()
            elif placed:
                place[:, axis] = of
        at += len(names)
        world[:, j] = turn if above < 0 else world[:, above] @ turn
        places[:, j] = place if above < 0 else places[:, above] + np.einsum("tij,tj->ti", world[:, above], place)
    return world, places
