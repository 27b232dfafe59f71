"""Lenses that a Camera does not know: where they take points, by OpenCV itself, and the pinhole pictures that are made of theirs."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.support.calibrations import storage, write_colmap_text, write_json, write_metashape, write_toml
from tests.support.cube import CORNERS, views
from tests.support.imported import imported
from toile.errors import UserError
from toile.io.calibration import read_calibration
from toile.io.calibration.lenses import Lens, fisheye
from toile.io.capture import open_capture
from toile.io.flattening import WIDEST, Flattening
from toile.io.rig import Options, read_rig

FISHEYE = np.array([0.08, -0.05, 0.02, -0.004])
RATIONAL = np.array([0.3, -0.12, 0.002, -0.001, 0.02, 0.25, -0.06, 0.01, 1e-3, -2e-3, 5e-4, 1e-3])


def fisheye_pixels(v, points=CORNERS):
    rotation = cv2.Rodrigues(v.R)[0]
    return cv2.fisheye.projectPoints(points[:, None], rotation, v.t, v.K, FISHEYE)[0].reshape(-1, 2) + 0.5


def in_json(folder, made):
    path = write_json(folder, [replace(v, distortion=FISHEYE) for v in made])
    data = json.loads(path.read_text())
    path.write_text(json.dumps({name: fields | {"model": "fisheye"} for name, fields in data.items()}))
    return "lists", path


def in_toml(folder, made):
    path = write_toml(folder, [replace(v, distortion=FISHEYE) for v in made])
    path.write_text(path.read_text().replace("fisheye = false", "fisheye = true"))
    return "pose2sim", path


def in_opencv_files(folder, made):
    for v in made:
        fields = {"image_width": v.width, "image_height": v.height, "camera_matrix": v.K, "fisheye_model": 1}
        storage(folder / f"{v.name}.yml", fields | {"D": FISHEYE, "R": v.R, "T": v.t})
    return "opencv", folder / f"{made[0].name}.yml"


def in_colmap(folder, made):
    path = write_colmap_text(folder, [replace(v, distortion=FISHEYE) for v in made])
    path.write_text(path.read_text().replace("OPENCV", "OPENCV_FISHEYE"))
    return "colmap", path


def in_metashape(folder, made):
    k1, k2, k3, k4 = FISHEYE
    path = write_metashape(folder, [replace(v, distortion=np.array([k1, k2, 0, 0, k3])) for v in made], scale=1.0)
    text = path.read_text().replace('type="frame"', 'type="fisheye"')
    path.write_text(text.replace("<k1>", f"<k4>{k4}</k4><k1>"))
    return "metashape", path


@pytest.mark.parametrize("write", [in_json, in_toml, in_opencv_files, in_colmap, in_metashape])
def test_a_fisheye_takes_points_where_opencv_takes_them_in_every_format(tmp_path, write):
    made = views()
    cameras = read_calibration(*write(tmp_path, made), undistort=True)
    for v in made:
        assert np.abs(cameras[v.name].project(CORNERS)[0] - fisheye_pixels(v)).max() < 2e-3


@pytest.mark.parametrize("count", [8, 12])
def test_a_lens_of_more_than_five_coefficients_takes_points_where_opencv_takes_them(tmp_path, count):
    made = [replace(v, distortion=RATIONAL[:count]) for v in views()]
    path = write_json(tmp_path, made)
    with pytest.raises(UserError, match="beyond k1 k2 p1 p2 k3: such lenses are not read: undistort"):
        read_calibration("lists", path)
    cameras = read_calibration("lists", path, undistort=True)
    for v in made:
        assert np.abs(cameras[v.name].project(CORNERS)[0] - v.pixels()).max() < 1e-6


@pytest.mark.parametrize("kind, reach", [("frame", np.tan), ("equisolid_fisheye", lambda t: 2 * np.sin(t / 2))])
def test_metashape_s_lenses_are_its_manual_s_equations(tmp_path, kind, reach):
    v = replace(views()[0], distortion=np.array([0.05, -0.02, 0.003, -0.002, 0.01]))
    path = write_metashape(tmp_path, [v], scale=1.0)
    text = path.read_text().replace('type="frame"', f'type="{kind}"')
    path.write_text(text.replace("<k1>", "<k4>-0.01</k4><p3>0.3</p3><p4>-0.2</p4><k1>"))
    camera = read_calibration("metashape", path, undistort=True)["left"]
    x0, y0, z0 = camera.to_camera(CORNERS[5])
    t = np.arctan(np.hypot(x0, y0) / z0)
    x, y = reach(t) * np.array([x0, y0]) / np.hypot(x0, y0)
    r2, (k1, k2, p2, p1, k3) = x * x + y * y, v.distortion
    radial, more = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 - 0.01 * r2**4, 1 + 0.3 * r2 - 0.2 * r2**2
    bent = (
        x * radial + (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y) * more,
        y * radial + (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y) * more,
    )
    expected = v.K_half[:2, :2] @ bent + v.K_half[:2, 2]
    np.testing.assert_allclose(camera.project(CORNERS[5])[0], expected, atol=1e-6)


def spreading(v):
    """A picture of which red tells the column and green the row, in quarters of a pixel's share of 256."""
    u, w = np.meshgrid(np.arange(v.width), np.arange(v.height))
    return np.dstack([255 * u / v.width, 255 * w / v.height, 0 * u + 200]).round().astype(np.uint8)


