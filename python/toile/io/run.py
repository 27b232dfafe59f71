"""What a run leaves on disk: the registered store, the state that lets a killed run go on, and its status lines."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..scene import Person
from .body import load_body_model

PENDING, OK, FAILED = 0, 1, 2


class Status:
    """status.jsonl: one line a stage and frame."""

    def __init__(self, path):
        self.path = path

    def add(self, **line):
        with open(self.path, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def lines(self):
        """All whole lines; a run that was killed may have left the last one cut."""
        for text in self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []:
            try:
                yield json.loads(text)
            except ValueError:
                continue

    def warnings(self):
        """What was warned of, each once."""
        return list(dict.fromkeys(line["warning"] for line in self.lines() if "warning" in line))


class Registered:
    """RUN/registered.zarr: one zarr 3 group, a chunk a frame, `done` written last."""

    def __init__(self, path):
        import zarr

        self.group = zarr.open_group(str(path), mode="r+")
        self.row = {int(f): i for i, f in enumerate(self.group["frames"][:])}

    @staticmethod
    def create(path, frames, fixed, per_frame, attributes):
        """A store with arrays `fixed` {name: array} and, NaN or zero until written, `per_frame` {name: (shape, dtype)}."""
        import zarr

        part = path.with_name(f".{path.name}.part")
        if part.exists():
            shutil.rmtree(part)
        group = zarr.open_group(str(part), mode="w", zarr_format=3)
        group.attrs.update(attributes)
        for name, values in {"frames": np.asarray(frames, np.int64), **fixed}.items():
            group.create_array(name, data=np.asarray(values))
        config = {"write_empty_chunks": True}
        for name, (shape, dtype) in {**per_frame, "done": ((), "uint8")}.items():
            fill = np.nan if np.dtype(dtype).kind == "f" else 0
            group.create_array(
                name, shape=(len(frames), *shape), chunks=(1, *shape), dtype=dtype, fill_value=fill, config=config
            )
        os.replace(part, path)
        return Registered(path)

    def done(self, frame):
        return int(self.group["done"][self.row[frame]])

    def write(self, frame, values, done):
        """One frame: its arrays first, `done` last."""
        row = self.row[frame]
        for name, value in values.items():
            self.group[name][row] = value
        self.group["done"][row] = done

    def write_diagnostics(self, table):
        """`diagnostics/STAGE/NAME (T,)` from {frame: {stage: {name: number}}}, NaN where a frame has none; once all frames
        are done. `whole` tells whether this has been."""
        names = sorted(
            {(stage, name) for stages in table.values() for stage, values in stages.items() for name in values}
        )
        group = self.group.create_group("diagnostics", overwrite=True)
        for stage, name in names:
            column = [table.get(frame, {}).get(stage, {}).get(name, np.nan) for frame in self.row]
            group.create_array(f"{stage}/{name}", data=np.array(column, np.float64))
        group.attrs["whole"] = True

    def reopen(self):
        """Failed frames become pending, and the store is no longer whole."""
        failed = np.flatnonzero(self.group["done"][:] == FAILED)
        if len(failed):
            if "diagnostics" in self.group:
                self.group["diagnostics"].attrs["whole"] = False
            for row in failed:
                self.group["done"][row] = PENDING

    @property
    def whole(self):
        return "diagnostics" in self.group and bool(self.group["diagnostics"].attrs.get("whole"))


def create_store(path, frames, scene, model, person, templates):
    """The empty store of a run over `frames`; `templates` are its GarmentTemplates, inner to outer."""
    n, K = len(model.v_template), len(model.parents)
    fixed = {"track/faces": model.f, "shape": person.shape}
    per_frame = {
        "track/vertices": ((n, 3), "float64"),
        "pose/rotations": ((K, 3), "float64"),
        "pose/translation": ((3,), "float64"),
        "confidence/track": ((n,), "uint8"),
    }
    if scene.face_keypoints:
        q = sum(name.startswith("face.") for name in model.keypoint_names)
        per_frame["face"] = ((q, 3), "float64")
    if templates:
        fixed["inner/faces"] = model.f
        per_frame |= {
            "labels": ((n,), "uint8"),
            "inner/vertices": ((n, 3), "float64"),
            "confidence/inner": ((n,), "uint8"),
        }
    for t in templates:
        at, g = f"garment/{t.name}", len(t.rest)
        fixed |= {f"{at}/faces": t.faces, f"{at}/uv": t.uv, f"{at}/face_uv": t.face_uv, f"{at}/skin": t.skin}
        per_frame |= {f"{at}/vertices": ((g, 3), "float64"), f"confidence/{t.name}": ((g,), "uint8")}
    return Registered.create(path, frames, fixed, per_frame, _attributes(scene, model, templates))


def _attributes(scene, model, templates):
    garments = [
        {
            "name": t.name,
            "label": t.label,
            "loops": {name: [int(v) for v in loop] for name, loop in zip(t.loop_names, t.loops)},
        }
        for t in templates
    ]
    about = {"name": scene.name, "fps": scene.fps, "up": scene.up, "labels": scene.labels}
    return {
        "scene": about | {"garments": garments},
        "joint_names": list(model.joint_names),
        "body_model": scene.body_model,
    }


def frame_arrays(scene, tracked, segmented=None, dressed=None, layer=None):
    """{array: values} of one frame, and its diagnostics by stage; the last three where the scene names a garment."""
    values = {
        "track/vertices": tracked.vertices,
        "pose/rotations": tracked.rotations,
        "pose/translation": tracked.translation,
        "confidence/track": tracked.confidence,
    }
    diagnostics = {"track": tracked.diagnostics}
    if scene.face_keypoints:
        values["face"] = tracked.face
    if layer is None:
        return values, diagnostics
    values |= {"labels": segmented.vertices, "inner/vertices": layer.vertices, "confidence/inner": layer.confidence}
    diagnostics |= {"segment": segmented.diagnostics, "inner": layer.diagnostics}
    for name, vertices in layer.garments.items():
        values |= {f"garment/{name}/vertices": vertices, f"confidence/{name}": dressed[name].confidence}
        diagnostics[f"dress {name}"] = dressed[name].diagnostics
    return values, diagnostics


def person_of(run):
    """(BodyModel, Person, labels (T,n) of the frames that are ok, label table) of a finished run that segmented."""
    import zarr

    group = zarr.open_group(str(Path(run) / "registered.zarr"), mode="r")
    if "labels" not in group:
        raise UserError(f"{run}/registered.zarr: labels: the run has none, its scene names no garment")
    model = load_body_model(group.attrs["body_model"], up=group.attrs["scene"]["up"])
    shape = group["shape"][:]
    rest, J = model.rest(shape)
    good = np.flatnonzero(group["done"][:] == OK)
    unposed = [
        model.unskin(group["track/vertices"][i], J, group["pose/rotations"][i], group["pose/translation"][i])
        for i in good
    ]
    person = Person(shape, np.median(unposed, axis=0) if unposed else rest, J)
    return model, person, group["labels"][:][good], group.attrs["scene"]["labels"]
