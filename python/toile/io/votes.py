"""votes.json: what a person says of the labels of places on the tracked surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..errors import UserError
from ..scene import Vote
from .bounded import read_json

MOST = 2**31  # vertices
FRAMES = 1_000_000  # frame numbers have six digits


class _Vote(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    label: str
    vertices: list[int] = Field(min_length=1)
    prefer: bool = False
    forbid: bool = False
    frames: list[int] | None = Field(None, min_length=1)


def read_votes(path: Path, labels: dict[str, int]) -> tuple[Vote, ...]:
    """The votes of a file [{"label", "vertices": [...], "prefer": true or "forbid": true, "frames": [...]}, ...], of all frames
    where none are named. UserError names the file and the field."""
    try:
        votes = TypeAdapter(list[_Vote]).validate_python(read_json(path, list))
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
    return tuple(_vote(path, i, vote, labels) for i, vote in enumerate(votes))


def _vote(path: Path, i: int, vote: Any, labels: dict[str, int]) -> Vote:
    if vote.label not in labels:
        raise UserError(f"{path}: {i}.label: '{vote.label}' is not in scene.toml's [labels]")
    if vote.prefer == vote.forbid:
        raise UserError(f'{path}: {i}: expected one of "prefer": true and "forbid": true')
    for vertex in vote.vertices:
        if not 0 <= vertex < MOST:
            raise UserError(f"{path}: {i}.vertices: {vertex} is no vertex")
    for frame in vote.frames or ():
        if not 0 <= frame < FRAMES:
            raise UserError(f"{path}: {i}.frames: {frame} is no frame number")
    frames = None if vote.frames is None else tuple(vote.frames)
    return Vote(labels[vote.label], np.unique(np.array(vote.vertices, np.int64)), vote.prefer, frames)