def their_folder(folder, write=in_json):
    made = views()
    folder.mkdir()
    write(folder, made)
    for v in made:
        near = np.hypot(*(np.indices((v.height, v.width)) + 0.5 - fisheye_pixels(v)[3][::-1, None, None])) < 25
        files = {"images": spreading(v), "masks": 255 * near.astype(np.uint8), "labels": 7 * near.astype(np.uint8)}
        for kind, pixels in files.items():
            path = folder / kind / v.name / "0.png"
            path.parent.mkdir(parents=True)
            Image.fromarray(pixels).save(path)
        point = np.zeros((17, 3))
        point[5] = [*(fisheye_pixels(v)[3] - 0.5), 0.9]
        point[6] = [0.0, 0.0, 0.8]  # the picture's corner, which the pinhole picture has no more
        path = folder / "pose" / f"{v.name}_json" / f"{v.name}.0000.json"
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps({"people": [{"pose_keypoints_2d": point.ravel().tolist()}]}))
    return made


def test_undistorted_pictures_masks_labels_and_keypoints_are_those_of_the_pinhole_camera_that_is_written(tmp_path):
    made = their_folder(tmp_path / "their")
    imported(tmp_path / "their", tmp_path / "ours", skeleton="coco17", undistort=True)
    with open(tmp_path / "ours" / "scene.toml", "a") as scene:
        scene.write("\n[labels]\nshirt = 7\n")
    capture = open_capture(tmp_path / "ours")
    frame = capture.frame(0)
    for v in made:
        camera = capture.cameras[v.name]
        assert not camera.distortion.any() and camera.K[0, 0] == v.K[0, 0]
        u, w = np.meshgrid(*(np.linspace(5, side - 6, 9).round() for side in camera.size[::-1]))
        rays = (np.stack([u, w], -1) + 0.5 - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        lens = cv2.fisheye.distortPoints(rays.reshape(-1, 1, 2), v.K, FISHEYE).reshape(*u.shape, 2)
        seen = frame.images[v.name][w.astype(int), u.astype(int)]
        assert np.abs(seen[..., :2] - 255 * lens / [v.width, v.height]).max() < 1.5
        assert np.abs(frame.images[v.name][..., 2].astype(int) - 200).max() <= 1  # nothing but what the lens showed
        at = camera.project(CORNERS[3])[0]
        shown, gone = frame.keypoints.points[v.name]
        assert np.abs(shown[:2] - at).max() < 1e-3 and shown[2] == 0.9 and gone[2] == 0
        for picture, value in ((frame.masks[v.name], 1), (frame.labels[v.name], 7)):
            assert set(np.unique(picture)) == {0, value}
            assert np.abs(np.argwhere(picture == value).mean(0)[::-1] + 0.5 - at).max() < 2
    said = (tmp_path / "ours" / "scene.toml").read_text()
    assert "undistorted: 3 cameras: left from 480 x 360 pixels to 503 x 377, " in said
    assert "undistorted: 3 keypoints lie beyond the new pictures and are unseen now" in said
    assert np.array_equal(np.array(Image.open(tmp_path / "their/images/left/0.png")), spreading(made[0]))  # as it was


def test_a_pinhole_picture_keeps_its_shape_and_is_not_wider_than_it_may_be(tmp_path):
    wide = [
        replace(v, K=v.K * [[0.2, 1, 1], [1, 0.2, 1], [1, 1, 1]]) for v in views()
    ]  # the corners lie beyond 90 degrees
    for camera in read_calibration(*in_json(tmp_path, wide), undistort=True).values():
        flat = Flattening(replace(camera, lens=Lens(fisheye(np.zeros(4)), "its model"))).camera
        assert (flat.width, flat.height) == pytest.approx((WIDEST * camera.width, WIDEST * camera.height), abs=1)
        np.testing.assert_allclose(flat.K[:2, 2] / flat.size[::-1], camera.K[:2, 2] / camera.size[::-1], rtol=0.01)
        flat = Flattening(replace(camera, lens=Lens(fisheye([-0.3]), "its model"))).camera
        corners = np.array([[0, 0], [flat.width, 0], [0, flat.height], [flat.width, flat.height]])
        seen = np.arctan(np.linalg.norm((corners - flat.K[:2, 2]) / np.diag(flat.K)[:2], axis=1)).max()
        assert seen == pytest.approx(0.9**-0.5, rel=0.005)  # where t - 0.3 t^3 turns back


def test_without_such_a_lens_nothing_is_resampled_and_it_is_said(tmp_path):
    write_json(tmp_path, views())
    for v in views():
        path = tmp_path / "images" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        Image.fromarray(spreading(v)).save(path)
    found = read_rig("lists", tmp_path, Options(up="z", undistort=True))
    assert any(note.startswith("undistort: no lens asks for it") for note in found.notes)
    assert all(np.any(camera.distortion) for camera in found.cameras.values())


def test_pictures_of_films_are_undistorted_too(tmp_path):
    pytest.importorskip("av")
    from toile.io.video import VideoWriter

    made = views()
    in_json(tmp_path, made)
    for v in made:
        with VideoWriter(tmp_path / "videos" / f"{v.name}.mp4", 30) as film:
            film.add(spreading(v))
    imported(tmp_path, tmp_path / "ours", undistort=True)
    capture = open_capture(tmp_path / "ours")
    for name, camera in read_calibration("lists", tmp_path / "calibration.json", undistort=True).items():
        expected = Flattening(camera).resampled(spreading(next(v for v in made if v.name == name)), "images")
        assert np.abs(capture.frame(0).images[name].astype(int) - expected).mean() < 4  # of compression


def test_pictures_that_were_scaled_since_are_undistorted_by_the_scaled_calibration(tmp_path):
    made = views()
    in_json(tmp_path, made)
    for v in made:
        path = tmp_path / "images" / v.name / "0.png"
        path.parent.mkdir(parents=True)
        Image.fromarray(spreading(v)).resize((v.width // 2, v.height // 2)).save(path)
    imported(tmp_path, tmp_path / "ours", undistort=True, scaled=True)
    for v in made:
        camera = open_capture(tmp_path / "ours").cameras[v.name]
        np.testing.assert_allclose(np.diag(camera.K)[:2], np.diag(v.K)[:2] / 2)
        pixels = open_capture(tmp_path / "ours").frame(0).images[v.name][camera.height // 2, camera.width // 2]
        ray = (np.array([camera.width // 2, camera.height // 2]) + 0.5 - camera.K[:2, 2]) / np.diag(camera.K)[:2]
        lens = cv2.fisheye.distortPoints(ray[None, None], v.K, FISHEYE)[0, 0]
        assert np.abs(pixels[:2] - 255 * lens / [v.width, v.height]).max() < 2
