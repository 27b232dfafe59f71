"""What a network of keypoints in an ONNX file wants and gives: from the file itself, from the files that its exporter left
beside it, and from a description NAME.toml, which has the last word.

    kind = "simcc"            # or "heatmap"; else by the graph's outputs
    names = "halpe26"         # a list of io/skeletons.py, or a list of the body model's names, "" for points to leave
    mean = [123.675, 116.28, 103.53]   # of what `channels` says, for pixels of 0 to 255
    std = [58.395, 57.12, 57.375]
    channels = "rgb"          # or "bgr"
    padding = 1.25            # of the person's box
    score = "min"             # of the peaks along x and y ("mean"); simcc alone
    full_score = 1.0          # the peak that counts as full confidence
    unbiased = false          # heatmaps whose corners, not edges, fall together (UDP)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from ...errors import UserError
from ...io.skeletons import SKELETONS, rows_of
from ..networks import IMAGENET, Triple, check_picture_input, described, said_beside


class _Described(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["simcc", "heatmap"] | None = None
    names: str | list[str] | None = None
    mean: Triple = IMAGENET[0]
    std: Triple = IMAGENET[1]
    channels: Literal["rgb", "bgr"] = "rgb"
    padding: float = Field(1.25, ge=1, le=3)
    score: Literal["min", "mean"] = "min"
    full_score: float = Field(1.0, gt=0, allow_inf_nan=False)
    unbiased: bool = False


@dataclass(frozen=True)
class Description:
    """`size` (height, width) of the network's input, `rows` {name of a keypoint: its row of the outputs}; the rest as above."""

    size: tuple[int, int]
    kind: str
    rows: dict[str, int]
    mean: Triple
    std: Triple
    channels: str
    padding: float
    score: str
    full_score: float
    unbiased: bool


def describe(path: Path, inputs: Any, outputs: Any) -> Description:
    """The description of an ONNX file whose graph has these inputs and outputs. UserError names the file and the field."""
    check_picture_input(path, inputs)
    size = tuple(inputs[0].shape[2:])
    if not all(isinstance(side, int) and 0 < side <= 4096 for side in size):
        raise UserError(f"{path}: the size of its input is not fixed")
    given = described(path, _Described, said_beside(path))
    kind = given.kind or _kind(path, outputs)
    count = _count(path, kind, outputs)
    rows = _rows(path, given.names, count)
    rest = given.model_dump(exclude={"kind", "names"})
    return Description(size, kind, rows, **rest)


def _kind(path: Path, outputs: Any) -> str:
    if {out.name for out in outputs} >= {"simcc_x", "simcc_y"}:
        return "simcc"
    if len(outputs[0].shape) == 4:
        return "heatmap"
    raise UserError(f"{path}: its outputs are neither simcc_x and simcc_y nor heatmaps: say `kind` in {path.stem}.toml")


def _count(path: Path, kind: str, outputs: Any) -> int:
    shape = outputs[0].shape
    if len(shape) != (3 if kind == "simcc" else 4) or not isinstance(shape[1], int):
        raise UserError(f"{path}: output {outputs[0].name} has shape {list(shape)}, no row for each keypoint of {kind}")
    return shape[1]


def _rows(path: Path, names: str | list[str] | None, count: int) -> dict[str, int]:
    beside = f"say `names` in {path.stem}.toml"
    if isinstance(names, list):
        if len(names) != count:
            raise UserError(
                f"{path.with_suffix('.toml')}: names: {len(names)} of them, the network gives {count} points"
            )
        return {name: row for row, name in enumerate(names) if name}
    if names is None:
        fitting = [name for name, points in SKELETONS.items() if len(points) == count]
        if len(fitting) != 1:
            known = f"it may be one of {', '.join(fitting)}" if fitting else f"no known table has {count}"
            raise UserError(f"{path}: which {count} points it gives is not said ({known}): {beside}")
        names = fitting[0]
    if names not in SKELETONS:
        raise UserError(f"{path.with_suffix('.toml')}: names: '{names}', expected one of {', '.join(SKELETONS)}")
    if len(SKELETONS[names]) != count:
        raise UserError(f"{path}: gives {count} points, '{names}' has {len(SKELETONS[names])}: {beside}")
    return rows_of(names)
