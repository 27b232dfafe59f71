"""HeldOutPicture errors against scikit-image and against cases made by hand."""

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from toile.avatar.measure.metrics import (
    BAND,
    ErrorSums,
    border_band,
    errors_over,
    pixel_sets,
    silhouette_ring,
    squared_error,
    ssim_map,
)
from toile.avatar.model import poses
from toile.avatar.model.poses import joints_apart, leaning, leans, nearest_poses, usual_distance
from toile.measure.truth import second_difference

SHIRT, SKIN = 3, 1


@pytest.mark.parametrize("shape", [(64, 48, 3), (11, 11, 3), (40, 37, 1)])
@pytest.mark.parametrize("seed", [0, 1])
def test_ssim_map_equals_scikit_image(shape, seed):
    rng = np.random.default_rng(seed)
    a = rng.random(shape)
    b = np.clip(a + rng.normal(0, 0.1, shape), 0, 1)
    options = dict(gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, full=True)
    whole = structural_similarity(a, b, channel_axis=-1, **options)[1].mean(-1)
    assert np.abs(ssim_map(a, b) - whole).max() < 1e-6


def test_ssim_map_equals_its_definition_at_one_pixel():
    rng = np.random.default_rng(2)
    a, b = rng.random((21, 21, 1)), rng.random((21, 21, 1))
    x, y = a[5:16, 5:16, 0], b[5:16, 5:16, 0]
    w = np.exp(-0.5 * ((np.mgrid[-5:6, -5:6] / 1.5) ** 2).sum(0))
    w /= w.sum()
    mx, my = (w * x).sum(), (w * y).sum()
    cov = (w * (x - mx) * (y - my)).sum()
    vx, vy = (w * (x - mx) ** 2).sum(), (w * (y - my) ** 2).sum()
    expected = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    assert ssim_map(a, b)[10, 10] == pytest.approx(expected, abs=1e-12)


def test_ssim_map_refuses_pictures_of_different_sizes():
    with pytest.raises(ValueError, match="shape"):
        ssim_map(np.zeros((20, 20, 3)), np.zeros((20, 21, 3)))


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_identical_pictures_have_no_error(value):
    image = np.full((30, 30, 3), value)
    sums = errors_over(squared_error(image, image), ssim_map(image, image), np.ones((30, 30), bool))
    assert (sums.mse, sums.ssim, sums.psnr) == (0.0, 1.0, None)


def test_an_offset_has_its_closed_form():
    image, reference = np.full((20, 30, 3), 0.5), np.full((20, 30, 3), 0.5 - 10 / 255)
    sums = errors_over(squared_error(image, reference), ssim_map(image, reference), np.ones((20, 30), bool))
    assert sums.mse == pytest.approx(100)
    assert sums.psnr == pytest.approx(20 * np.log10(25.5))
    assert squared_error(image, reference) == pytest.approx(np.full((20, 30), 100.0))


def test_only_the_chosen_pixels_count_and_pictures_weigh_by_their_pixels():
    image, reference = np.zeros((10, 10, 3)), np.zeros((10, 10, 3))
    image[:5] = 1.0
    maps = squared_error(image, reference), ssim_map(image, reference)
    half = np.zeros((10, 10), bool)
    half[:5] = True
    wrong, right = errors_over(*maps, half), errors_over(*maps, ~half)
    assert (wrong.mse, right.mse) == (255.0**2, 0.0)
    corner = np.zeros((10, 10), bool)
    corner[0, 0] = True
    both = ErrorSums().add(errors_over(*maps, corner)).add(right)
    assert both.mse == pytest.approx(255.0**2 / 51)


def test_without_pixels_there_is_no_number():
    image = np.zeros((20, 20, 3))
    sums = errors_over(squared_error(image, image), ssim_map(image, image), np.zeros((20, 20), bool))
    assert (sums.mse, sums.ssim, sums.psnr) == (None, None, None)


def test_band_of_a_rectangle_is_ten_pixels_to_either_side():
    labels = np.full((80, 90), SKIN)
    labels[30:60, 20:70] = SHIRT
    band = border_band(labels, [SHIRT])
    # pixel centres against the rectangle's outline in continuous coordinates
    row, col = np.mgrid[:80, :90] + 0.5
    outside = np.hypot(np.maximum(0, np.maximum(30 - row, row - 60)), np.maximum(0, np.maximum(20 - col, col - 70)))
    inside = np.minimum(np.minimum(row - 30, 60 - row), np.minimum(col - 20, 70 - col))
    distance = np.where(outside > 0, outside, np.maximum(inside, 0))
    assert (band != (distance <= BAND))[np.abs(distance - BAND) > 0.3].sum() == 0
    assert band[30:60, 20:70].sum() == 50 * 30 - 30 * 10
    assert band[19, 45] == False and band[20, 45] == True  # noqa: E712


def test_a_silhouette_is_no_border():
    labels = np.zeros((60, 60), int)
    labels[10:50, 10:50] = SHIRT
    assert not border_band(labels, [SHIRT]).any()
    labels[10:50, 10:20] = SKIN
    band = border_band(labels, [SHIRT])
    assert band.any() and not band[labels == 0].any()


def test_two_garments_have_a_border_and_two_parts_of_the_body_have_none():
    labels = np.full((40, 40), SKIN)
    labels[:, 20:] = 2
    assert not border_band(labels, [SHIRT]).any()
    labels = np.where(labels == 2, 4, SHIRT)
    assert border_band(labels, [SHIRT, 4])[:, 10:30].all()


