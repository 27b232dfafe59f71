"""A capture without a mistake for `toile inspect`, and what tests do to it."""

import json
from dataclasses import replace

import cv2
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.support.rig import ring_of_cameras
from toile.io.body import load_body_model
from toile.io.importing import cameras_json
from toile.measure.inspection import inspect

FRAMES, PICTURED = 30, (0, 7, 14, 21, 29)


def person(t):
    """Keypoints (k,3) and some vertices of the packaged body, turning and walking."""
    model = load_body_model("anny")
    R = Rotation.from_euler("z", 4 * t, degrees=True).as_matrix()
    shift = np.array([0.25 * np.sin(0.35 * t), 0.2 * np.cos(0.5 * t), 0.02 * np.sin(1.3 * t)])
    points = model.keypoints(model.v_template, model.J)
    bent = points + 0.03 * np.sin(0.6 * t + np.arange(len(points)))[:, None]
    return model.keypoint_names, bent @ R.T + shift, model.v_template[::23] @ R.T + shift


def write_sound_capture(root):
    """Writes a capture of five cameras without a mistake: keypoints of 1 px, masks, label images, pictures of five frames."""
    rng, cameras = np.random.default_rng(1), ring_of_cameras(5)
    texture = rng.integers(60, 200, (512, 512, 3), dtype=np.uint8)
    for t in range(FRAMES):
        names, points, skin = person(t)
        folder, rows = root / "frames" / f"{t:06d}", {}
        folder.mkdir(parents=True)
        for name, camera in cameras.items():
            uv = camera.project(points)[0]
            rows[name] = np.c_[uv + rng.normal(0, 1, uv.shape), np.full(len(uv), 0.9)].round(3).tolist()
            if t in PICTURED:
                mask = np.zeros(camera.size, np.uint8)
                cv2.fillConvexPoly(
                    mask, cv2.convexHull(camera.project(skin)[0].astype(np.float32)).astype(np.int32), 255
                )
                for kind, picture in (("images", np.roll(texture, t, 0)), ("masks", mask), ("labels", mask // 255)):
                    (folder / kind).mkdir(exist_ok=True)
                    Image.fromarray(picture).save(folder / kind / f"{name}.{'jpg' if kind == 'images' else 'png'}")
        (folder / "keypoints.json").write_text(json.dumps({"names": names, "points": rows}))
    (root / "cameras.json").write_text(cameras_json(cameras))
    scene = (
        '[scene]\nname = "x"\nup = "z"\n[labels]\nshirt = 1\nskirt = 2\n[[garment]]\nname = "shirt"\nlabel = "shirt"\n'
    )
    (root / "scene.toml").write_text(scene)


def texts(root, serious=None):
    return [f.text for f in inspect(root).findings if serious is None or f.serious == serious]


def recalibrated(root, change, only=None):
    from toile.io.camera import read_cameras

    cameras = read_cameras(root / "cameras.json")
    changed = {name: change(c) if only in (None, name) else c for name, c in cameras.items()}
    (root / "cameras.json").write_text(cameras_json(changed))


def posed(change):
    return lambda camera: replace(camera, T_camera_world=change(camera.T_camera_world))


def edited(root, change):
    """Every frame's rows (k,3) of every camera through `change(camera, t, rows)`."""
    files = sorted(root.glob("frames/*/keypoints.json"))
    data = [json.loads(file.read_text()) for file in files]
    before = [{name: np.array(rows) for name, rows in d["points"].items()} for d in data]
    for t, (file, d) in enumerate(zip(files, data)):
        d["points"] = {name: np.asarray(change(name, t, before)).tolist() for name in d["points"]}
        file.write_text(json.dumps(d))
