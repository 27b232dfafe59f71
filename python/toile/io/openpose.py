"""OpenPose's JSON, a file a camera and frame: `people[]` with flat u, v, confidence of body, face and hands.

Taken: the person of the highest summed confidence. Left: all others, `person_id`, 3D. Points at (0, 0) are unseen. Pixels
have their centres at whole numbers there, at halves here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UserError
from ..kernels.arrays import Floats
from .bounded import read_json
from .keypoints import SUREST
from .skeletons import FACES, HANDS, SKELETONS, skeleton_of

LISTS = {"pose": "pose_keypoints_2d", "face": "face_keypoints_2d"}
SIDES = {"L": "hand_left_keypoints_2d", "R": "hand_right_keypoints_2d"}


def read_person(path: Path, skeleton: str = "") -> tuple[dict[str, Floats], int]:
    """{name: (3,) u, v, confidence} of the surest person, {} without one, and the count of people. `skeleton` names the
    body's list, needed where several have its length. UserError names the file and the field."""
    if skeleton and skeleton not in SKELETONS:
        raise UserError(f"--skeleton {skeleton}: expected one of {', '.join(SKELETONS)}")
    people = read_json(path, dict).get("people")
    if not isinstance(people, list) or not all(isinstance(person, dict) for person in people):
        raise UserError(f"{path}: people: expected a list of people, as OpenPose writes")
    found = [_person(path, i, person, skeleton) for i, person in enumerate(people)]
    sure = [sum(row[2] for row in person.values()) for person in found]
    return (found[int(np.argmax(sure))] if found else {}), len(found)


def _person(path: Path, i: int, person: dict[str, Any], skeleton: str) -> dict[str, Floats]:
    points: dict[str, Floats] = {}
    for side, key in SIDES.items():
        points |= _named(_rows(path, i, person, key), HANDS[side], path, f"people.{i}.{key}")
    face = _rows(path, i, person, LISTS["face"])
    if len(face):
        points |= _named(face, FACES.get(len(face), ()), path, f"people.{i}.{LISTS['face']}")
    body = _rows(path, i, person, LISTS["pose"])
    name = skeleton or skeleton_of(len(body))
    if len(body) and name not in SKELETONS:
        known = (
            ", ".join(key for key, names in SKELETONS.items() if len(names) == len(body)) or "no list of that length"
        )
        raise UserError(f"{path}: people.{i}: {len(body)} body points: say which list they are by --skeleton: {known}")
    return points | _named(body, SKELETONS.get(name, ()), path, f"people.{i}.{LISTS['pose']}")


def _rows(path: Path, i: int, person: dict[str, Any], key: str) -> Floats:
    try:
        rows = np.array(person.get(key) or [], dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        raise UserError(f"{path}: people.{i}.{key}: expected u, v, confidence in a row") from None
    if not np.isfinite(rows).all():
        raise UserError(f"{path}: people.{i}.{key}: a number that is not finite")
    if (rows[:, 2] > SUREST).any():
        raise UserError(f"{path}: people.{i}.{key}: a confidence of {rows[:, 2].max():g}, expected 0 to 1")
    return rows


def _named(rows: Floats, names: tuple[str, ...], path: Path, field: str) -> dict[str, Floats]:
    if len(rows) and len(rows) != len(names):
        raise UserError(f"{path}: {field}: {len(rows)} points, expected {len(names) or 'another list'}")
    shift = np.array([0.5, 0.5, 0.0])
    return {name: row + shift for name, row in zip(names, rows) if name and row[2] > 0}
