"""A run made of the truth of the bundled capture, as if everything had been registered exactly."""

import json
import shutil
from pathlib import Path

import numpy as np
import zarr

from toile import kernels
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.run import OK, Registered

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def copy_capture(folder):
    """The bundled capture, with true joints put where the body model of zero shape has them."""
    capture = Path(shutil.copytree(SAMPLE, folder / "capture"))
    truth = zarr.open_group(str(capture / "truth" / "truth.zarr"), mode="r+")
    model = load_body_model("anny")
    for row in range(truth["frames"].shape[0]):
        _, x = model.joint_transforms(model.J, truth["pose/rotations"][row], truth["pose/translation"][row])
        named = [model.joint_names.index(n) for n in truth.attrs["joint_names"]]
        truth["joints"][row] = x[named]
    return capture


def true_run(capture_folder, folder):
    """Writes the run and returns its folder."""
    capture, model = open_capture(capture_folder), load_body_model("anny")
    truth = zarr.open_group(str(capture_folder / "truth" / "truth.zarr"), mode="r")
    scene, group = capture.scene, truth["garment/tshirt"]
    template = capture.templates["tshirt"]
    loops = {f"loop{i}": loop.tolist() for i, loop in enumerate(kernels.boundary_loops(template.faces))}
    n, g, K = len(model.v_template), len(template.vertices), len(model.J)
    run = folder / "run"
    run.mkdir()
    (run / "config.toml").write_text(f"capture = {json.dumps(str(capture_folder))}\n")
    attributes = {
        "scene": {
            "name": scene.name,
            "fps": scene.fps,
            "up": scene.up,
            "labels": scene.labels,
            "garments": [{"name": "tshirt", "label": scene.labels["tshirt"], "loops": loops}],
        },
        "joint_names": list(model.joint_names),
        "body_model": "anny",
    }
    fixed = {
        "shape": np.zeros(4),
        "track/faces": model.f,
        "inner/faces": model.f,
        "garment/tshirt/faces": template.faces,
    }
    per_frame = {
        "track/vertices": ((n, 3), "float64"),
        "inner/vertices": ((n, 3), "float64"),
        "garment/tshirt/vertices": ((g, 3), "float64"),
        "pose/rotations": ((K, 3), "float64"),
        "pose/translation": ((3,), "float64"),
        "labels": ((n,), "uint8"),
        "confidence/track": ((n,), "uint8"),
        "confidence/inner": ((n,), "uint8"),
        "confidence/tshirt": ((g,), "uint8"),
    }
    frames = truth["frames"][:]
    store = Registered.create(run / "registered.zarr", frames, fixed, per_frame, attributes)
    face, bary = group["map_face"][:], group["map_bary"][:]
    for row, frame in enumerate(frames):
        body, cloth = truth["body/vertices"][row].astype(float), group["vertices"][row].astype(float)
        covered = kernels.winding_number(body, cloth, group["faces"][:]) > 0.5
        values = {
            "track/vertices": body,
            "inner/vertices": body,
            "garment/tshirt/vertices": np.einsum("gk,gki->gi", bary, cloth[group["faces"][:][face]]),
            "pose/rotations": truth["pose/rotations"][row],
            "pose/translation": truth["pose/translation"][row],
            "labels": np.where(covered, scene.labels["tshirt"], truth["labels"][:]).astype(np.uint8),
            "confidence/track": np.where(covered, 0, 2).astype(np.uint8),
            "confidence/inner": np.where(covered, 0, 2).astype(np.uint8),
            "confidence/tshirt": np.full(g, 2, np.uint8),
        }
        store.write(int(frame), values, OK)
    return run
