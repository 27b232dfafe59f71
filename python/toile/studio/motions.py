"""The motions by their names, alone or joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .motion import FPS, RAMP, BodyMotion, eased, fast, range_of_motion, sit, smoothstep, talk, walk
from .motion_file import ENDINGS, motion_of_file
from .touch import touch_motion

JOIN = 30  # frames over which one motion passes into the next
BREATH = 3.0  # s
MOTIONS = {
    "walk": walk,
    "rom": range_of_motion,
    "talk": talk,
    "hands-on-cloth": touch_motion,
    "fast": fast,
    "sit": sit,
}


def make_motion(name, body, frames, rng):
    """One of MOTIONS, several of them joined by "+", or a path that ends in one of ENDINGS; eased in
    from the A-pose over RAMP frames."""
    if name.lower().endswith(ENDINGS):
        return eased(breathing(motion_of_file(name, body, RAMP + frames), rng))
    return eased(breathing(joined(name.split("+"), body, frames, rng), rng))


def breathing(motion, rng):
    """The motion with a breath as its last action: in and out again every BREATH seconds."""
    t = np.arange(len(motion.root)) / FPS
    breath = 0.5 - 0.5 * np.cos(2 * np.pi * (t / BREATH + rng.uniform()))
    return replace(motion, expression=np.concatenate([motion.expression, breath[:, None]], 1))


def joined(names, body, frames, rng):
    """The motions in turn, each an even share of the frames, blended over JOIN frames about each cut."""
    total, t = RAMP + frames, np.arange(RAMP + frames)
    cuts = [0, *(RAMP + frames * i // len(names) for i in range(1, len(names))), total]
    half = JOIN // 2
    begun = [np.ones(total), *(smoothstep((t - c + 0.5) / JOIN + 0.5) for c in cuts[1:-1]), np.zeros(total)]
    parts = []
    for i, name in enumerate(names):
        span = slice(max(cuts[i] - half, 0), min(cuts[i + 1] + half, total))
        parts.append((span, (begun[i] - begun[i + 1])[span], MOTIONS[name](body, span.stop - span.start, rng)))

    def blend(field):
        out = np.zeros((total, *getattr(parts[0][2], field).shape[1:]))
        for span, weight, motion in parts:
            values = getattr(motion, field)
            out[span] += values * weight.reshape(-1, *[1] * (values.ndim - 1))
        return out

    fields = {f: blend(f) for f in ("rotations", "root", "expression")}
    return BodyMotion(**fields, grounded=any(m.grounded for _, _, m in parts))
