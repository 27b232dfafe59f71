"""Units and up axis, told by a person's own proportions."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ...kernels.arrays import Floats
from .cameras import Finding

STATURE = (1.2, 2.2)  # m, of a person who may be measured
RARE = (0.8, 2.6)  # m, of a child or a giant; no unit is taken for another within it
LEG = 0.491  # of the stature from hip over knee to ankle (Winter 2009, table 4.1)
UNITS = {"mm": 1000.0, "cm": 100.0, "dm": 10.0, "m": 1.0, "inches": 39.37, "feet": 3.281}
STANDING = ("foot", "lowerleg01", "upperleg01", "upperarm01")  # the lowest that is known, and the shoulders
LEANS = np.cos(np.radians(50))
STANDS = np.cos(np.radians(30))
FACING = ("face.nose_tip", "face.ear.L", "face.ear.R")
PAIRS = ("body.upperarm01", "body.upperleg01")  # whose sides are asked which way the person faces
TOLD, MOST = 4, 0.9  # answers of frames, and the share of them that must agree
BENT = np.radians(30)  # a knee of less may be bent by the noise of its keypoints
BONES = {
    "thighs": ("body.upperleg01", "body.lowerleg01"),
    "shanks": ("body.lowerleg01", "body.foot"),
    "upper arms": ("body.upperarm01", "body.lowerarm01"),
    "forearms": ("body.lowerarm01", "body.wrist"),
}
SHOWN = 3  # names in a message
UNLIKE, SEVERAL = 1.6, 2  # times as long as the other side's, and bones that are: one may be badly seen
AXES = {"x": 0, "y": 1, "z": 2}


def stature(names: tuple[str, ...], points: Floats) -> float:
    """Of the person whose keypoints (T,K,3) are given, by her legs' bones; NaN without legs."""
    lengths = []
    for side in "LR":
        ends = [f"body.{joint}.{side}" for joint in ("upperleg01", "lowerleg01", "foot")]
        if all(end in names for end in ends):
            hip, knee, ankle = (points[:, names.index(end)] for end in ends)
            lengths.append(np.linalg.norm(hip - knee, axis=1) + np.linalg.norm(knee - ankle, axis=1))
    known = np.concatenate(lengths) if lengths else np.zeros(0)
    known = known[np.isfinite(known)]
    return float(np.median(known)) / LEG if len(known) else float("nan")


def check_names(names: Sequence[str], known: Collection[str]) -> Finding | None:
    """Names of keypoints against those that the body model has."""
    strange = [name for name in names if name not in known]
    if not strange:
        return None
    shown = ", ".join(map(repr, strange[:SHOWN])) + (", ..." if len(strange) > SHOWN else "")
    if len(strange) == len(names):
        return Finding(f"keypoints: the body model knows none of their names: {shown}")
    text = f"keypoints: the body model does not know {len(strange)} of {len(names)} names, which are left out: {shown}"
    return Finding(text, serious=False)


def check_units(tall: float, units: str) -> Finding | None:
    """`tall` is a stature as the scene's `units` make it."""
    if not np.isfinite(tall) or STATURE[0] <= tall <= STATURE[1]:
        return None
    if tall == 0:
        return Finding("units: the person's legs have no length: all their keypoints meet in one point")
    from ...io.scene_file import METRES

    if RARE[0] <= tall <= RARE[1]:
        advice = "a child or a very tall person, or lengths that are off"
        return Finding(f"units: the person is {tall:.3g} m tall by her legs' bones: {advice}", serious=False)
    raw = tall / METRES[units]
    fits = next((name for name, many in UNITS.items() if STATURE[0] * many <= raw <= STATURE[1] * many), None)
    if fits in METRES:
        advice = f'lengths look like {fits}: [scene] units = "{fits}"'
    else:
        advice = f"scale lengths by about {1.7 / tall:.3g}" + (f" (are they {fits}?)" if fits else "")
    return Finding(f"units: the person would be {tall:.3g} m tall; {advice}")


def upward(names: tuple[str, ...], points: Floats) -> Floats | None:
    """Direction (3,) from the feet over the hips to the shoulders, the median of the frames; None without them."""
    *legs, shoulders = (f"body.{joint}" for joint in STANDING)
    low, high = _middle(names, points, tuple(legs)), _middle(names, points, (shoulders,))
    along = high - low
    along = along[np.isfinite(along).all(1)]
    if not len(along):
        return None
    middle = np.median(along / np.linalg.norm(along, axis=1, keepdims=True), axis=0)
    return middle / max(float(np.linalg.norm(middle)), 1e-12)


