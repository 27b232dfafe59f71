"""Networks in ONNX files, run by onnxruntime on the processor, and what is said of them beside the file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from ..errors import UserError, first_line
from ..io.bounded import check_file, read_json, read_toml

MODEL_BYTES = 4 << 30
IMAGENET = ((123.675, 116.28, 103.53), (58.395, 57.12, 57.375))  # mean and standard deviation of RGB, 0 to 255
Triple = tuple[float, float, float]
Described = TypeVar("Described", bound=BaseModel)


def open_network(path: Path) -> Any:
    """The session of an ONNX file, of one thread: the same bits on any number of cores. UserError: none, or one that cannot
    be read."""
    check_file(path, MODEL_BYTES)
    try:
        import onnxruntime
    except ImportError:
        raise UserError(f"{path}: a network needs onnxruntime: pip install 'toile[detect]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise UserError(f"{path}: cannot be read as an ONNX network: {first_line(error)}") from None


def run_network(path: Path, session: Any, picture: Any) -> list[Any]:
    """All outputs for a normalised picture (3,H,W)."""
    input = session.get_inputs()[0]
    kind = np.float16 if input.type == "tensor(float16)" else np.float32
    try:
        return list(session.run(None, {input.name: picture[None].astype(kind)}))
    except Exception as error:
        raise UserError(f"{path}: does not run: {first_line(error)}") from None


def check_picture_input(path: Path, inputs: Any) -> None:
    """UserError: the network takes something else than one batch of pictures."""
    if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[1] != 3:
        raise UserError(f"{path}: its input is not one batch of pictures (N,3,H,W)")


def described(path: Path, model: type[Described], said: Mapping[str, Any]) -> Described:
    """The description of the network PATH: what exporters `said` of it, and NAME.toml beside it, which has the last word.
    UserError names the file and the field."""
    sidecar = path.with_suffix(".toml")
    told = {**said, **(read_toml(sidecar) if os.path.lexists(sidecar) else {})}
    try:
        return model(**told)
    except ValidationError as error:
        first = error.errors()[0]
        where = sidecar if sidecar.exists() else path.parent
        raise UserError(f"{where}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None


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
