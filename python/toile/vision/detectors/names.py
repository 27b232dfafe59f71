"""Tables of keypoints: which of a detector's points is which of the body model's. Points that no table names are left.

Sources: COCO-WholeBody (Jin et al. 2020), mmpose's dataset files, OpenPose's poseParameters, mediapipe's solutions. Left and
right are the person's own.
"""

from __future__ import annotations

BOTH = ("L", "R")
FINGERS = [f"finger{f}-{part}" for f in range(1, 6) for part in ("1", "2", "3", "tip")]


def _pairs(**numbers: tuple[int, int]) -> dict[str, int]:
    """{"body.wrist.L": 9, "body.wrist.R": 10} from wrist=(9, 10); a face's points come as face_ear=(3, 4)."""
    found = {}
    for name, pair in numbers.items():
        room, _, rest = name.partition("_") if name.startswith("face_") else ("body", "", name)
        found |= {f"{room}.{rest}.{side}": number for side, number in zip(BOTH, pair)}
    return found


def _hand(side: str, first: int) -> dict[str, int]:
    """A hand of 21 points from its wrist on: thumb to little finger, each from the palm to its tip."""
    return {f"hand_{side}.{finger}.{side[0].upper()}": first + 1 + i for i, finger in enumerate(FINGERS)}


def _face(first: int) -> dict[str, int]:
    """A face of 68 points; those between two of the model's are left."""
    middle = {"chin": 8, "nose_bridge": 27, "nose_tip": 30, "subnasale": 33, "lip_upper": 51, "lip_lower": 57}
    found = {f"face.{name}": number for name, number in middle.items()} | _pairs(
        face_brow_outer=(26, 17),
        face_brow_middle=(24, 19),
        face_brow_inner=(22, 21),
        face_nose_wing=(35, 31),
        face_eye_outer=(45, 36),
        face_eye_inner=(42, 39),
        face_mouth_corner=(54, 48),
    )
    return {name: first + number for name, number in found.items()}


_TRUNK = {"upperarm01": (5, 6), "lowerarm01": (7, 8), "wrist": (9, 10), "upperleg01": (11, 12)}
_COCO = {"face.nose_tip": 0} | _pairs(face_ear=(3, 4), **_TRUNK, lowerleg01=(13, 14), foot=(15, 16))
_BODY_25 = {"face.nose_tip": 0} | _pairs(
    upperarm01=(5, 2),
    lowerarm01=(6, 3),
    wrist=(7, 4),
    upperleg01=(12, 9),
    lowerleg01=(13, 10),
    foot=(14, 11),
    face_ear=(18, 17),
    big_toe=(19, 22),
    small_toe=(20, 23),
    heel=(21, 24),
)
_SAPIENS = {"face.nose_tip": 0} | _pairs(
    face_ear=(3, 4),
    upperarm01=(5, 6),
    lowerarm01=(7, 8),
    upperleg01=(9, 10),
    lowerleg01=(11, 12),
    foot=(13, 14),
    big_toe=(15, 18),
    small_toe=(16, 19),
    heel=(17, 20),
    wrist=(62, 41),
)
_MEDIAPIPE = _pairs(
    face_ear=(7, 8),
    upperarm01=(11, 12),
    lowerarm01=(13, 14),
    wrist=(15, 16),
    upperleg01=(23, 24),
    lowerleg01=(25, 26),
    foot=(27, 28),
    heel=(29, 30),
    big_toe=(31, 32),
)
_MEDIAPIPE_FACE = {
    "face.nose_tip": 4,
    "face.nose_bridge": 168,
    "face.subnasale": 2,
    "face.lip_upper": 0,
    "face.lip_lower": 17,
    "face.chin": 152,
    "face.forehead": 10,
} | _pairs(
    face_eye_outer=(263, 33),
    face_eye_inner=(362, 133),
    face_eye_upper=(386, 159),
    face_eye_lower=(374, 145),
    face_brow_inner=(285, 55),
    face_brow_middle=(334, 105),
    face_brow_outer=(276, 46),
    face_nose_wing=(278, 48),
    face_mouth_corner=(291, 61),
    face_cheek=(280, 50),
)


def _backwards(side: str, first: int) -> dict[str, int]:
    """A hand of 20 points, each finger from its tip to the palm."""
    names = [f"finger{f}-{part}" for f in range(1, 6) for part in ("tip", "3", "2", "1")]
    return {f"hand_{side}.{name}.{side[0].upper()}": first + i for i, name in enumerate(names)}


# {table: (number of points, {name: row})}
TABLES: dict[str, tuple[int, dict[str, int]]] = {
    "coco17": (17, _COCO),
    "coco_wholebody133": (
        133,
        _COCO
        | _face(23)
        | _pairs(big_toe=(17, 20), small_toe=(18, 21), heel=(19, 22))
        | _hand("left", 91)
        | _hand("right", 112),
    ),
    "halpe26": (26, _COCO | _pairs(big_toe=(20, 21), small_toe=(22, 23), heel=(24, 25))),
    "openpose25": (25, _BODY_25),
    "vitpose25": (
        25,
        {"face.nose_tip": 0}
        | _pairs(
            face_ear=(3, 4),
            upperarm01=(6, 7),
            lowerarm01=(8, 9),
            wrist=(10, 11),
            upperleg01=(12, 13),
            lowerleg01=(15, 16),
            foot=(17, 18),
            big_toe=(19, 22),
            small_toe=(20, 23),
            heel=(21, 24),
        ),
    ),
    "sapiens308": (308, _SAPIENS | _backwards("right", 21) | _backwards("left", 42)),
    "mediapipe33": (33, {"face.nose_tip": 0} | _MEDIAPIPE),
    "mediapipe543": (
        543,
        _MEDIAPIPE
        | {name: 33 + row for name, row in _MEDIAPIPE_FACE.items()}
        | _hand("left", 501)
        | _hand("right", 522),
    ),
}


def tables_of(count: int) -> list[str]:
    """Names of the tables of that many points."""
    return [name for name, (k, _) in TABLES.items() if k == count]


def mirrored(name: str) -> str:
    """The same point of the other side: "hand_left.finger1-1.L" -> "hand_right.finger1-1.R"; itself on the middle."""
    if not name.endswith((".L", ".R")):
        return name
    other = {"L": "R", "R": "L"}[name[-1]]
    swapped = name.replace("_left.", "_?.").replace("_right.", "_left.").replace("_?.", "_right.")
    return f"{swapped[:-1]}{other}"
