"""Lists of 2D keypoints as detectors number them, by the names of the packaged body model.

What has no such name (eyes' centres, the middle of the hips) is left out. Sides are the person's.
"""

from __future__ import annotations

from collections.abc import Sequence

SIDED = {
    "shoulder": "body.upperarm01", "elbow": "body.lowerarm01", "wrist": "body.wrist", "hip": "body.upperleg01",
    "knee": "body.lowerleg01", "ankle": "body.foot", "big_toe": "body.big_toe", "small_toe": "body.small_toe",
    "heel": "body.heel", "ear": "face.ear",
}  # fmt: skip
COCO = ("nose", "eye L", "eye R", "ear L", "ear R", "shoulder L", "shoulder R", "elbow L", "elbow R", "wrist L",
        "wrist R", "hip L", "hip R", "knee L", "knee R", "ankle L", "ankle R")  # fmt: skip
FEET = ("big_toe L", "small_toe L", "heel L", "big_toe R", "small_toe R", "heel R")
BODIES = {
    "coco17": COCO,
    "openpose25": (
        "nose", "neck", "shoulder R", "elbow R", "wrist R", "shoulder L", "elbow L", "wrist L", "hips", "hip R", "knee R",
        "ankle R", "hip L", "knee L", "ankle L", "eye R", "eye L", "ear R", "ear L", *FEET,
    ),
    "openpose25b": (*COCO, "neck", "top", *FEET),
    "halpe26": (
        *COCO, "top", "neck", "hips", "big_toe L", "big_toe R", "small_toe L", "small_toe R", "heel L", "heel R",
    ),
}  # fmt: skip
FACE = {  # of the 68, and of OpenPose's 70
    8: "chin", 17: "brow_outer.R", 19: "brow_middle.R", 21: "brow_inner.R", 22: "brow_inner.L", 24: "brow_middle.L",
    26: "brow_outer.L", 27: "nose_bridge", 30: "nose_tip", 31: "nose_wing.R", 33: "subnasale", 35: "nose_wing.L",
    36: "eye_outer.R", 39: "eye_inner.R", 42: "eye_inner.L", 45: "eye_outer.L", 48: "mouth_corner.R", 51: "lip_upper",
    54: "mouth_corner.L", 57: "lip_lower",
}  # fmt: skip


def _body(words: Sequence[str]) -> list[str]:
    """The model's names of a list, "" where it has none."""
    names = []
    for word in words:
        part, _, side = word.partition(" ")
        names.append("face.nose_tip" if part == "nose" else f"{SIDED[part]}.{side}" if side and part in SIDED else "")
    return names


def _face(count: int) -> list[str]:
    return [f"face.{FACE[i]}" if i in FACE else "" for i in range(count)]


def _hand(side: str) -> list[str]:
    """The wrist, which the body's list has, and five fingers from the thumb on, each from its base to its tip."""
    word = {"L": "hand_left", "R": "hand_right"}[side]
    return ["", *(f"{word}.finger{i}-{joint}.{side}" for i in range(1, 6) for joint in (1, 2, 3, "tip"))]


SKELETONS = {name: tuple(_body(words)) for name, words in BODIES.items()}
FACES = {count: tuple(_face(count)) for count in (68, 70)}
HANDS = {side: tuple(_hand(side)) for side in "LR"}
# the nose of the face's list is the finer one
SKELETONS["coco_wholebody133"] = ("", *_body((*COCO, *FEET))[1:], *FACES[68], *HANDS["L"], *HANDS["R"])


def skeleton_of(count: int) -> str:
    """The name of the only list of so many points, or ""."""
    found = [name for name, names in SKELETONS.items() if len(names) == count]
    return found[0] if len(found) == 1 else ""
