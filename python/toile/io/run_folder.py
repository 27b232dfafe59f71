"""What lies in a run's folder beside its store: what was asked for, the capture it names, and each frame's diagnostics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import UserError
from ..scene import BodyModel
from .body import model_in_capture
from .bounded import read_json, read_toml
from .files import write_text


def config_file(run: Path | str) -> Path:
    """Where a run keeps what it was asked for."""
    return Path(run) / "config.toml"


def read_config(run: Path | str) -> dict[str, Any]:
    """The tables of RUN/config.toml."""
    return read_toml(config_file(run))


def capture_folder(run: Path | str, check: bool = True) -> Path:
    """The folder of the capture that a run was made of: as it is named, else where it lies as seen from the run, which
    another machine may see elsewhere. UserError: with `check`, it is gone."""
    config = read_config(run)
    named, beside = config.get("capture"), config.get("capture_from_here")
    if not isinstance(named, str) or not named.isprintable():
        raise UserError(f"{config_file(run)}: capture: expected the path of a folder")
    near = Path(run) / beside if isinstance(beside, str) and beside.isprintable() else None
    if near is not None and not Path(named).is_dir() and near.is_dir():
        return near.resolve()
    if check and not Path(named).is_dir():
        raise UserError(f"{named}: the capture is gone; where it was moved: toile register WHERE {run} --moved")
    return Path(named)


def note_of(run: Path, frame: int) -> Path:
    """Where a run keeps what it has read of a frame: {"files": {file in the capture: [bytes, time [ns], sha256]}, ...}."""
    return run / "inputs" / f"{frame:06d}.json"


def scene_note_of(run: Path) -> Path:
    """Where a run keeps what it has read beside the frames: {"facts": see io/facts.py, "stages": their identities, ...}."""
    return run / "inputs" / "scene.json"


def scans_folder(run: Path | str) -> Path:
    """Where a run keeps the scans that it makes of frames' pictures, a folder a frame."""
    return Path(run) / "scans"


def body_model_of(run: Path | str, name: str, up: str) -> BodyModel:
    """The body model of this name: a packaged one, or a `.npz` inside the capture that the run was made of."""
    return model_in_capture(capture_folder(run) if name.endswith(".npz") else Path(), name, up)


def diagnostics_file(run: Path, frame: int) -> Path:
    """Where a frame's diagnostics are written as soon as it is done."""
    return run / "diagnostics" / f"{frame:06d}.json"


def read_diagnostics(run: Path, frame: int) -> dict[str, Any]:
    """{stage: {name: number}} of one frame, {"reason": why} of one that failed; {} of one that is not done."""
    path = diagnostics_file(run, frame)
    return read_json(path, dict) if path.exists() else {}


def write_diagnostics(run: Path, frame: int, stages: dict[str, Any]) -> None:
    """{stage: {name: number}}, or {"reason": why}, as a whole file."""
    write_text(diagnostics_file(run, frame), json.dumps(stages, indent=1))
