"""Motions: rotation vectors per joint about world axes at rest (x = body's left, y = back, z = up), 30 frames a second.

Signs: spine +x bends forward, +y leans left, +z turns left; `upperarm01.L` +y lowers, -x and -z go forward; the right
side negates y and z. Limits keep the skin of arms and trunk from touching where the shirt lies between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .body import ACTIONS, BLINKS

FPS = 30.0
RAMP = 15  # frames from the A-pose into the motion, simulated but not captured

LIMITS = {  # degrees (low, high) per axis x, y, z, for the left side
    "spine": ((-3, 6), (-4, 4), (-6, 6)),
    "neck01": ((-8, 8), (-6, 6), (-12, 12)),
    "head": ((-10, 10), (-8, 8), (-18, 18)),
    "clavicle": ((0, 0), (-8, 2), (-6, 4)),
    "upperarm01": ((-40, 15), (-45, 12), (-25, 8)),
}
ELBOW = (-20, 60)  # degrees about (elbow - shoulder) x (wrist - elbow)
FINGER = (0, 25)  # degrees of extra curl per finger joint
MIRROR = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class BodyMotion:
    """`rotations` (RAMP + T, K, 3) [rad], `root` (RAMP + T, 3) shift of the pelvis [m], `expression` (RAMP + T, e)."""

    rotations: np.ndarray
    root: np.ndarray
    expression: np.ndarray
    grounded: bool  # True: the lowest vertex of each frame is put on the floor
    missing: tuple[str, ...] = ()  # joints that a motion file lacks


def eased(motion):
    """Blends the first RAMP frames in from the A-pose: the cloth was settled there."""
    s = smoothstep(np.arange(1, len(motion.root) + 1) / RAMP)
    return replace(
        motion,
        rotations=motion.rotations * s[:, None, None],
        root=motion.root * s[:, None],
        expression=motion.expression * s[:, None],
    )


def smoothstep(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def band_noise(n, cutoff, rng):
    """(n,) in (-1, 1): white noise through an order-3 Butterworth run both ways, unit variance, tanh(0.8 x)."""
    from scipy.signal import butter, sosfiltfilt

    pad = 300
    x = sosfiltfilt(butter(3, cutoff, fs=FPS, output="sos"), rng.standard_normal(n + 2 * pad))
    return np.tanh(0.8 * x / x.std())[pad : pad + n]


def between(u, low, high):
    """u in (-1, 1) to radians between low and high degrees."""
    return np.radians(0.5 * (low + high) + 0.5 * (high - low) * u)


def elbow_axis(body, side):
    shoulder, elbow, wrist = (body.J[body.model.joint(f"{j}.{side}")] for j in ("upperarm01", "lowerarm01", "wrist"))
    axis = np.cross(elbow - shoulder, wrist - elbow)
    return axis / np.linalg.norm(axis)


def finger_axes(body):
    """Joint index -> unit axis (3,) about which the finger curls."""
    axes = {}
    for side in "LR":
        for f in range(1, 6):
            k = [body.model.joint(f"finger{f}-{i}.{side}") for i in (1, 2, 3)]
            axis = np.cross(body.J[k[1]] - body.J[k[0]], body.J[k[2]] - body.J[k[1]])
            axes |= dict.fromkeys(k, axis / max(np.linalg.norm(axis), 1e-9))
    return axes


def add_fingers(rotations, body, rng):
    """Slow independent curls."""
    for k, axis in finger_axes(body).items():
        rotations[:, k] += between(band_noise(len(rotations), 1.0, rng), *FINGER)[:, None] * axis


def faces(n, rng, speech):
    """Weights (n,e) of ACTIONS: mouth moves when `speech`, the eyes blink together."""
    w = np.zeros((n, len(ACTIONS)))
    for i, a in enumerate(ACTIONS):
        if a not in BLINKS:
            top = (0.35 if speech else 0.08) if a != "browInnerUp" else 0.4
            w[:, i] = top * np.maximum(band_noise(n, 3.0 if speech else 1.0, rng), 0)
    blink = np.maximum(0, 1 - np.abs((np.arange(n) + rng.integers(90)) % 90 - 4) / 4)
    w[:, [ACTIONS.index(b) for b in BLINKS]] = blink[:, None]
    return w


def talk(body, n, rng):
    """Standing and gesturing, non-periodic."""
    R = np.zeros((n, len(body.J), 3))
    cutoff = {"spine": 0.5, "neck01": 0.8, "head": 0.9, "clavicle": 0.8, "upperarm01": 0.8}
    for key, limits in LIMITS.items():
        for joint in [j for j in body.model.joint_names if j.startswith(key)]:
            mirror = MIRROR if joint.endswith(".R") else np.ones(3)
            for axis, (low, high) in enumerate(limits):
                if high > low:
                    u = band_noise(n, cutoff[key], rng)
                    R[:, body.model.joint(joint), axis] = mirror[axis] * between(u, low, high)
    for side in "LR":
        bend = between(band_noise(n, 1.0, rng), *ELBOW)
        R[:, body.model.joint(f"lowerarm01.{side}")] = bend[:, None] * elbow_axis(body, side)
    add_fingers(R, body, rng)
    return BodyMotion(R, np.zeros((n, 3)), faces(n, rng, speech=True), grounded=False)


def walk(body, n, rng):
    """A walk cycle on the spot (as on a treadmill), about one stride a second, with sway and a slow turn."""
    R = np.zeros((n, len(body.J), 3))
    rate = rng.uniform(0.85, 1.05)  # strides per second
    phase = 2 * np.pi * (rng.uniform() + rate * np.arange(n) / FPS)
    swing, lower = np.radians(rng.uniform(18, 24)), np.radians(16)
    for side, shift, sign in (("L", 0.0, 1.0), ("R", np.pi, -1.0)):
        p = phase + shift
        R[:, body.model.joint(f"upperleg01.{side}"), 0] = -swing * np.sin(p) - np.radians(4)
        R[:, body.model.joint(f"lowerleg01.{side}"), 0] = np.radians(8) + np.radians(42) * np.maximum(0, np.cos(p)) ** 2
        R[:, body.model.joint(f"foot.{side}"), 0] = np.radians(8) * np.sin(p)
        R[:, body.model.joint(f"upperarm01.{side}"), 0] = 0.8 * swing * np.sin(p)
        R[:, body.model.joint(f"upperarm01.{side}"), 1] = sign * lower
        bend = np.radians(14) - np.radians(12) * np.sin(p)
        R[:, body.model.joint(f"lowerarm01.{side}")] = bend[:, None] * elbow_axis(body, side)
    for joint, gain in (("spine04", 1.0), ("spine02", 1.0), ("head", -1.5)):
        R[:, body.model.joint(joint), 2] = gain * np.radians(3) * np.sin(phase)
        R[:, body.model.joint(joint), 0] = np.radians(1) * np.cos(2 * phase) + np.radians(1)
    R[:, body.model.joint("root"), 2] = np.radians(20) * band_noise(n, 0.3, rng)
    add_fingers(R, body, rng)
    root = np.stack([0.02 * np.sin(phase), 0.03 * band_noise(n, 0.3, rng), np.zeros(n)], 1)
    return BodyMotion(R, root, faces(n, rng, speech=False), grounded=True)


HAND_SPEED = (2.3, 2.9)  # m/s, of the faster hand at its fastest


def fast(body, n, rng):
    """Arms thrown forward and back in turn, the trunk turning with them, so fast that a hand reaches HAND_SPEED."""

    def rotations(phase):
        R = np.zeros((len(phase), len(body.J), 3))
        for side, shift, sign in (("L", 0.0, 1.0), ("R", np.pi, -1.0)):
            p = phase + shift
            R[:, body.model.joint(f"upperarm01.{side}"), 0] = np.radians(-28) - np.radians(42) * np.sin(p)
            R[:, body.model.joint(f"upperarm01.{side}"), 1] = -sign * np.radians(4)
            bend = np.radians(28) - np.radians(22) * np.sin(p + 0.6)
            R[:, body.model.joint(f"lowerarm01.{side}")] = bend[:, None] * elbow_axis(body, side)
            R[:, body.model.joint(f"upperleg01.{side}"), 0] = np.radians(-6) + np.radians(5) * np.sin(p)
            R[:, body.model.joint(f"lowerleg01.{side}"), 0] = np.radians(10)
        for joint in ("spine04", "spine02"):
            R[:, body.model.joint(joint), 2] = np.radians(5) * np.sin(phase)
        return R

    turn = np.linspace(0, 2 * np.pi, 60)  # one cycle: the speed is proportional to the rate
    wrists = [body.model.joint(f"wrist.{side}") for side in "LR"]
    path = np.array([body.joints(R, np.zeros(3))[wrists] for R in rotations(turn)])
    per_radian = np.linalg.norm(np.diff(path, axis=0), axis=2).max() / (turn[1] - turn[0])
    rate = rng.uniform(*HAND_SPEED) / per_radian  # rad/s
    R = rotations(2 * np.pi * rng.uniform() + rate * np.arange(n) / FPS)
    add_fingers(R, body, rng)
    return BodyMotion(R, np.zeros((n, 3)), faces(n, rng, speech=False), grounded=True)


def sit(body, n, rng):
    """Sitting on a high seat that is not there: hips and knees bent, hands moving above the lap."""
    R = np.zeros((n, len(body.J), 3))
    hip, knee = np.radians(rng.uniform(62, 70)), np.radians(rng.uniform(60, 72))
    for side, sign in (("L", 1.0), ("R", -1.0)):
        sway = 1 + 0.05 * band_noise(n, 0.5, rng)
        R[:, body.model.joint(f"upperleg01.{side}"), 0] = -hip * sway
        R[:, body.model.joint(f"upperleg01.{side}"), 2] = sign * np.radians(10)
        R[:, body.model.joint(f"lowerleg01.{side}"), 0] = knee * sway
        R[:, body.model.joint(f"upperarm01.{side}"), 0] = between(band_noise(n, 0.8, rng), -32, -18)
        bend = between(band_noise(n, 0.8, rng), 15, 50)
        R[:, body.model.joint(f"lowerarm01.{side}")] = bend[:, None] * elbow_axis(body, side)
    for axis, (low, high) in enumerate(((-3, 3), (-3, 3), (-5, 5))):
        R[:, body.model.joint("spine03"), axis] = between(band_noise(n, 0.5, rng), low, high)
    R[:, body.model.joint("head"), 2] = between(band_noise(n, 0.8, rng), -15, 15)
    add_fingers(R, body, rng)
    return BodyMotion(R, np.zeros((n, 3)), faces(n, rng, speech=True), grounded=True)


ROM = (  # (joint, axis, degrees); both sides move, mirrored
    ("upperarm01", 1, -45), ("upperarm01", 0, -38), ("upperarm01", 2, -24), ("lowerarm01", None, 58),
    ("spine", 2, 6), ("spine", 0, 6), ("spine", 1, 4), ("neck01", 2, 12), ("head", 2, 18), ("head", 0, 10),
    ("clavicle", 1, -8), ("upperleg01", 0, -35), ("lowerleg01", 0, 45),
)  # fmt: skip


def range_of_motion(body, n, rng):
    """The joints of ROM in turn, each out and back in 28 frames, two or three under way at any time.

    The first round goes all the way; later ones take another order and other amplitudes, so that no round repeats.
    """
    R = np.zeros((n, len(body.J), 3))
    length, every = 28, 12
    order = np.r_[rng.permutation(4), 4 + rng.permutation(len(ROM) - 4)]  # arms first: short clips show them too
    share = np.ones(len(ROM))
    for turn, start in enumerate(range(2, n, every)):
        at = turn % len(ROM)
        if turn and at == 0:
            order, share = rng.permutation(len(ROM)), rng.uniform(0.4, 1, len(ROM))
        key, axis, degrees = ROM[order[at]]
        degrees *= share[at]
        bump = np.sin(np.pi * np.clip((np.arange(n) - start) / length, 0, 1)) ** 2 * np.radians(degrees)
        one_sided = key in ("upperleg01", "lowerleg01") and rng.choice(["L", "R"])
        for joint in [j for j in body.model.joint_names if j.startswith(key)]:
            if one_sided and not joint.endswith(one_sided):
                continue
            side = joint[-1]
            e = elbow_axis(body, side) if axis is None else np.eye(3)[axis] * (MIRROR if side == "R" else 1)
            R[:, body.model.joint(joint)] += bump[:, None] * e
    add_fingers(R, body, rng)
    return BodyMotion(R, np.zeros((n, 3)), faces(n, rng, speech=False), grounded=True)


def world_pose(motion, body, ground, k):
    """Frame k in the world: vertices (n,3), rotations, translation; `ground` [m] lifts the rest pose to the floor."""
    R, translation = motion.rotations[k], motion.root[k] + [0, 0, ground]
    V = body.pose(R, translation, motion.expression[k])
    if motion.grounded:
        drop = np.array([0, 0, V[:, 2].min()])
        V, translation = V - drop, translation - drop
    return V, R, translation
