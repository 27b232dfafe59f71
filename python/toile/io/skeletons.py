"""Lists of 2D keypoints as detectors number them, by the names of the packaged body model.

What has no such name (eyes' centres, the middle of the hips) is left out. Sides are the person's. Sources: COCO-WholeBody
(Jin et al. 2020), Halpe-FullBody (Fang et al. 2022), mmpose's dataset files, OpenPose's poseParameters, ViTPose, Sapiens, mediapipe's solutions. Nothing of
toile is imported here: detectors in environments of their own read this file.
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
MARKS = ("eye inner L", "eye L", "eye outer L", "eye inner R", "eye R", "eye outer R")
FEET = ("big_toe L", "small_toe L", "heel L", "big_toe R", "small_toe R", "heel R")
BODIES = {
    "coco17": COCO,
    "openpose18": (
        "nose", "neck", "shoulder R", "elbow R", "wrist R", "shoulder L", "elbow L", "wrist L", "hip R", "knee R",
        "ankle R", "hip L", "knee L", "ankle L", "eye R", "eye L", "ear R", "ear L",
    ),
    "openpose25": (
        "nose", "neck", "shoulder R", "elbow R", "wrist R", "shoulder L", "elbow L", "wrist L", "hips", "hip R", "knee R",
        "ankle R", "hip L", "knee L", "ankle L", "eye R", "eye L", "ear R", "ear L", *FEET,
    ),
    "openpose25b": (*COCO, "neck", "top", *FEET),
    "halpe26": (
        *COCO, "top", "neck", "hips", "big_toe L", "big_toe R", "small_toe L", "small_toe R", "heel L", "heel R",
    ),
    "vitpose25": (*COCO[:5], "neck", *COCO[5:13], "hips", *COCO[13:], *FEET),
    "mediapipe33": (
        "nose", *MARKS, "ear L", "ear R", "mouth L", "mouth R", *COCO[5:11], "pinky L", "pinky R", "index L", "index R",
        "thumb L", "thumb R", *COCO[11:], "heel L", "heel R", "big_toe L", "big_toe R",
    ),
}  # fmt: skip
FACE = {  # of the 68, and of OpenPose's 70
    8: "chin", 17: "brow_outer.R", 19: "brow_middle.R", 21: "brow_inner.R", 22: "brow_inner.L", 24: "brow_middle.L",
    26: "brow_outer.L", 27: "nose_bridge", 30: "nose_tip", 31: "nose_wing.R", 33: "subnasale", 35: "nose_wing.L",
    36: "eye_outer.R", 39: "eye_inner.R", 42: "eye_inner.L", 45: "eye_outer.L", 48: "mouth_corner.R", 51: "lip_upper",
    54: "mouth_corner.L", 57: "lip_lower",
}  # fmt: skip
WORD = {"L": "hand_left", "R": "hand_right"}
MESH = {  # of mediapipe's 478 of a face
    0: "lip_upper", 2: "subnasale", 4: "nose_tip", 10: "forehead", 17: "lip_lower", 33: "eye_outer.R", 46: "brow_outer.R",
    48: "nose_wing.R", 50: "cheek.R", 55: "brow_inner.R", 61: "mouth_corner.R", 105: "brow_middle.R", 133: "eye_inner.R",
    145: "eye_lower.R", 152: "chin", 159: "eye_upper.R", 168: "nose_bridge", 263: "eye_outer.L", 276: "brow_outer.L",
    278: "nose_wing.L", 280: "cheek.L", 285: "brow_inner.L", 291: "mouth_corner.L", 334: "brow_middle.L",
    362: "eye_inner.L", 374: "eye_lower.L", 386: "eye_upper.L",
}  # fmt: skip


def _body(words: Sequence[str]) -> list[str]:
    """The model's names of a list, "" where it has none."""
    names = []
    for word in words:
        part, _, side = word.partition(" ")
        names.append("face.nose_tip" if part == "nose" else f"{SIDED[part]}.{side}" if side and part in SIDED else "")
    return names


def _face(count: int, points: dict[int, str] = FACE) -> list[str]:
    return [f"face.{points[i]}" if i in points else "" for i in range(count)]


def _hand(side: str) -> list[str]:
    """The wrist, which the body's list has, and five fingers from the thumb on, each from its base to its tip."""
    return ["", *(_finger(side, i, joint) for i in range(1, 6) for joint in (1, 2, 3, "tip"))]


def _backwards(side: str) -> list[str]:
    """Five fingers, each from its tip to its base, then the wrist."""
    return [*(_finger(side, i, joint) for i in range(1, 6) for joint in ("tip", 3, 2, 1)), f"body.wrist.{side}"]


def _finger(side: str, number: int, joint: int | str) -> str:
    return f"{WORD[side]}.finger{number}-{joint}.{side}"


def _without(names: Sequence[str], left: str) -> list[str]:
    return ["" if name == left else name for name in names]


SKELETONS = {name: tuple(_body(words)) for name, words in BODIES.items()}
FACES = {count: tuple(_face(count)) for count in (68, 70)}
HANDS = {side: tuple(_hand(side)) for side in "LR"}
# where a face has a list of its own, its nose is the finer one
SKELETONS["coco_wholebody133"] = (
    *_without(_body((*COCO, *FEET)), "face.nose_tip"), *FACES[68], *HANDS["L"], *HANDS["R"],
)  # fmt: skip
SKELETONS["halpe136"] = (
    *_without(SKELETONS["halpe26"], "face.nose_tip"), *FACES[68], *HANDS["L"], *HANDS["R"],
)  # fmt: skip
SKELETONS["mediapipe543"] = (
    *_without(SKELETONS["mediapipe33"], "face.nose_tip"), *_face(468, MESH), *HANDS["L"], *HANDS["R"],
)  # fmt: skip
_SAPIENS = (*_body((*COCO[:9], *COCO[11:], *FEET)), *_backwards("R"), *_backwards("L"))
SKELETONS["sapiens308"] = (*_SAPIENS, *[""] * (308 - len(_SAPIENS)))


def skeleton_of(count: int) -> str:
    """The name of the only list of so many points, or ""."""
    found = [name for name, names in SKELETONS.items() if len(names) == count]
    return found[0] if len(found) == 1 else ""


def rows_of(skeleton: str) -> dict[str, int]:
    """{name: its row} of a list."""
    return {name: row for row, name in enumerate(SKELETONS[skeleton]) if name}
