"""Pictures unwrapped onto UVs: pixels where they belong, and nothing of one layer on another."""

import cv2
import numpy as np
import pytest

from toile.scene import Camera
from toile.surface.layers import Layer
from toile.surface.uv import UvMap
from toile.vision.unwrapping import (
    Unwrapped,
    Unwrapper,
    crop_about,
    filled,
    mean_texture,
    pinhole,
    undistorted,
    undistorted_crop,
)
from toile.vision.visibility import DepthView

SKIN, CLOTH, WALL = np.array([200, 120, 90]), np.array([20, 60, 220]), np.array([90, 255, 90])
GARMENT = 3


def camera(distortion=(-0.1, 0.02, 0.002, -0.001, 0.0), size=(200, 240), f=260.0, roll=0.0):
    """Looks along +y at the origin from 1 m, rolled about its axis [rad]."""
    T = np.eye(4)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    T[:3, :3], T[2, 3] = turn @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), 1.0
    K = np.array([[f, 0, 0.47 * size[1]], [0, 1.01 * f, 0.54 * size[0]], [0, 0, 1.0]])
    return Camera("a", size[1], size[0], K, np.array(distortion), T)


def tube(name, radius, low, high, label, around=48, along=24):
    """An open tube about z; UVs are its angle and height."""
    a, z = np.linspace(0, 2 * np.pi, around + 1), np.linspace(low, high, along + 1)
    j, i = np.meshgrid(np.arange(around + 1), np.arange(along + 1))
    uv = np.stack([0.05 + 0.9 * j / around, 0.05 + 0.9 * i / along], -1).reshape(-1, 2)
    V = np.stack([radius * np.cos(a[j]), radius * np.sin(a[j]), z[i]], -1)[:, :-1].reshape(-1, 3)
    k = (np.arange(along)[:, None] * (around + 1) + np.arange(around)).ravel()
    face_uv = np.r_[np.c_[k, k + 1, k + around + 2], np.c_[k, k + around + 2, k + around + 1]]
    vertex = ((np.arange(along + 1)[:, None]) * around + np.arange(around + 1) % around).ravel()
    one = np.zeros((len(V), 1))
    return Layer(
        name,
        "garment" if label >= 0 else "body",
        V,
        vertex[face_uv].astype(np.int32),
        uv,
        face_uv.astype(np.int32),
        one.astype(np.int32),
        one + 1,
        label,
    )


LAYERS = [tube("body", 0.10, -0.3, 0.3, -1), tube("shirt", 0.115, -0.15, 0.12, GARMENT)]
SURE = [np.full(len(layer.rest), 2, np.uint8) for layer in LAYERS]


def unwrapper(size=128, layers=LAYERS):
    return Unwrapper([UvMap(layer, size) for layer in layers], [GARMENT])


def photograph(view_camera, shift=0.0, fine=5):
    """(image, mask, labels) of the layers, anti-aliased; the shirt's hems lie `shift` higher than registered."""
    V = [LAYERS[0].rest, LAYERS[1].rest + [0, 0, shift]]
    F = np.r_[LAYERS[0].faces, LAYERS[1].faces + len(V[0])]
    K = view_camera.K * np.array([[fine], [fine], [1]])
    big = Camera(
        "a", view_camera.width * fine, view_camera.height * fine, K, view_camera.distortion, view_camera.T_camera_world
    )
    face = DepthView(big, np.concatenate(V), F).face
    ids = np.where(face < 0, 0, np.where(face < len(LAYERS[0].faces), 1, GARMENT)).astype(np.uint8)
    colours = np.array([WALL, SKIN, [0, 0, 0], CLOTH], np.float32)[ids]
    image = cv2.resize(colours, (view_camera.width, view_camera.height), interpolation=cv2.INTER_AREA)
    labels = ids[fine // 2 :: fine, fine // 2 :: fine]
    return np.rint(image).astype(np.uint8), labels > 0, labels


def test_a_pinhole_picture_shows_points_where_its_camera_projects_them():
    """Dots drawn where the distorted camera sees them, found again in the undistorted, scaled, cut picture."""
    real = camera()
    points = np.random.default_rng(0).uniform([-0.25, -0.1, -0.2], [0.25, 0.1, 0.2], (12, 3))
    x, y = np.meshgrid(np.arange(real.width) + 0.5, np.arange(real.height) + 0.5)
    for scale, crop in ((1, (10, 20, 150, 180)), (1.26, (0, 0, 159, 190)), (2, (-10, 5, 110, 100))):
        errors = []
        for point in points:
            (u, v), _ = real.project(point)
            dot = 255 * np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / 3**2)
            picture = undistorted_crop(
                real, np.repeat(dot[..., None], 3, 2).astype(np.float32), dot > 0, None, scale, crop
            )
            wanted, _ = picture.camera.project(point)
            grey = picture.image[..., 0].astype(float)
            if not (15 < wanted[0] < crop[3] - 15 and 15 < wanted[1] < crop[2] - 15):
                continue
            j, i = np.meshgrid(np.arange(crop[3]) + 0.5, np.arange(crop[2]) + 0.5)
            found = np.array([(grey * j).sum(), (grey * i).sum()]) / grey.sum()
            errors.append(np.abs(found - wanted).max())
        assert len(errors) >= 3 and max(errors) < 0.05


