"""The views of `cube.py` in every calibration format that is read, each written by its own library where it has one."""

import json
import struct
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from tests.support.cube import views


def storage(path, entries):
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in entries.items():
        file.write(key, value)
    file.release()


def write_easymocap(folder, written):
    names = [v.name.replace(" ", "_") for v in written]
    for stem in ("intri", "extri"):
        file = cv2.FileStorage(str(folder / f"{stem}.yml"), cv2.FILE_STORAGE_WRITE)
        file.startWriteStruct("names", cv2.FILE_NODE_SEQ)
        for name in names:
            file.write("", name)
        file.endWriteStruct()
        for name, v in zip(names, written):
            if stem == "intri":
                file.write(f"K_{name}", v.K)
                file.write(f"dist_{name}", v.distortion[None])
                file.write(f"H_{name}", v.height)
                file.write(f"W_{name}", v.width)
            else:
                file.write(f"R_{name}", cv2.Rodrigues(v.R)[0])
                file.write(f"T_{name}", v.t[:, None])
        file.release()
    return folder / "intri.yml"


def write_opencv_files(folder, written):
    for v in written:
        fields = {"image_width": v.width, "image_height": v.height, "camera_matrix": v.K}
        fields |= {"distortion_coefficients": v.distortion[:, None], "R": v.R, "T": v.t[:, None]}
        storage(folder / f"{v.name}.yml", fields)
    return folder / f"{written[0].name}.yml"


def write_toml(folder, written):
    tables = {"metadata": {"adjusted": False, "error": 0.0}}
    for i, v in enumerate(written):
        tables[f"cam_{i}"] = {
            "name": v.name, "size": [float(v.width), float(v.height)], "matrix": v.K.tolist(),
            "distortions": v.distortion[:4].tolist(), "rotation": cv2.Rodrigues(v.R)[0].ravel().tolist(),
            "translation": v.t.tolist(), "fisheye": False,
        }  # fmt: skip
    (folder / "Calib.toml").write_text(tomli_w.dumps(tables))
    return folder / "Calib.toml"


def write_qualisys(folder, written):
    root = ElementTree.Element("calibration")
    cameras = ElementTree.SubElement(root, "cameras")
    for v in written:
        camera = ElementTree.SubElement(cameras, "camera", serial=v.name, active="1")
        edges = {"left": 0, "top": 0, "right": v.width - 1, "bottom": v.height - 1}
        ElementTree.SubElement(camera, "fov_video", {key: str(value) for key, value in edges.items()})
        turn = np.diag([1, -1, -1]) @ v.R  # x right, y up, looking along -z
        pose = {f"r{i + 1}{j + 1}": repr(float(turn[i, j])) for i in range(3) for j in range(3)}
        ElementTree.SubElement(camera, "transform", pose | dict(zip("xyz", map(str, 1000 * v.centre))))
        lens = dict(zip(("focalLengthU", "focalLengthV"), 64 * v.K[[0, 1], [0, 1]]))
        lens |= dict(zip(("centerPointU", "centerPointV"), 64 * v.K[:2, 2]))
        lens |= dict(zip(("radialDistortion1", "radialDistortion2"), v.distortion))
        lens |= {"tangentalDistortion1": v.distortion[2], "tangentalDistortion2": v.distortion[3], "skew": 0.0}
        lens["radialDistortion3"] = v.distortion[4]
        ElementTree.SubElement(camera, "intrinsic", {key: repr(float(value)) for key, value in lens.items()})
    ElementTree.ElementTree(root).write(folder / "Calib.qca.txt")
    return folder / "Calib.qca.txt"


