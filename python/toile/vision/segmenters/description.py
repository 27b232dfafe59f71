"""What a network of labels in an ONNX file wants and gives: from the file itself, from the files that its exporter left beside
it, and from a description NAME.toml, which has the last word.

    classes = "atr18"         # a table of `classes.TABLES`, or a list of names; else Hugging Face's id2label
    output = "logits"         # of several outputs; else the first
    kind = "logits"           # or "probabilities"; "labels" is what an output of integers gives
    size = [512, 512]         # height and width of the input, where the graph leaves them open
    mean = [123.675, 116.28, 103.53]   # of what `channels` says, for pixels of 0 to 255
    std = [58.395, 57.12, 57.375]
    channels = "rgb"          # or "bgr"
    fit = "stretch"           # of the picture to the input; "letterbox" keeps its shape
    person = false            # true: the largest connected part alone, looked at again in its box (the mean), or in the mask's
    padding = 1.25            # of that box
    blank = false             # true: where a mask is given, what is off it is shown as the mean
    mirror = false            # true: looks at the mirrored picture too, and gives the mean of both answers
    [labels]                  # of the scene, for each class; "" for the person without a label; a list: the one there is
    Upper-clothes = "tshirt"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ...errors import UserError
from ...io.bounded import read_json, read_toml
from ..networks import IMAGENET, Triple, check_picture_input, described, said_beside
from .classes import TABLES

BACKGROUND = "background"
SHARED = ("mean", "std", "channels")  # of what exporters say of any network
LARGEST = 4096  # px, of an input's sides


class _DescribedLabels(BaseModel):
    model_config = ConfigDict(extra="forbid")
    classes: str | list[str] | None = None
    output: str | None = None
    kind: Literal["logits", "probabilities", "labels"] | None = None
    size: tuple[int, int] | None = None
    mean: Triple = IMAGENET[0]
    std: Triple = IMAGENET[1]
    channels: Literal["rgb", "bgr"] = "rgb"
    fit: Literal["stretch", "letterbox"] = "stretch"
    person: bool = False
    padding: float = Field(1.25, ge=1, le=3)
    blank: bool = False
    mirror: bool = False
    labels: dict[str, str | list[str]] = {}


@dataclass(frozen=True)
class Parts:
    """`size` (height, width) of the network's input; `output`: which of its outputs; `ids` (C,): the scene's id of each class,
    0 background, -1 the person without a label; the rest as above."""

    size: tuple[int, int]
    output: int
    kind: str
    ids: Any
    mean: Triple
    std: Triple
    channels: str
    fit: str
    person: bool
    padding: float
    blank: bool
    mirror: bool


def describe(path: Path, inputs: Any, outputs: Any, labels: Mapping[str, int]) -> Parts:
    """The description of an ONNX file whose graph has these inputs and outputs, for a scene's labels {name: id}. UserError
    names the file and the field."""
    check_picture_input(path, inputs)
    sidecar = path.with_suffix(".toml")
    given = described(path, _DescribedLabels, _said(path))
    output, kind, count = _output(path, given, outputs)
    classes = _classes(path, given.classes, count)
    ids = _ids(sidecar, classes, given.labels, labels)
    rest = given.model_dump(include={*SHARED, "fit", "person", "padding", "blank", "mirror"})
    return Parts(_size(path, given.size, inputs[0].shape[2:]), output, kind, ids, **rest)


def _said(path: Path) -> dict[str, Any]:
    """What mmdeploy's or Hugging Face's files in the same folder say."""
    said = {name: value for name, value in said_beside(path).items() if name in SHARED}
    config, processor = path.with_name("config.json"), path.with_name("preprocessor_config.json")
    try:
        if processor.exists():
            size = read_json(processor, dict).get("size")
            if isinstance(size, dict) and {"height", "width"} <= size.keys():
                said["size"] = [size["height"], size["width"]]
        if config.exists() and "id2label" in (known := read_json(config, dict)):
            said["classes"] = [known["id2label"][str(i)] for i in range(len(known["id2label"]))]
    except (KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{config}: id2label: not as its exporter writes it: {error}") from None
    return said


def _size(path: Path, said: tuple[int, int] | None, shape: Any) -> tuple[int, int]:
    """The graph has the first word: exporters' files are stale at times."""
    fixed = all(isinstance(side, int) for side in shape)
    size = tuple(shape) if fixed else said
    if size is None:
        raise UserError(f"{path}: the size of its input is not fixed: say `size` in {path.stem}.toml")
    if not all(0 < side <= LARGEST for side in size):
        raise UserError(f"{path.with_suffix('.toml')}: size: {list(size)}, expected sides of 1 to {LARGEST}")
    if fixed and said is not None and tuple(said) != size and path.with_suffix(".toml").exists():
        if "size" in read_toml(path.with_suffix(".toml")):
            raise UserError(f"{path.with_suffix('.toml')}: size: {list(said)}, the network takes {list(size)}")
    return size