def check_sides(names: tuple[str, ...], points: Floats) -> Finding | None:
    """Against the way that the person's (T,K,3) face and toes point, and that knees bend: her left is on the left of it."""
    up = _middle(names, points, ("body.upperarm01",)) - _middle(names, points, ("body.upperleg01",))
    left = [points[:, names.index(f"{j}.L")] - points[:, names.index(f"{j}.R")] for j in PAIRS if _sided(names, j)]
    ways = [_toes(names, points), _nose(names, points), *(_knee(names, points, side) for side in "LR")]
    turns = [np.einsum("ti,ti->t", np.cross(up, way), side) for side in left for way in ways]
    told = np.concatenate(turns) if turns else np.zeros(0)
    told = told[np.isfinite(told)]
    if len(told) < TOLD or (told < 0).mean() < MOST:
        return None
    return Finding(
        "keypoints: left and right are exchanged: face, toes or bent knees point backwards in nearly all frames"
    )


def check_bones(names: tuple[str, ...], points: Floats) -> Finding | None:
    """Bones of the left (T,K,3) against those of the right, whose lengths are the same unless the points' names are others'."""
    unlike = []
    for bones, ends in BONES.items():
        if all(_sided(names, end) for end in ends):
            at = [[names.index(f"{end}.{side}") for end in ends] for side in "LR"]
            lengths = [np.linalg.norm(points[:, a] - points[:, b], axis=1) for a, b in at]
            short, long = sorted(
                float(np.median(of[np.isfinite(of)])) if np.isfinite(of).any() else np.nan for of in lengths
            )
            if long > UNLIKE * short:
                unlike.append(f"{bones} of {100 * short:.0f} and {100 * long:.0f} cm")
    if len(unlike) < SEVERAL:
        return None
    return Finding(f"keypoints: {', '.join(unlike)}: are their names those of another list (toile import --skeleton)?")


def _toes(names: tuple[str, ...], points: Floats) -> Floats:
    """From the heels (T,3), or else the ankles, to the big toes."""
    return _middle(names, points, ("body.big_toe",)) - _middle(names, points, ("body.heel", "body.foot"))


def _nose(names: tuple[str, ...], points: Floats) -> Floats:
    """From between the ears (T,3) to the nose's tip."""
    if "face.nose_tip" not in names:
        return np.full((len(points), 3), np.nan)
    return points[:, names.index("face.nose_tip")] - _middle(names, points, ("face.ear",))


def _knee(names: tuple[str, ...], points: Floats, side: str) -> Floats:
    """From the line between hip and ankle (T,3) to the knee, where it is BENT; NaN elsewhere."""
    ends = [f"body.{joint}.{side}" for joint in ("upperleg01", "lowerleg01", "foot")]
    if not all(end in names for end in ends):
        return np.full((len(points), 3), np.nan)
    hip, knee, ankle = (points[:, names.index(end)] for end in ends)
    thigh, shank = ((a - b) / np.linalg.norm(a - b, axis=1, keepdims=True) for a, b in ((knee, hip), (ankle, knee)))
    bent = np.einsum("ti,ti->t", thigh, shank) < np.cos(BENT)
    return np.where(bent[:, None], thigh - shank, np.nan)


def _sided(names: tuple[str, ...], joint: str) -> bool:
    return f"{joint}.L" in names and f"{joint}.R" in names


def _middle(names: tuple[str, ...], points: Floats, joints: tuple[str, ...]) -> Floats:
    """Mean (T,3) of the first of `joints` that is known on both sides."""
    for joint in joints:
        pair = [f"{joint}.{side}" for side in "LR"]
        if all(name in names for name in pair):
            both = np.mean([points[:, names.index(name)] for name in pair], axis=0)
            if np.isfinite(both).all(1).any():
                return both
    return np.full((len(points), 3), np.nan)


def check_up(along: Floats | None, up: str) -> Finding | None:
    """Against the direction in which the person stands."""
    if along is None or along[AXES[up]] > LEANS:
        return None
    axis = int(np.abs(along).argmax())
    if abs(along[axis]) < STANDS:
        return Finding(f'up: the person stands along no axis ({_shown(along)}); is up = "{up}" right?', serious=False)
    name = "xyz"[axis]
    if along[axis] > 0:
        return Finding(f'up: the person stands along {name}: [scene] up = "{name}", not "{up}"')
    return Finding(
        f"up: the person stands head down along {name}: turn the world by half a turn (toile import --up=-{name})"
    )


def _shown(v: Floats) -> str:
    return ", ".join(f"{x:.2f}" for x in v)
