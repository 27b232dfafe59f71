"""What is read of a capture beside its frames: values of scene.toml and cameras, and digests of files, so that a change is noticed
and named."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..scene import Camera
from .capture import VOTES, Capture
from .inputs import contents, digest
from .scene_file import network_files

Facts = Mapping[str, Mapping[str, Any]]


def facts_of(capture: Capture) -> dict[str, dict[str, Any]]:
    """What the stages read of a capture beside its frames, in tables: values of scene.toml, and digests of files."""
    scene, root = capture.scene, capture.root
    network = network_files(root, scene.segmenter)
    worn = [garment.template for garment in scene.garments if garment.template]
    files = {path.relative_to(root).as_posix(): path for path in capture.files}
    apart = {"scene.toml", VOTES, scene.body_model, *worn, *network}
    printed = [garment.name for garment in scene.garments if garment.prints]
    return {
        "scene": {"units": scene.units, "up": scene.up, "face": scene.face_keypoints},
        "time": {"fps": scene.fps},
        "body": {"model": scene.body_model} | _digests(files, [scene.body_model]),
        "cameras": {name: digest(_numbers(camera)) for name, camera in capture.cameras.items()},
        "labels": dict(scene.labels),
        "segmenter": {Path(name).name: contents(root / name) for name in network},
        "garments": {g.name: [i, g.label, g.template] for i, g in enumerate(scene.garments)} | _digests(files, worn),
        "prints": {"garments": printed}
        | _digests(files, [name for name in files if printed and name not in apart and not name.endswith(".json")]),
    }


def changed_facts(facts: Facts, then: Facts) -> Iterator[str]:
    """TABLE.NAME of what was read of the capture and is other now."""
    for table, values in facts.items():
        known = then.get(table, {})
        yield from (f"{table}.{n}" for n in sorted(values.keys() | known.keys()) if values.get(n) != known.get(n))


def _digests(files: dict[str, Path], names: Iterable[str]) -> dict[str, str]:
    return {name: contents(files[name]) for name in names if name in files}


def _numbers(camera: Camera) -> list[Any]:
    matrices = camera.K, camera.distortion, camera.T_camera_world
    return [camera.width, camera.height, *(np.asarray(matrix).tolist() for matrix in matrices)]
