"""A run made of the truth of the bundled capture, as if everything had been registered exactly."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import zarr

from toile import kernels
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.io.run_writer import RunWriter
from toile.scene import HIDDEN, OBSERVED, Dressed, GarmentTemplate, Inner, Person, Segmented, Tracked

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
    scene, group, K = capture.scene, truth["garment/tshirt"], len(model.J)
    mesh, run = capture.templates["tshirt"], folder / "run"
    loops = tuple(kernels.boundary_loops(mesh.faces))
    names = tuple(f"loop{i}" for i in range(len(loops)))
    skin = np.eye(1, K).repeat(len(mesh.vertices), axis=0)
    template = GarmentTemplate(
        "tshirt", scene.labels["tshirt"], mesh.vertices, mesh.faces, mesh.uv, mesh.face_uv, skin, loops, names
    )
    run.mkdir()
    (run / "config.toml").write_text(f"capture = {json.dumps(str(capture_folder))}\n")
    frames, faceless = truth["frames"][:], replace(scene, face_keypoints=False)
    person = Person(np.zeros(4), model.v_template, model.J)
    store = RunWriter.create(run, frames, faceless, model, person, [template])
    face, bary = group["map_face"][:], group["map_bary"][:]
    for row, frame in enumerate(frames.tolist()):
        body, cloth = truth["body/vertices"][row].astype(float), group["vertices"][row].astype(float)
        covered = kernels.winding_number(body, cloth, group["faces"][:]) > 0.5
        confidence = np.where(covered, HIDDEN, OBSERVED).astype(np.uint8)
        labels = np.where(covered, scene.labels["tshirt"], truth["labels"][:]).astype(np.uint8)
        placed = np.einsum("gk,gki->gi", bary, cloth[group["faces"][:][face]])
        pose, nothing = (truth["pose/rotations"][row], truth["pose/translation"][row]), np.zeros(0)
        store.write(
            frame,
            Tracked(body, *pose, nothing, confidence, {}),
            Segmented(labels, nothing, nothing, nothing, {}),
            {"tshirt": Dressed(placed, np.full(len(placed), OBSERVED, np.uint8), {})},
            Inner(body, confidence, {"tshirt": placed}, 0, {}),
        )
    return run


def with_another_template(capture, run):
    """A run made by `true_run` as if its template were the truth's own mesh, whose openings it names by the bones: its store."""
    truth = zarr.open_group(str(capture / "truth" / "truth.zarr"), mode="r")
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    V, F = truth["garment/tshirt/vertices"][:].astype(float), truth["garment/tshirt/faces"][:]
    store.create_array("garment/tshirt/vertices", data=V, chunks=(1, *V.shape[1:]), overwrite=True)
    store.create_array("garment/tshirt/faces", data=F, overwrite=True)
    sure = np.full(V.shape[:2], 2, np.uint8)
    store.create_array("confidence/tshirt", data=sure, chunks=(1, sure.shape[1]), overwrite=True)
    scene = store.attrs["scene"]
    names = ("hem", "neck", "sleeve_right", "sleeve_left")
    scene["garments"][0]["loops"] = {n: l.tolist() for n, l in zip(names, kernels.boundary_loops(F))}
    store.attrs["scene"] = scene
    return store
