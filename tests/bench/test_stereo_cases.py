"""Laws of the ways in which the bench of scans spoils pictures and calibration."""

import numpy as np
import pytest

from bench.stereo import some
from bench.stereo_cases import GAMMA, blurred, exposed, miscalibrated
from toile.scene import Camera

NAMES = ("a", "b")
CAMERAS = {
    n: Camera(n, 64, 48, np.array([[80, 0, 32], [0, 80, 24], [0, 0, 1.0]]), np.zeros(5), np.eye(4)) for n in NAMES
}
IMAGES = {n: np.random.default_rng(c).integers(0, 256, (48, 64, 3), np.uint8) for c, n in enumerate(NAMES)}


def test_two_stops_are_a_quarter_of_the_light_of_every_second_camera():
    images, _ = exposed(IMAGES, CAMERAS, -2)
    light = {n: (image / 255.0) ** GAMMA for n, image in images.items()}
    assert np.array_equal(images["a"], IMAGES["a"])
    assert light["b"] == pytest.approx((IMAGES["b"] / 255.0) ** GAMMA / 4, abs=0.004)


def test_calibration_is_off_by_as_many_pixels_as_said():
    points = np.random.default_rng(0).normal(size=(20, 3)) + [0, 0, 5]
    for name, camera in miscalibrated(IMAGES, CAMERAS, 2)[1].items():
        moved = camera.project(points)[0] - CAMERAS[name].project(points)[0]
        assert np.linalg.norm(moved, axis=1) == pytest.approx(2)


def test_blur_keeps_light_and_spreads_a_dot_over_as_many_pixels_as_said():
    image = np.zeros((9, 64, 3), np.uint8)
    image[4, 30] = 255
    spread = blurred({"a": image}, CAMERAS, 8)[0]["a"]
    assert np.count_nonzero(spread[..., 0]) == 8 and ((spread / 255.0) ** GAMMA).sum() == pytest.approx(3, rel=0.02)


@pytest.mark.parametrize("cameras", [8, 12, 16, 17])
def test_so_many_cameras_are_compared_as_were_asked_for(cameras):
    names = [f"cam{i:02d}" for i in range(cameras)]
    assert len(some(names, 8)) == 8 and some(names, 0) == names
    assert some(names[:6], 8) == names[:6]
