"""A cube's corners land on the same pixels through every data set's reader, each folder written in the data set's own layout,
and what cannot be read is refused by file and field."""

import csv
import io
import json
import pickle
import shutil
import zipfile

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.support.cube import CORNERS, views
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.datasets import DATASETS
from toile.io.importing import write_capture

NAMES = ("0004", "0028", "0052")
CUBE_FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                       [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def encoded(size, value=90, mode="RGB", kind="PNG"):
    file = io.BytesIO()
    Image.new(mode, size, (value, 40, 20) if mode == "RGB" else value).save(file, kind)
    return file.getvalue()


def put(path, data):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def write_dress4d(folder):
    """Its y is up: the world of the views, turned."""
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up to y up
    made = views(distorted=False, names=NAMES, size=(470, 640))
    cameras = {v.name: {"intrinsics": v.K, "extrinsics": np.c_[v.R @ turn.T, v.t]} for v in made}
    put(folder / "Capture" / "cameras.pkl", pickle.dumps(cameras))
    put(folder / "basic_info.pkl", pickle.dumps({"scan_frames": ["00011"], "rotation": None, "offset": None}))
    mesh = {
        "vertices": (CORNERS @ turn.T),
        "faces": CUBE_FACES,
        "normals": CORNERS,
        "colors": np.zeros((8, 4), np.uint8),
    }
    put(folder / "Meshes_pkl" / "mesh-f00011.pkl", pickle.dumps(mesh))
    labels = {"scan_labels": (CORNERS[:, 2] > 1).astype(np.int64) * 3}
    put(folder / "Semantic" / "labels" / "label-f00011.pkl", pickle.dumps(labels))
    for v in made:
        put(folder / "Capture" / v.name / "images" / "capture-f00011.png", encoded((v.width, v.height)))
        put(folder / "Capture" / v.name / "masks" / "mask-f00011.png", encoded((v.width, v.height), 255, "L"))
    return made, turn


def write_goliath(folder):
    made = views(distorted=False, names=("400870", "401031", "401292"), size=(334, 512))  # at half the size
    entries = []
    for v in made:
        K, T = v.K.copy(), np.eye(4)
        K[:2, :2] *= 2
        K[:2, 2] = (v.K[:2, 2] + 0.5) * 2 - 0.5
        T[:3, :3], T[:3, 3] = v.R, 1000 * v.t
        entries.append({"cameraId": v.name, "K": K.T.tolist(), "T": T.T.tolist()})
        put(folder / "image" / f"cam{v.name}.zip", b"")
        put(folder / "segmentation_parts" / f"cam{v.name}.zip", b"")
        with zipfile.ZipFile(folder / "image" / f"cam{v.name}.zip", "w") as file:
            file.writestr(f"cam{v.name}/000123.avif", encoded((v.width, v.height), 200, kind="AVIF"))
        with zipfile.ZipFile(folder / "segmentation_parts" / f"cam{v.name}.zip", "w") as file:
            file.writestr(f"cam{v.name}/000123.png", encoded((v.width, v.height), 27, "L"))
    put(folder / "camera_calibration.json", json.dumps({"KRT": entries}).encode())
    return made, np.eye(3)


def write_actorshq(folder):
    made = views(distorted=False, names=("Cam001", "Cam002", "Cam127"))
    columns = ["name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py"]
    put(folder / "calibration.csv", b"")
    with open(folder / "calibration.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for v in made:
            size, turn = np.array([v.width, v.height]), Rotation.from_matrix(v.R.T).as_rotvec()
            lens = (v.K[[0, 1], [0, 1]] / size, v.K_half[:2, 2] / size)
            writer.writerow([v.name, v.width, v.height, *turn, *v.centre, *lens[0], *lens[1]])
    for v in made:
        put(folder / "rgbs" / v.name / f"{v.name}_rgb000012.jpg", encoded((v.width, v.height), kind="JPEG"))
        put(folder / "masks" / v.name / f"{v.name}_mask000012.png", encoded((v.width, v.height), 255, "L"))
    return made, np.eye(3)


def write_mvhumannet(folder, scale=120 / 65):
    """One K for all cameras, pictures at half the size."""
    from dataclasses import replace

    made = views(distorted=False, names=("CC32871A004", "CC32871A059", "CC32871A060"), size=(480, 340))
    made = [replace(v, K=made[0].K) for v in made]
    K = made[0].K.copy()
    K[:2, :2] *= 2
    K[:2, 2] = (K[:2, 2] + 0.5) * 2 - 0.5
    outside = {
        f"1_{v.name}.png": {"rotation": v.R.tolist(), "translation": (1000 * v.t / scale).tolist(), "focal_length": 1.0}
        for v in made
    }
    put(folder / "camera_intrinsics.json", json.dumps({"intrinsics": K.tolist(), "dist": []}).encode())
    put(folder / "camera_extrinsics.json", json.dumps(outside).encode())
    put(folder / "camera_scale.pkl", pickle.dumps(scale))
    for v in made:
        put(folder / "images" / v.name / "0380_img.jpg", encoded((v.width, v.height), kind="JPEG"))
        put(folder / "fmask" / v.name / "0380_img_fmask.png", encoded((v.width, v.height), 255))
    return made, np.eye(3)


def write_dna_rendering(folder):
    h5py = pytest.importorskip("h5py")
    made = views(names=("00", "01", "48"))
    with h5py.File(folder / "0012_09.smc", "w") as file:
        for v, group in zip(made, ("Camera_5mp", "Camera_5mp", "Camera_12mp")):
            data = np.frombuffer(encoded((v.width, v.height), kind="JPEG"), np.uint8)
            file[f"{group}/{int(v.name)}/color/7"] = data
    with h5py.File(folder / "0012_09_annots.smc", "w") as file:
        for v in made:
            file[f"Camera_Parameter/{v.name}/K"], file[f"Camera_Parameter/{v.name}/D"] = v.K, v.distortion
            file[f"Camera_Parameter/{v.name}/RT"] = v.c2w
            file[f"Mask/{int(v.name)}/mask/7"] = np.frombuffer(encoded((v.width, v.height), 255), np.uint8)
            points = np.zeros((8, 133, 3))
            points[7, 5] = 100, 60, 0.9
            file[f"Keypoints_2D/{v.name}"] = points
    return made, np.eye(3)


WRITERS = {
    "4d-dress": write_dress4d, "goliath": write_goliath, "actorshq": write_actorshq, "mvhumannet": write_mvhumannet,
    "dna-rendering": write_dna_rendering,
}  # fmt: skip


def imported(folder, name, up="z"):
    (folder / "their").mkdir(exist_ok=True)
    made, turn = WRITERS[name](folder / "their")
    found = DATASETS[name](folder / "their", "" if name == "4d-dress" else up)
    write_capture(found, folder / "ours", "test")
    return made, turn, open_capture(folder / "ours")


@pytest.mark.parametrize("name", WRITERS)
def test_a_cube_lands_on_the_same_pixels_through_every_reader(tmp_path, name):
    made, turn, capture = imported(tmp_path, name)
    assert set(capture.cameras) == {v.name for v in made}
    for v in made:
        camera = capture.cameras[v.name]
        assert camera.size == (v.height, v.width)
        assert np.abs(camera.project(CORNERS @ turn.T)[0] - v.pixels()).max() < 0.01
    frame = capture.frame(capture.frames[0])
    assert list(frame.images) == list(capture.cameras) == list(frame.masks)
    assert all(mask.all() for mask in frame.masks.values())


def test_scans_of_4d_dress_carry_their_labels(tmp_path):
    _, turn, capture = imported(tmp_path, "4d-dress")
    frame = capture.frame(11)
    assert capture.scene.up == "y" and capture.scene.labels["upper"] == 4
    np.testing.assert_allclose(frame.scan.vertices, CORNERS @ turn.T, atol=1e-6)
    top = (CORNERS[CUBE_FACES][:, :, 2] > 1).sum(1) >= 2
    assert np.array_equal(frame.scan_labels, np.where(top, 4, 1))


def test_parts_of_goliath_and_keypoints_of_dna_rendering_arrive(tmp_path):
    _, _, capture = imported(tmp_path, "goliath")
    assert all((image == 27).all() for image in capture.frame(123).labels.values())
    assert abs(int(capture.frame(123).images["400870"][0, 0, 0]) - 200) < 6
    (tmp_path / "dna").mkdir()
    _, _, capture = imported(tmp_path / "dna", "dna-rendering")
    keypoints = capture.frame(7).keypoints
    assert keypoints.names == ("body.upperarm01.L",)
    np.testing.assert_allclose(keypoints.points["48"], [[100.5, 60.5, 0.9]])


def test_frames_of_mvhumannet_are_as_far_apart_as_in_its_films(tmp_path):
    """Every fifth of 25 frames a second is there: 0005, 0010, ..."""
    made, _ = write_mvhumannet(tmp_path / "their")
    for v in made:
        pictures = tmp_path / "their" / "images" / v.name
        shutil.copy(pictures / "0380_img.jpg", pictures / "0385_img.jpg")
    write_capture(DATASETS["mvhumannet"](tmp_path / "their", "z"), tmp_path / "ours", "test")
    capture = open_capture(tmp_path / "ours")
    assert np.diff(capture.frames) / capture.scene.fps == pytest.approx([0.2])


class Evil:
    def __reduce__(self):
        import os

        return os.system, ("touch /tmp/toile-was-here",)


def zip_with(folder, name, data=b"x"):
    with zipfile.ZipFile(folder / "image" / "cam400870.zip", "a") as file:
        file.writestr(name, data)


def linked(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "0012_09_annots.smc", "a") as file:
        del file["Camera_Parameter/01/K"]
        file["Camera_Parameter/01/K"] = h5py.ExternalLink("/etc/passwd", "K")


def claimed(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "0012_09_annots.smc", "a") as file:
        del file["Camera_Parameter/01/K"]
        file.create_dataset("Camera_Parameter/01/K", shape=(10**5, 10**5), dtype="f8", chunks=(10, 10))


def edit_json(folder, name, change):
    data = json.loads((folder / name).read_text())
    change(data)
    (folder / name).write_text(json.dumps(data))


BAD = {
    "pickle that runs": ("4d-dress", lambda f: put(f / "Capture/cameras.pkl", pickle.dumps({"0004": Evil()})),
                         r"cameras\.pkl: .*would import (posix|os|nt)\.system"),
    "labels of another scan": ("4d-dress", lambda f: put(f / "Semantic/labels/label-f00011.pkl",
                               pickle.dumps({"scan_labels": np.zeros(5, int)})), r"label-f00011\.pkl: scan_labels: expected 8"),
    "faces that are none": ("4d-dress", lambda f: put(f / "Meshes_pkl/mesh-f00011.pkl",
                            pickle.dumps({"vertices": CORNERS, "faces": CUBE_FACES + 9})), r"mesh-f00011\.pkl: face 0 names"),
    "zip that climbs": ("goliath", lambda f: zip_with(f, "../../evil.avif"), r"cam400870\.zip: '../../evil\.avif': a path"),
    "picture that is none": ("goliath", lambda f: zip_with(f, "cam400870/000124.avif"), r"000124\.avif: cannot be read"),
    "mirrored": ("goliath", lambda f: edit_json(f, "camera_calibration.json", lambda d: d["KRT"][1]["T"].__setitem__(
                 0, [-x for x in d["KRT"][1]["T"][0]])), r"camera_calibration\.json: KRT\.1\.T: a mirrored rotation"),
    "short row": ("actorshq", lambda f: put(f / "calibration.csv", b"name,w,h\nCam001,4,5\n"), r"line 2: rx is missing"),
    "a scale that runs": ("mvhumannet", lambda f: put(f / "camera_scale.pkl", pickle.dumps(Evil())), "would import"),
    "no translation": ("mvhumannet", lambda f: edit_json(f, "camera_extrinsics.json",
                       lambda d: d["1_CC32871A004.png"].pop("translation")), "expected rotation and translation"),
    "link out of the file": ("dna-rendering", linked, r"annots\.smc: Camera_Parameter/01/K: a link that leaves"),
    "array that claims 80 GB": ("dna-rendering", claimed, r"Camera_Parameter/01/K: float64 of 80000000000 bytes"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_by_file_and_field_and_leaves_nothing(tmp_path, case):
    name, spoil, message = BAD[case]
    (tmp_path / "their").mkdir()
    WRITERS[name](tmp_path / "their")
    spoil(tmp_path / "their")
    with pytest.raises(UserError, match=message):
        write_capture(DATASETS[name](tmp_path / "their", "y" if name == "4d-dress" else "z"), tmp_path / "ours", "test")
    assert [p.name for p in tmp_path.iterdir()] == ["their"]
    from pathlib import Path

    assert not Path("/tmp/toile-was-here").exists()


def test_pickles_of_arrays_of_either_numpy_and_protocol_are_read(tmp_path):
    from toile.io.pickles import read_pickle

    values = {
        "a": np.arange(6.0).reshape(2, 3),
        "b": np.asfortranarray(np.eye(3, dtype=np.float32)),
        "c": np.float64(2),
    }
    values |= {"d": np.array(["x", "yz"]), "e": [1, "text", None, True, b"bytes"]}
    for protocol in range(6):
        (tmp_path / "p.pkl").write_bytes(pickle.dumps(values, protocol))
        back = read_pickle(tmp_path / "p.pkl", dict)
        for key in "abcd":
            assert (
                np.array_equal(back[key], values[key]) and np.asarray(back[key]).dtype == np.asarray(values[key]).dtype
            )
        assert back["e"] == values["e"]