def test_pixel_sets_part_the_foreground():
    labels = np.zeros((60, 60), int)
    labels[:30, 5:55], labels[30:, 5:55] = SHIRT, SKIN
    mask = labels > 0
    sets = pixel_sets(mask, labels, [SHIRT])
    assert (sets["all"] == mask).all()
    assert not (sets["body"] & (sets["band"] | sets["garment"])).any()
    assert (sets["body"] | sets["band"] | sets["garment"])[mask].all()
    assert sets["band"][20:40, 5:55].all() and not sets["band"][:20].any()
    empty = pixel_sets(np.zeros_like(mask), labels, [SHIRT])
    assert not any(pixels.any() for pixels in empty.values())


def test_pose_distance_is_the_mean_angle_below_the_root():
    pose = np.zeros((5, 3))
    other = np.zeros((5, 3))
    other[0] = [0, 0, 1.0]
    other[2] = [np.pi / 2, 0, 0]
    assert nearest_poses([pose], [pose, other])[0] == 0
    assert nearest_poses([pose, other], [other])[0] == pytest.approx([90 / 4, 0])


def test_a_joint_is_as_far_as_from_the_nearest_of_all_poses_whichever_is_nearest_as_a_whole():
    pose, one, other = np.zeros((3, 5, 3))
    pose[1, 0], pose[2, 1], one[1, 0], other[2, 1] = 1.0, 0.5, 1.0, 0.5
    whole, alone = nearest_poses([pose], [one, other])
    assert whole == pytest.approx(np.degrees(0.5) / 4) and alone[0] == pytest.approx([0, 0, 0, 0])
    whole, alone = nearest_poses([pose], np.zeros((0, 5, 3)))
    assert np.isnan(whole) and np.isnan(alone).all() and joints_apart([0], alone, "abcd", "none") == []


def test_a_body_leans_as_far_as_up_turns_for_its_root_however_it_faces():
    from scipy.spatial.transform import Rotation

    up, tilt, turn = np.array([0, 0, 1.0]), Rotation.from_rotvec([0.9, 0, 0]), Rotation.from_rotvec([0, 0, 2.5])
    poses = np.zeros((3, 5, 3))
    poses[:, 0] = [(turn * tilt).as_rotvec(), turn.as_rotvec(), [np.pi, 0, 0]]
    assert leans(poses, np.zeros((1, 5, 3)), up) == pytest.approx([np.degrees(0.9), 0, 180])
    (said,) = leaning([4, 5, 6], leans(poses, np.zeros((1, 5, 3)), up), "mine")
    assert said.startswith("2 of 3 poses lean more than 45 degrees farther than any of mine: frame 6 by 180 degrees")
    assert leaning([4, 5, 6], leans(poses, np.zeros((0, 5, 3)), up), "mine") == []


def test_pose_distance_is_the_geodesic_and_not_the_difference_of_vectors():
    a, b = np.zeros((2, 3)), np.zeros((2, 3))
    a[1], b[1] = [0, 0, np.pi - 0.1], [0, 0, -np.pi + 0.1]
    assert nearest_poses([a], [b])[0] == pytest.approx([np.degrees(0.2)])


def test_angles_between_joints_are_those_of_scipy():
    from scipy.spatial.transform import Rotation

    one, other = np.random.default_rng(0).normal(size=(2, 40, 3)) * [[[2.0]], [[1.0]]]
    expected = np.degrees((Rotation.from_rotvec(one).inv() * Rotation.from_rotvec(other)).magnitude())
    whole, alone = nearest_poses(np.insert(one, 0, 9.0, 0)[None], np.insert(other, 0, 0.0, 0)[None])
    assert np.allclose(alone[0], expected, atol=1e-9) and np.isclose(whole[0], expected.mean())


def test_poses_usually_lie_as_far_apart_as_from_the_nearest_that_is_no_neighbour_in_time(monkeypatch):
    turned = np.zeros((40, 2, 3))
    turned[:, 1, 0] = np.radians(np.arange(40))  # a degree a frame
    assert usual_distance(turned, np.arange(40), apart=10) == pytest.approx(10)
    assert usual_distance(turned, np.arange(40), apart=100) == pytest.approx(1)  # all are neighbours
    assert usual_distance(turned[:1], np.arange(1), apart=10) == 0
    monkeypatch.setattr(poses, "ASKED", 8)
    assert usual_distance(turned, np.arange(40), apart=10) == pytest.approx(10)


def test_the_ring_lies_inside_the_silhouette_and_not_along_the_picture_s_edge():
    mask = np.zeros((40, 50), bool)
    mask[10:, 20:40] = True
    ring = silhouette_ring(mask, 3)
    inner = np.zeros_like(mask)
    inner[13:, 23:37] = True
    assert (ring == (mask & ~inner)).all()
    assert not silhouette_ring(np.ones((9, 9), bool)).any() and not silhouette_ring(np.zeros((9, 9), bool)).any()


def test_second_differences_are_zero_for_uniform_motion_and_twice_a_square_s_factor():
    x = np.random.default_rng(0).normal(size=(7, 3))
    assert second_difference({n: x + 0.01 * n for n in range(5)}) == pytest.approx(0, abs=1e-9)
    assert second_difference({n: x + 0.002 * n**2 * np.array([1, 0, 0]) for n in range(3, 8)}) == pytest.approx(4.0)
    assert second_difference({0: x, 6: x, 12: x}) is None
    assert second_difference({n: x + 0.002 * n**2 * np.array([1, 0, 0]) for n in (0, 6, 12, 13)}, 6) == pytest.approx(
        144.0
    )