def write_metashape(folder, written, scale=0.37):
    """The chunk's frame differs from the world's by a scale, a turn and a shift; one camera more is not aligned."""
    turn, shift = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix(), np.array([0.4, -1.0, 2.0])
    root = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(root, "chunk", label="Chunk 1")
    sensors, cameras = (ElementTree.SubElement(chunk, name) for name in ("sensors", "cameras"))
    component = ElementTree.SubElement(ElementTree.SubElement(chunk, "components"), "component", id="0")
    world = ElementTree.SubElement(component, "transform")
    for name, value in {"rotation": turn, "translation": shift, "scale": scale}.items():
        ElementTree.SubElement(world, name).text = " ".join(map(repr, np.ravel(value).tolist()))
    for i, v in enumerate(written):
        sensor = ElementTree.SubElement(sensors, "sensor", id=str(i), type="frame")
        lens = ElementTree.SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
        ElementTree.SubElement(lens, "resolution", width=str(v.width), height=str(v.height))
        k1, k2, p1, p2, k3 = v.distortion
        c = v.K[:2, 2] + 0.5 - np.array([v.width, v.height]) / 2
        values = {"f": v.K[1, 1], "b1": v.K[0, 0] - v.K[1, 1], "cx": c[0], "cy": c[1]}
        values |= {"k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1}
        for name, value in values.items():
            ElementTree.SubElement(lens, name).text = repr(float(value))
        camera = ElementTree.SubElement(
            cameras, "camera", id=str(i), sensor_id=str(i), component_id="0", label=f"{v.name}.jpg"
        )
        inside = np.eye(4)  # camera to chunk: the world's pose, moved back
        inside[:3, :3], inside[:3, 3] = turn.T @ v.R.T, turn.T @ (v.centre - shift) / scale
        ElementTree.SubElement(camera, "transform").text = " ".join(map(repr, inside.ravel().tolist()))
    ElementTree.SubElement(cameras, "camera", id="9", sensor_id="0", component_id="0", label="unaligned")
    ElementTree.ElementTree(root).write(folder / "cameras.xml")
    return folder / "cameras.xml"


def quaternion(R):
    return np.roll(Rotation.from_matrix(R).as_quat(), 1)


def opencv_parameters(v):
    return [*v.K[[0, 1], [0, 1]], *(v.K[:2, 2] + 0.5), *v.distortion[:4]]


def write_colmap_text(folder, written):
    lines = [
        f"{i} OPENCV {v.width} {v.height} " + " ".join(map(repr, map(float, opencv_parameters(v))))
        for i, v in enumerate(written, 1)
    ]
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(lines) + "\n")
    lines = []
    for i, v in enumerate(written, 1):
        pose = " ".join(repr(float(x)) for x in (*quaternion(v.R), *v.t))
        lines += [f"{i} {pose} {i} {v.name}.png", "" if i == 2 else "10.0 20.0 -1 30.5 40.5 7"]
    (folder / "images.txt").write_text("# Image list\n" + "\n".join(lines) + "\n")
    return folder / "cameras.txt"


def write_colmap_binary(folder, written):
    with open(folder / "cameras.bin", "wb") as file:
        file.write(struct.pack("<Q", len(written)))
        for i, v in enumerate(written, 1):
            file.write(struct.pack("<IiQQ8d", i, 4, v.width, v.height, *opencv_parameters(v)))
    with open(folder / "images.bin", "wb") as file:
        file.write(struct.pack("<Q", len(written)))
        for i, v in enumerate(written, 1):
            file.write(struct.pack("<I7dI", i, *quaternion(v.R), *v.t, i) + f"{v.name}/000000.png".encode() + b"\0")
            file.write(struct.pack("<Q2dq", 1, 10.0, 20.0, -1))
    return folder / "cameras.bin"


def write_json(folder, written):
    cameras = {}
    for i, v in enumerate(written):
        pose = (
            {"R": v.R.tolist(), "t": v.t.tolist()},
            {"extrinsics": np.c_[v.R, v.t].tolist()},
            {"c2w": v.c2w.tolist()},
        )[i]
        lens = {"intrinsics": v.K.tolist(), "dist": v.distortion.tolist(), "width": v.width, "height": v.height}
        cameras[v.name] = lens | pose
    (folder / "calibration.json").write_text(json.dumps(cameras))
    return folder / "calibration.json"


def write_middlebury(folder, written):
    rows = [
        f"{v.name.replace(' ', '_')}.png " + " ".join(repr(float(x)) for x in (*v.K.ravel(), *v.R.ravel(), *v.t))
        for v in written
    ]
    (folder / "temple_par.txt").write_text("\n".join([str(len(rows)), *rows]) + "\n")
    return folder / "temple_par.txt"


UNSPACED = ("left", "front", "cam3")
FORMATS = {  # writer, kind, keywords of the views, metres a unit
    "easymocap": (write_easymocap, "opencv", {"names": UNSPACED}, 1.0),
    "opencv": (write_opencv_files, "opencv", {}, 1.0),
    "toml": (write_toml, "pose2sim", {"flat": True}, 1.0),
    "qualisys": (write_qualisys, "qualisys", {}, 0.001),
    "metashape": (write_metashape, "metashape", {}, 1.0),
    "colmap-text": (write_colmap_text, "colmap", {"flat": True}, 1.0),
    "colmap-binary": (write_colmap_binary, "colmap", {"flat": True}, 1.0),
    "json": (write_json, "lists", {}, 1.0),
    "middlebury": (write_middlebury, "lists", {"distorted": False, "names": UNSPACED}, 1.0),
}


def written_as(folder, name):
    """(views, file, kind, metres) of a format, written into `folder`; `flat`: without k3, which the format has not."""
    write, kind, options, metres = FORMATS[name]
    options = dict(options)
    flat = options.pop("flat", False)
    made = views(**options)
    if flat:
        made = [replace(v, distortion=v.distortion * [1, 1, 1, 1, 0]) for v in made]
    return made, write(folder, made), kind, metres


def spoil(path, old, new):
    path.write_text(path.read_text().replace(old, new, 1))
