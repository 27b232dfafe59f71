"""toile reconstruct: a ball that cameras see all around comes back as a scan, and a bad frame stops nothing."""

import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from toile.config.stereo import scan_preset
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.image import write_image
from toile.io.importing import cameras_json
from toile.pipeline.reconstruct import reconstruct

CENTRE, RADIUS = np.array([0.02, -0.01, 1.0]), 0.35
WAVES = np.random.default_rng(1).normal(0, 60, (16, 3))


def picture_of_ball(camera):
    """(H,W,3) uint8 and mask (H,W) of a ball with a smooth texture, through the camera's lens."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T @ camera.T_camera_world[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to = CENTRE - camera.centre
    along = rays @ to
    inside = along**2 - to @ to + RADIUS**2
    place = camera.centre + (along - np.sqrt(np.maximum(inside, 0)))[..., None] * rays
    grey = 128 + 25 * np.sin(place @ WAVES.T).sum(-1) / 4
    grey = np.where(inside > 0, np.clip(grey, 0, 255), 90)
    return np.repeat(grey[..., None], 3, 2).astype(np.uint8), inside > 0


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """Two frames: of a ball before fourteen cameras of 160 pixels, and without masks."""
    root = tmp_path_factory.mktemp("capture")
    cameras = {}
    for name, camera in ring_of_cameras(14, distortion=(0.0,) * 5).items():
        K = np.array([[230.0, 0, 82], [0, 230, 78], [0, 0, 1]])
        cameras[name] = replace(camera, K=K, width=160, height=160)
    (root / "scene.toml").write_text('[scene]\nname = "ball"\nunits = "cm"\n')
    for camera in cameras.values():
        image, mask = picture_of_ball(camera)
        for number in (0, 1):
            write_image(root / "frames" / f"{number:06d}" / "images" / f"{camera.name}.png", image)
        write_image(root / "frames" / "000000" / "masks" / f"{camera.name}.png", mask.astype(np.uint8) * 255)
    points = {n: [[*c.project(CENTRE)[0], 1.0], [0, 0, 0]] for n, c in cameras.items()}
    text = json.dumps({"names": ["body.head", "body.wrist.L"], "points": points})
    (root / "frames" / "000000" / "keypoints.json").write_text(text)
    in_cm = {}
    for name, camera in cameras.items():
        T = camera.T_camera_world.copy()
        T[:3, 3] *= 100
        in_cm[name] = replace(camera, T_camera_world=T)
    (root / "cameras.json").write_text(cameras_json(in_cm))
    return root


@pytest.fixture(scope="module")
def made(capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "scans"
    return out, reconstruct(open_capture(capture), out, scan_preset("standard"), [0, 1])


def test_the_scan_is_the_ball_in_the_captures_units(made):
    out, _ = made
    scan = open_capture(out).frame(0).scan
    off = np.abs(np.linalg.norm(scan.vertices - CENTRE, axis=1) - RADIUS)
    assert np.median(off) < 0.002 and np.quantile(off, 0.95) < 0.006  # a pixel is 10 mm
    assert scan.confidence.shape == (len(scan.vertices),)
    assert 0 <= scan.confidence.min() and 0.3 < np.median(scan.confidence) and scan.confidence.max() <= 1
    d = (scan.vertices - CENTRE) / RADIUS
    assert (np.einsum("ni,ni->n", d, scan.normals) > 0.9).mean() > 0.98
    side = np.random.default_rng(0).normal(size=(500, 3))
    side[:, 2] *= 0.5  # the cameras stand about it
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    near = scan.index.closest(CENTRE + RADIUS * side)[3]
    assert (near < 0.01).mean() > 0.95


def test_keypoints_are_triangulated_and_unseen_ones_are_null(made):
    out, _ = made
    found = json.loads((out / "frames" / "000000" / "keypoints3d.json").read_text())
    assert found["names"] == ["body.head", "body.wrist.L"] and found["points"][1] is None
    assert np.abs(np.array(found["points"][0][:3]) - CENTRE).max() < 1e-5 and found["points"][0][3] > 0


def test_a_frame_without_masks_fails_alone_and_says_why(made):
    out, result = made
    assert result.made == (0,) and "masks" in result.failed[1]
    assert not (out / "frames" / "000001").exists()
    assert "of the person's pixels have a depth" in result.said[0]


def test_pictures_are_linked_and_what_is_there_stays(capture, made):
    out, _ = made
    name = os.path.join("frames", "000000", "images", "cam0.png")
    assert os.path.samefile(capture / name, out / name)
    before = (out / "frames" / "000000" / "scan.ply").stat().st_mtime_ns
    again = reconstruct(open_capture(capture), out, scan_preset("draft"), [0])
    assert again.kept == (0,) and (out / "frames" / "000000" / "scan.ply").stat().st_mtime_ns == before


def test_the_capture_itself_and_other_folders_are_refused(capture, tmp_path):
    with pytest.raises(UserError, match="the capture itself"):
        reconstruct(open_capture(capture), capture, scan_preset("draft"), [0])
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(UserError, match="is no capture"):
        reconstruct(open_capture(capture), tmp_path, scan_preset("draft"), [0])


def test_the_command_says_what_it_made_and_ends_with_two_where_a_frame_failed(capture, tmp_path):
    words = ["reconstruct", capture, tmp_path / "o", "--quality", "draft"]
    done = subprocess.run(
        [sys.executable, "-m", "toile", *map(str, words)], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 2, done.stderr
    assert "scans of 1 frames, 1 failed" in done.stdout and "frame 1:" in done.stderr


def test_two_workers_make_the_same_files(capture, made, tmp_path):
    out, result = made
    assert reconstruct(open_capture(capture), tmp_path / "o", scan_preset("standard"), [0, 1], workers=2) == result
    for name in ("scan.ply", "keypoints3d.json"):
        once, twice = (folder / "frames" / "000000" / name for folder in (out, tmp_path / "o"))
        assert once.read_bytes() == twice.read_bytes()
