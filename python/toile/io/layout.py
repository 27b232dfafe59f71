"""The layout of RUN/registered.zarr: which arrays it holds, of which shapes, types and units, and what a chunk is.

A zarr 3 group whose attributes are `Attributes`. `run` reads it, `run_writer` fills it; no other file names its arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel, Field

VERSION = 2  # an attribute of the store; a store without one is of version 1, whose arrays are the same
STORE = "registered.zarr"
PENDING, OK, FAILED = 0, 1, 2  # values of `done`
GOOD, DOUBTFUL, WRONG = 0, 1, 2  # values of `verdict`
VERDICTS = ("good", "doubtful", "wrong")


@dataclass(frozen=True)
class Stored:
    """One array. Axes: T frames, n and m vertices and faces of the body model, K joints, S shape coefficients, q facial
    keypoints, and of a garment g vertices, f faces, t texture vertices. `per_frame`: a chunk holds one frame, a file several
    of them, and empty chunks are written too; otherwise one chunk holds everything."""

    axes: str
    dtype: str
    per_frame: bool
    meaning: str
    when: str = "always"  # "face": the scene names facial keypoints; "garments": it names a garment


def _fixed(axes: str, dtype: str, meaning: str, when: str = "always") -> Stored:
    return Stored(axes, dtype, False, meaning, when)


def _framed(axes: str, dtype: str, meaning: str, when: str = "always") -> Stored:
    return Stored(axes, dtype, True, meaning, when)


CONFIDENCE = "2 observed, 1 interpolated, 0 hidden"
LAYOUT = {  # NAME stands for each garment
    "frames": _fixed("T", "int64", "numbers of the frames in the capture"),
    "done": _framed("T", "uint8", "0 pending, 1 ok, 2 failed (its arrays are NaN, or 0); written last"),
    "verdict": _framed("T", "uint8", "0 good, 1 doubtful, 2 wrong, also where it failed; older stores have none"),
    "identity": _framed("T", "uint64", "what the frame was made of, see pipeline/identity.py; older stores have none"),
    "shape": _fixed("S", "float64", "coefficients of the body model's shape basis"),
    "track/faces": _fixed("m 3", "int32", "of the body model"),
    "track/vertices": _framed("T n 3", "float64", "the clothed surface as one layer [m]"),
    "pose/rotations": _framed("T K 3", "float64", "rotation vectors about world axes, relative to the parent [rad]"),
    "pose/translation": _framed("T 3", "float64", "of the root [m]"),
    "confidence/track": _framed("T n", "uint8", CONFIDENCE),
    "face": _framed("T q 3", "float64", "facial keypoints in the head joint's frame [m], NaN where unseen", "face"),
    "labels": _framed("T n", "uint8", "label ids of the tracked surface", "garments"),
    "inner/faces": _fixed("m 3", "int32", "of the body model", "garments"),
    "inner/vertices": _framed("T n 3", "float64", "the body under the garments [m]", "garments"),
    "confidence/inner": _framed("T n", "uint8", CONFIDENCE, "garments"),
    "garment/NAME/faces": _fixed("f 3", "int32", "of the template", "garments"),
    "garment/NAME/uv": _fixed("t 2", "float64", "texture vertices, v up", "garments"),
    "garment/NAME/face_uv": _fixed("f 3", "int32", "into uv", "garments"),
    "garment/NAME/skin": _fixed("g K", "float64", "skinning weights, rows sum to 1", "garments"),
    "garment/NAME/vertices": _framed("T g 3", "float64", "[m]", "garments"),
    "confidence/NAME": _framed("T g", "uint8", CONFIDENCE, "garments"),
}
VERDICT = "verdict"
IDENTITY = "identity"
DIAGNOSTICS = "diagnostics"  # a group of STAGE/NAME (T,) float64, written once all frames are done


def layout_of(garments: list[str], face: bool) -> dict[str, tuple[Stored, str]]:
    """The arrays {key: (Stored, its garment or "")} of a run with these garments, and with facial keypoints or without."""
    there = {"always", *(["face"] if face else []), *(["garments"] if garments else [])}
    found = {}
    for key, stored in LAYOUT.items():
        for name in garments if "NAME" in key else [""]:
            if stored.when in there:
                found[key.replace("NAME", name)] = stored, name
    return found


class StoredGarment(BaseModel):
    """A garment of a run: the id of its label, and its openings {name: vertex indices in a cycle}."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$")
    label: int
    loops: dict[str, list[int]]


class StoredScene(BaseModel):
    """What a run knows of its scene: `labels` {name: id}, `garments` inner to outer."""

    name: str
    fps: float = Field(gt=0, allow_inf_nan=False)
    up: str = Field(pattern="^[xyz]$")
    labels: dict[str, int]
    garments: list[StoredGarment]


class Attributes(BaseModel):
    """The store's attributes. `body_model`: a packaged model's name, or a `.npz` inside the capture. `identity`: what the
    arrays that all frames share were made of. `holdout`: first and last number of the frames that nothing which other frames
    are made from has read."""

    version: int = 1
    scene: StoredScene
    joint_names: list[str]
    body_model: str
    identity: str = ""
    holdout: tuple[()] | tuple[int, int] = ()
