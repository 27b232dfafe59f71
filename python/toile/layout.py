"""The arrays of RUN/registered.zarr: what a run that has this scene holds, and what one frame gives to it."""

from pathlib import Path

import numpy as np

from .io.body import load_body_model
from .scene import CaptureError, Person
from .store import OK, Registered


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
        per_frame |= {"labels": ((n,), "uint8"), "inner/vertices": ((n, 3), "float64"), "confidence/inner": ((n,), "uint8")}
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
    return {"scene": about | {"garments": garments}, "joint_names": list(model.joint_names), "body_model": scene.body_model}


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
        raise CaptureError(f"{run}/registered.zarr: labels: the run has none, its scene names no garment")
    model = load_body_model(group.attrs["body_model"], up=group.attrs["scene"]["up"])
    shape = group["shape"][:]
    rest, J = model.rest(shape)
    good = np.flatnonzero(group["done"][:] == OK)
    unposed = [
        model.unskin(group["track/vertices"][i], J, group["pose/rotations"][i], group["pose/translation"][i]) for i in good
    ]
    person = Person(shape, np.median(unposed, axis=0) if unposed else rest, J)
    return model, person, group["labels"][:][good], group.attrs["scene"]["labels"]
