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

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import UserError
from ...io.bounded import read_json, read_toml
from ...io.skeletons import SKELETONS, rows_of

IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))
Triple = tuple[float, float, float]


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
    if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[1] != 3:
        raise UserError(f"{path}: its input is not one batch of pictures (N,3,H,W)")
    size = tuple(inputs[0].shape[2:])
    if not all(isinstance(side, int) and 0 < side <= 4096 for side in size):
        raise UserError(f"{path}: the size of its input is not fixed")
    sidecar, said = path.with_suffix(".toml"), said_beside(path)
    if os.path.lexists(sidecar):
        said |= read_toml(sidecar)
    try:
        given = _Described(**said)
    except ValidationError as error:
        first = error.errors()[0]
        where = sidecar if sidecar.exists() else path.parent
        raise UserError(f"{where}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
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


def said_beside(path: Path) -> dict[str, Any]:
    """What mmdeploy's pipeline.json or Hugging Face's preprocessor_config.json in the same folder say."""
    mmdeploy, hugging = path.with_name("pipeline.json"), path.with_name("preprocessor_config.json")
    try:
        if mmdeploy.exists():
            return of_mmdeploy(read_json(mmdeploy, dict))
        if hugging.exists():
            return of_hugging_face(read_json(hugging, dict))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise UserError(
            f"{mmdeploy if mmdeploy.exists() else hugging}: not as its exporter writes it: {error}"
        ) from None
    return {}


def of_mmdeploy(pipeline: dict[str, Any]) -> dict[str, Any]:
    tasks = pipeline["pipeline"]["tasks"]
    transforms = {step["type"]: step for task in tasks for step in task.get("transforms", ())}
    decoders = [task.get("component", "") + str(task.get("params", {}).get("type", "")) for task in tasks]
    normal = transforms.get("Normalize", {})
    said = {"mean": normal.get("mean"), "std": normal.get("std")}
    said["channels"] = {True: "rgb", False: "bgr", None: None}[normal.get("to_rgb")]
    said["padding"] = transforms.get("TopDownGetBboxCenterScale", {}).get("padding")
    said["kind"] = "simcc" if any("SimCC" in name for name in decoders) else None
    return {name: value for name, value in said.items() if value is not None}


def of_hugging_face(config: dict[str, Any]) -> dict[str, Any]:
    full = 1 / config.get("rescale_factor", 1 / 255)
    said = {"padding": config.get("padding_factor"), "unbiased": config.get("do_affine_transform")}
    for own, theirs in (("mean", "image_mean"), ("std", "image_std")):
        said[own] = [full * value for value in config[theirs]] if theirs in config else None
    return {name: value for name, value in said.items() if value is not None}
