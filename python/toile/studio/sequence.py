"""The truth of one sequence: body and shirt moved and checked, before anything is seen by a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import motion as motions
from . import truth as checks
from .body import TruthBody, make_body
from .garment import SIZES, put_on
from .touch import HAND, vertices_of


@dataclass(frozen=True)
class Truth:
    """One accepted sequence. Positions are float32: what is checked is what is stored."""

    body: TruthBody
    vertices: np.ndarray  # (T,n,3)
    rotations: np.ndarray  # (T,K,3)
    translation: np.ndarray  # (T,3)
    garment: np.ndarray | None  # (T,G,3)
    garment_faces: np.ndarray | None
    flat: np.ndarray | None  # (G,3) the garment's rest shape before placement
    draped: np.ndarray | None  # (G,3) settled on the truth body in its rest pose, without translation
    per_frame: list[dict]
    figures: dict


def make_truth(options, seed, progress):
    """Simulates and checks one seed; raises TruthRejected where a bound is broken."""
    streams = [np.random.default_rng([seed, i]) for i in range(2)]
    body = make_body(options.subject, streams[0])
    ground = -body.rest[:, 2].min()
    motion = motions.make_motion(options.motion, body, options.frames, streams[1])
    V, rotations, translation = map(np.array, zip(*motions.world_motion(motion, body, ground)))
    seen = slice(motions.RAMP, None)
    vertices = V[seen].astype(np.float32)
    figures = checks.check_motion(vertices, None)
    garment = F = flat = draped = None
    per_frame = []
    if options.garment is not None:
        flat, draped, F, garment, per_frame = clothe(options, body, V, vertices, ground, progress)
        figures |= checks.check_motion(vertices, garment) | summary(per_frame)
        figures["sliding_p90_mm"] = 1e3 * float(np.quantile(checks.sliding(garment, vertices), 0.9))
    figures["missing_joints"] = list(motion.missing)
    figures["offset_max_mm"] = 1e3 * float(np.linalg.norm(body.offset, axis=1).max())
    return Truth(body, vertices, rotations[seen], translation[seen], garment, F, flat, draped, per_frame, figures)


def clothe(options, body, V, vertices, ground, progress):
    """Dresses the body, simulates the shirt over ramp and motion V (RAMP+T,n,3), and checks every captured frame.

    Gives the flat garment, how it settled in the rest pose, its faces, garment (T,G,3) and what was measured.
    """
    lift = np.array([0, 0, ground])
    size = SIZES[options.subject]
    flat, rest, F, sim = put_on(options.garment, body, size, lift, lambda i, n: progress("dress", i, n))
    draped = sim.vertices - lift
    edges = checks.unique_edges(F)
    hands = np.concatenate([vertices_of(body, HAND, side) for side in "LR"])
    garment, per_frame = [], []
    for k in range(len(V)):
        cloth = sim.frame(V[k]).astype(np.float32)
        progress("simulate", k + 1, len(V))
        number = k - motions.RAMP
        if number >= 0:
            seen = vertices[number].astype(np.float64)
            cloth64 = cloth.astype(np.float64)
            per_frame.append(checks.check_frame(cloth64, F, rest, edges, seen, body.skin_faces, hands, number))
            garment.append(cloth)
    return flat, draped, F, np.array(garment), per_frame


def summary(per_frame):
    """Worst frame of each figure."""
    worst = {k: max(f[k] for f in per_frame) for k in ("strain_p99", "strain_max", "self_pairs")}
    return worst | {
        "clearance_min_mm": min(f["clearance_mm"] for f in per_frame),
        "hand_cloth_min_mm": min(f["hand_cloth_mm"] for f in per_frame),
        "self_piercing_frames": sum(f["self_pairs"] > 0 for f in per_frame),
    }
