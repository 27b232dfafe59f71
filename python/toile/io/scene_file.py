"""scene.toml: what a capture says of itself, checked."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import UserError
from ..scene import Garment, Scene
from .bounded import read_toml
from .camera import first_error
from .layout import DIAGNOSTICS, LAYOUT, VERDICT

# garment names that name an array of the store, or another layer of an avatar
RESERVED = sorted({key.split("/")[0] for key in LAYOUT} | {VERDICT, DIAGNOSTICS, "body", "surface"})
METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001}
SEGMENTERS = {"clothes": Path(__file__).parents[1] / "assets" / "clothes.onnx"}  # packaged networks of labels
BESIDE_NETWORKS = ("pipeline.json", "config.json", "preprocessor_config.json")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _SceneTable(_Table):
    name: str
    fps: float = Field(default=30, gt=0, le=100_000, allow_inf_nan=False)
    units: str = "m"
    up: str = "z"
    keypoints: str = ""
    segmenter: str = ""


class _BodyTable(_Table):
    model: str = "anny"


class _FaceTable(_Table):
    keypoints: bool = True


class _GarmentTable(_Table):
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=64)
    template: str = ""
    label: str
    prints: bool = False


class _CamerasTable(_Table):
    file: str = "cameras.json"
    view_dependent: bool = False


class _SceneFile(_Table):
    scene: _SceneTable
    body: _BodyTable = _BodyTable()
    face: _FaceTable | None = None
    labels: dict[str, int] = {}
    garment: list[_GarmentTable] = []
    cameras: _CamerasTable = _CamerasTable()


def read_scene(root: Path) -> tuple[Scene, str]:
    """The scene of a capture, and the name of its file of cameras. UserError: one line that names the file and the field."""
    file = root / "scene.toml"
    if not os.path.lexists(file):
        raise UserError(f"{file}: the file is missing: the folder is no capture; `toile import` makes one")
    try:
        table = _SceneFile(**read_toml(file))
    except ValidationError as error:
        raise first_error(file, error) from None
    _check(root, file, table)
    scene = Scene(
        table.scene.name,
        table.scene.fps,
        table.scene.units,
        table.scene.up,
        table.body.model,
        dict(table.labels),
        tuple(Garment(g.name, g.template, g.label, g.prints) for g in table.garment),
        bool(table.face and table.face.keypoints),
        table.cameras.view_dependent,
        table.scene.keypoints,
        table.scene.segmenter,
    )
    return scene, table.cameras.file


def _check(root: Path, file: Path, table: _SceneFile) -> None:
    if table.scene.units not in METRES:
        raise UserError(f"{file}: scene.units: '{table.scene.units}', expected one of {', '.join(METRES)}")
    if table.scene.up not in ("x", "y", "z"):
        raise UserError(f"{file}: scene.up: '{table.scene.up}', expected x, y or z")
    _check_labels(file, table.labels)
    _check_garments(root, file, table)
    if table.body.model.endswith(".npz"):
        inside(root, file, "body.model", table.body.model)
    elif table.body.model != "anny":
        raise UserError(f"{file}: body.model: '{table.body.model}' is neither a packaged model (anny) nor a .npz file")
    if table.scene.keypoints:
        if not table.scene.keypoints.endswith(".onnx"):
            raise UserError(
                f"{file}: scene.keypoints: '{table.scene.keypoints}' is no .onnx file; a program is never taken from a "
                "capture, name it by `toile detect --detector`"
            )
        inside(root, file, "scene.keypoints", table.scene.keypoints)
    if table.scene.segmenter:
        _check_segmenter(root, file, table.scene.segmenter, table.labels)


def _check_labels(file: Path, labels: dict[str, int]) -> None:
    for name, label in labels.items():
        if not 0 < label < 256:
            raise UserError(f"{file}: labels.{name} = {label}: ids are 1 to 255, 0 is the background")
    if len(set(labels.values())) < len(labels):
        raise UserError(f"{file}: labels: two names share one id")


def _check_garments(root: Path, file: Path, table: _SceneFile) -> None:
    names = [g.name for g in table.garment]
    for i, garment in enumerate(table.garment):
        if garment.label not in table.labels:
            raise UserError(f"{file}: garment.{i}.label: '{garment.label}' is not in [labels]")
        if garment.name in RESERVED:
            raise UserError(
                f"{file}: garment.{i}.name: '{garment.name}' is reserved, it names a layer or array of a run"
            )
        if names.index(garment.name) != i:
            raise UserError(f"{file}: garment.{i}.name: '{garment.name}' stands there twice")
        if "template" in garment.model_fields_set:
            inside(root, file, f"garment.{i}.template", garment.template)


def _check_segmenter(root: Path, file: Path, name: str, labels: dict[str, int]) -> None:
    if not labels:
        raise UserError(f"{file}: scene.segmenter: the scene has no [labels] that it could give")
    if name in SEGMENTERS:
        return
    if not name.endswith(".onnx"):
        packaged = ", ".join(SEGMENTERS)
        raise UserError(
            f"{file}: scene.segmenter: '{name}' is neither a packaged network ({packaged}) nor a .onnx file"
        )
    for path in network_files(root, name):
        inside(root, file, "scene.segmenter", path)


def network_files(root: Path, name: str) -> list[str]:
    """The files of a segmenter: its own and those that may say what it does not, as paths from the capture; those of a
    packaged one as they are."""
    if not name:
        return []
    path = SEGMENTERS.get(name, Path(name))
    beside = [path.with_suffix(".toml"), *(path.with_name(other) for other in BESIDE_NETWORKS)]
    return [str(path), *(str(other) for other in beside if os.path.lexists(root / other))]


def inside(root: Path, file: Path, field: str, name: str) -> Path:
    """The path inside the capture, refused when it leaves it or is missing (cameras may be)."""
    if not name.isprintable():
        raise UserError(f"{file}: {field}: {name!r} is no path")
    path = Path(os.path.realpath(root / name))  # a circle of links leaves it as it is
    if not path.is_relative_to(os.path.realpath(root)):
        raise UserError(f"{file}: {field}: '{name}' leaves the capture")
    if field != "cameras.file" and not path.is_file():
        raise UserError(f"{file}: {field}: no file '{name}' in the capture")
    return path