@pytest.mark.parametrize("scale", [1, 1.26, 2, 0.8])
def test_masks_and_labels_lie_on_the_scaled_cameras_silhouette(scale):
    real = camera(size=(240, 240), roll=0.4)  # rolled: pixels round the tube's straight edges to either side
    image, mask, labels = photograph(real)
    flat = pinhole(real, scale)
    picture = undistorted_crop(real, image, mask, labels, scale, (0, 0, *flat.size))
    wanted = DepthView(
        picture.camera,
        np.concatenate([layer.rest for layer in LAYERS]),
        np.r_[LAYERS[0].faces, LAYERS[1].faces + len(LAYERS[0].rest)],
    )
    for found, true in (
        (picture.mask, wanted.face >= 0),
        (picture.labels == GARMENT, wanted.face >= len(LAYERS[0].faces)),
    ):
        centre = [np.mean(np.argwhere(m), axis=0) for m in (found, true)]
        assert (
            np.abs(centre[0] - centre[1]).max() < 0.3
        )  # [px]; labels at scale 2 lie a quarter of a pixel off, one of four pixels stands for all
        assert abs(found.sum() / true.sum() - 1) < 0.02


def test_a_window_holds_what_it_is_about_and_stays_inside_the_picture():
    real, points = camera(), LAYERS[1].rest
    row, column, height, width = crop_about(real, points, (150, 130), 1)
    uv, _ = pinhole(real, 1, (row, column, height, width)).project(points)
    assert uv.min() > 0 and (uv.max(0) < [130, 150]).all()
    assert 0 <= row <= real.height - 150 and 0 <= column <= real.width - 130
    assert crop_about(real, points + [0, 0, 50], (150, 130), 1)[2:] == (150, 130)


def test_unwrapped_colours_are_the_pictures_at_each_texels_point():
    real = camera(distortion=np.zeros(5))
    v, u = np.mgrid[: real.height, : real.width] + 0.5
    image = np.stack([u, v, 255 - u], -1).clip(0, 255).astype(np.uint8)
    un = unwrapper()
    un.frame([layer.rest for layer in LAYERS], SURE)
    for m, seen in zip(un.maps, un.view(real, image, np.ones(real.size, bool), None)):
        points = m.texels(m.layer.rest).reshape(-1, 3)[seen.texels]
        uv, _ = real.project(points)
        assert len(seen.texels) > 500
        assert np.abs(seen.colours[:, :2] - uv).max() < 1.6


def test_weights_are_cosine_times_confidence_and_hidden_vertices_give_none():
    real = camera(distortion=np.zeros(5))
    un, n = unwrapper(layers=LAYERS[:1]), len(LAYERS[0].rest)
    height = LAYERS[0].rest[:, 2]
    sure = np.where(height < -0.1, 0, np.where(height < 0.1, 1, 2)).astype(np.uint8)
    un.frame([LAYERS[0].rest], [sure])
    (seen,) = un.view(real, np.zeros((*real.size, 3), np.uint8), np.ones(real.size, bool), None)
    points = un.maps[0].texels(LAYERS[0].rest).reshape(-1, 3)[seen.texels]
    ray = real.centre - points
    cosine = (ray[:, :2] * points[:, :2]).sum(1) / np.linalg.norm(points[:, :2], axis=1) / np.linalg.norm(ray, axis=1)
    step = 0.6 / 24
    assert points[:, 2].min() > -0.1 - step
    low, high = (points[:, 2] > -0.1 + step) & (points[:, 2] < 0.1 - step), points[:, 2] > 0.1 + step
    assert low.any() and high.any() and n == len(sure)
    assert np.abs(seen.weights[low] - 0.5 * cosine[low]).max() < 0.02
    assert np.abs(seen.weights[high] - cosine[high]).max() < 0.02
    assert (points[:, 1] < 0).all()  # the far side is not seen