def _output(path: Path, given: _DescribedLabels, outputs: Any) -> tuple[int, str, int | None]:
    """Which output, its kind, and how many classes it has where its shape says so."""
    names = [out.name for out in outputs]
    if given.output is not None and given.output not in names:
        raise UserError(f"{path.with_suffix('.toml')}: output: '{given.output}', expected one of {', '.join(names)}")
    index = 0 if given.output is None else names.index(given.output)
    shape, integers = outputs[index].shape, "int" in outputs[index].type
    kind = given.kind or ("labels" if integers else "logits")
    if kind == "labels":
        if len(shape) not in (3, 4) or (len(shape) == 4 and shape[1] != 1):
            raise UserError(f"{path}: output {names[index]} has shape {list(shape)}, no label a pixel")
        return index, kind, None
    if len(shape) != 4 or integers:
        raise UserError(f"{path}: output {names[index]} has shape {list(shape)}, no number for each class and pixel")
    return index, kind, shape[1] if isinstance(shape[1], int) else None


def _classes(path: Path, said: str | list[str] | None, count: int | None) -> list[str]:
    sidecar = path.with_suffix(".toml")
    if isinstance(said, str):
        if said not in TABLES:
            raise UserError(f"{sidecar}: classes: '{said}', expected one of {', '.join(TABLES)} or a list")
        said = list(TABLES[said])
    if said is None:
        raise UserError(f"{path}: which classes it gives is not said: say `classes` in {path.stem}.toml")
    if count is not None and len(said) != count:
        raise UserError(f"{path}: gives {count} classes, {len(said)} are named: say `classes` in {path.stem}.toml")
    return said


def _ids(sidecar: Path, classes: list[str], said: Mapping[str, Any], labels: Mapping[str, int]) -> Any:
    """The scene's id (C,) of each class. A class called as a label, or background, needs no line."""
    strange = [name for name in said if name not in classes]
    if strange:
        raise UserError(f"{sidecar}: labels.{strange[0]}: the network has no such class: {', '.join(classes)}")
    own = {name.lower(): name for name in labels}
    ids = []
    for name in classes:
        given = said.get(name, own.get(name.lower(), BACKGROUND if name.lower() == BACKGROUND else None))
        if given is None:
            raise UserError(f'{sidecar}: labels: no line for class {name}: a label of the scene, "background" or ""')
        ids.append(_id(f"{sidecar}: labels.{name}", given, labels))
    return np.array(ids)


def _id(where: str, given: str | list[str], labels: Mapping[str, int]) -> int:
    if isinstance(given, list):
        there = [name for name in given if name in labels]
        if len(there) > 1:
            raise UserError(f"{where}: scene.toml's [labels] has {' and '.join(there)}: which of them is not told")
        return labels[there[0]] if there else -1
    if given not in labels and given not in ("", BACKGROUND):
        raise UserError(f"{where}: '{given}' is not in scene.toml's [labels]: {', '.join(labels)}")
    return labels.get(given, 0 if given else -1)
