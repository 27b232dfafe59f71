"""Names of a garment's loops, told by the body's bones that go through them."""

from collections import Counter

import numpy as np

ARM = ("clavicle", "shoulder", "upperarm", "lowerarm", "wrist", "metacarpal", "finger")
LEG = ("pelvis", "upperleg", "lowerleg", "foot", "toe")
SIDES = {"L": "left", "R": "right"}
ARMHOLE = 0.15  # of the upper arm's length: a loop nearer to the shoulder's joint is no sleeve's


def name_loops(model, V, loops):
    """A name for each loop [vertex indices] of a garment V (g,3) [m] that lies over the body `model` at rest.

    "neck" surrounds the neck, "hem" is the lowest that surrounds the trunk or both legs under a neck or a waist, "waist"
    the highest of a garment without neck; "sleeve_left" surrounds an arm, "armhole_left" its shoulder, "leg_left" a thigh,
    "ankle_left" what is below the knee. A loop that none of these fits alone is "loop0", "loop1", ... by its number."""
    found = [_surrounded(model, V[loop]) for loop in loops]
    names = ["neck" if "neck" in parts else next(iter(parts.values())) if len(parts) == 1 else "" for parts in found]
    round_trunk = [i for i, parts in enumerate(found) if "neck" not in parts and _is_trunk(parts)]
    for i in round_trunk:
        names[i] = ""
    if round_trunk:
        up = _up(model)
        round_trunk.sort(key=lambda i: V[loops[i]].mean(0) @ up)
        _name_trunk(model, names, round_trunk, V[loops[round_trunk[-1]]].mean(0) @ up, up)
    count = Counter(names)
    return tuple(name if name and count[name] == 1 else f"loop{i}" for i, name in enumerate(names))


def _name_trunk(model, names, rising, top, up):
    """Names the loops about the trunk, numbers of loops from low to high, the last of them at height `top`."""
    legs = any(name.startswith(("leg_", "ankle_")) for name in names)
    if "neck" in names:
        names[rising[0]] = "hem"
    elif legs:
        names[rising[-1]] = "waist"
    elif len(rising) > 1:
        low, high = model.J[model.joint("root")] @ up, model.J[model.joint("neck01")] @ up
        covered = any(name.startswith(("sleeve_", "armhole_")) for name in names) or top > 0.5 * (low + high)
        names[rising[-1]], names[rising[0]] = "neck" if covered else "waist", "hem"


def _is_trunk(parts):
    return "trunk" in parts or {"leg.L", "leg.R"} <= set(parts)


def _up(model):
    """Unit direction (3,) from the root to the neck."""
    way = model.J[model.joint("neck01")] - model.J[model.joint("root")]
    return way / np.linalg.norm(way)


def _surrounded(model, curve):
    """{part of the body: name of an opening there} of the bones that go through a closed curve (k,3)."""
    parts = {}
    if model.joint("root") is None or model.joint("neck01") is None:
        return parts
    for k, at in _bones_through(model, curve):
        stem, _, side = model.joint_roles[k].partition(".")
        if stem.startswith(("neck", "head")):
            parts["neck"] = "neck"
        elif stem.startswith("spine"):
            parts["trunk"] = ""
        elif stem.startswith(ARM) and side:
            parts[f"arm.{side}"] = f"{_arm_opening(model, stem, side, at)}_{SIDES[side]}"
        elif stem.startswith(LEG) and side:
            above = stem.startswith(("pelvis", "upperleg", "lowerleg01"))
            parts[f"leg.{side}"] = f"{'leg' if above else 'ankle'}_{SIDES[side]}"
    return parts


def _arm_opening(model, stem, side, at):
    shoulder, elbow = model.joint(f"upperarm01.{side}"), model.joint(f"lowerarm01.{side}")
    if stem.startswith(("clavicle", "shoulder")) or stem == "upperarm01":
        return "armhole"
    if shoulder is None or elbow is None:
        return "sleeve"
    upper_arm = np.linalg.norm(model.J[elbow] - model.J[shoulder])
    return "armhole" if np.linalg.norm(at - model.J[shoulder]) < ARMHOLE * upper_arm else "sleeve"


def _bones_through(model, curve):
    """(joint, point (3,)) of each bone, from the joint's parent to it, that crosses the curve's plane inside the curve."""
    centre = curve.mean(0)
    axes = np.linalg.svd(curve - centre, full_matrices=False)[2]
    height = (model.J - centre) @ axes[2]
    flat = (curve - centre) @ axes[:2].T
    for k, p in enumerate(model.parents):
        if p < 0 or (height[k] > 0) == (height[p] > 0):
            continue
        at = model.J[p] + height[p] / (height[p] - height[k]) * (model.J[k] - model.J[p])
        to = flat - axes[:2] @ (at - centre)
        angle = np.arctan2(to[:, 1], to[:, 0])
        turns = np.diff(angle, append=angle[:1])
        if abs(((turns + np.pi) % (2 * np.pi) - np.pi).sum()) > np.pi:
            yield k, at