def test_no_layer_takes_colours_of_another_or_of_the_background():
    real = camera(distortion=np.zeros(5))
    un = unwrapper(256)
    un.frame([layer.rest for layer in LAYERS], SURE)
    for labelled in (True, False):
        image, mask, labels = photograph(real)
        body, shirt = un.view(real, image, mask, labels if labelled else None)
        assert len(body.texels) > 2000 and len(shirt.texels) > 2000
        assert np.abs(body.colours - SKIN).max() <= 2
        assert np.abs(shirt.colours - CLOTH).max() <= 2


@pytest.mark.parametrize("shift", [-0.008, 0.008])
def test_a_hem_registered_eight_millimetres_off_leaves_no_foreign_colours(shift):
    real = camera(distortion=np.zeros(5), f=600, size=(480, 480))
    un = unwrapper(256)
    un.frame([layer.rest for layer in LAYERS], SURE)
    image, mask, labels = photograph(real, shift, fine=3)
    body, shirt = un.view(real, image, mask, labels)
    assert np.abs(body.colours - SKIN).max() <= 2 and np.abs(shirt.colours - CLOTH).max() <= 2


def test_wrong_labels_far_from_a_border_punch_no_holes():
    real = camera(distortion=np.zeros(5), f=600, size=(480, 480))
    un = unwrapper()
    un.frame([layer.rest for layer in LAYERS], SURE)
    image, mask, labels = photograph(real, fine=3)
    wrong = labels.copy()
    (u, v), _ = real.project(np.array([0, -0.115, 0.0]))
    wrong[int(v) - 9 : int(v) + 9, int(u) - 9 : int(u) + 9] = 1
    right, spoilt = (un.view(real, image, mask, given)[1] for given in (labels, wrong))
    assert np.array_equal(right.texels, spoilt.texels)


def test_empty_views_give_nothing():
    real = camera()
    un = unwrapper(64)
    black = np.zeros((*real.size, 3), np.uint8)
    un.frame([layer.rest for layer in LAYERS], SURE)
    assert all(len(seen.texels) == 0 for seen in un.view(pinhole(real), black, np.zeros(real.size, bool), None))
    un.frame([layer.rest + [0, 5, 0] * np.array(-1) for layer in LAYERS], SURE)  # behind the camera
    assert all(len(seen.texels) == 0 for seen in un.view(pinhole(real), black, np.ones(real.size, bool), None))


def test_the_mean_over_views_weighs_them():
    a = Unwrapped(np.array([1, 2]), np.array([[100] * 3, [50] * 3], np.uint8), np.array([0.5, 1.0]))
    b = Unwrapped(np.array([2, 5]), np.array([[80] * 3, [7] * 3], np.uint8), np.array([0.5, 0.25]))
    mean = mean_texture([a, b], 4)
    assert mean.texels.tolist() == [1, 2, 5] and mean.colours[:, 0].tolist() == [100, 60, 7]
    assert mean.weights.tolist() == [0.5, 1.5, 0.25]
    assert len(mean_texture([Unwrapped.nothing()], 4).texels) == 0


def test_a_map_of_an_unwrapping_is_zero_where_unseen_and_filling_takes_the_nearest():
    texture, weight = Unwrapped(np.array([5]), np.array([[9, 8, 7]], np.uint8), np.array([0.5])).maps(4)
    assert texture[1, 1].tolist() == [9, 8, 7] and texture.sum() == 24 and weight.sum() == 0.5
    assert (filled(texture / 255, weight > 0) == np.array([9, 8, 7]) / 255).all()
    assert (filled(texture / 255, weight > 9) == 0.5).all()


def test_a_picture_without_distortion_is_left_as_it_is():
    picture = np.random.default_rng(0).integers(0, 255, (200, 240, 3)).astype(np.uint8)
    assert undistorted(camera(np.zeros(5)), picture) is picture


def test_an_undistorted_picture_holds_nothing_twice_that_its_lens_folds_back():
    wide = camera((-0.3, 0, 0, 0, 0), f=80.0)
    white = undistorted(wide, np.full((200, 240), 255, np.uint8))
    v, u = np.mgrid[:200, :240] + 0.5
    r = np.hypot((u - wide.K[0, 2]) / wide.K[0, 0], (v - wide.K[1, 2]) / wide.K[1, 1])
    turn = np.sqrt(1 / 0.9)
    assert (r > turn + 0.05).any() and not white[r > turn + 0.05].any() and (white[r < turn - 0.05] == 255).all()
