"""stereo: a textured plane comes back to a small part of a pixel, and nothing is made up where nothing can be known."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support import textured_plane as scene
from tests.support.kernel_calls import bits
from toile import kernels
from toile.kernels.stereo import HOLES

CAMERAS = scene.cameras(3, size=(64, 80))
PICTURES = [scene.picture(camera) for camera in CAMERAS]
RANGES = scene.ranges(CAMERAS)
INNER = (slice(12, -12), slice(16, -16))  # that all cameras see


@pytest.fixture(scope="module")
def plane():
    return kernels.StereoSolver(CAMERAS).solve(PICTURES, None, RANGES)


def off(result, cameras, scale=1.0):
    """Depth errors (C,h,w) of the inner pixels, in the sizes that pixels have there; NaN in holes."""
    truth = [scene.hits(camera, scale)[0][INNER] for camera in cameras]
    return [(result.depth[c][INNER] - z) / (z / 160) for c, z in enumerate(truth)]


def test_a_textured_plane_comes_back_to_a_part_of_a_pixel(plane):
    error = np.abs(off(plane, CAMERAS))
    assert np.isfinite(error).mean() > 0.97
    assert np.nanmedian(error) < 0.06 and np.nanquantile(error, 0.95) < 0.4
    angle = np.arccos(np.clip(plane.normal[1][INNER] @ scene.NORMAL, -1, 1))
    assert np.nanmedian(angle) < np.radians(3)


def test_a_hole_is_not_a_number_in_every_map_and_has_its_reason(plane):
    hole = plane.hole != 0
    assert 0 < hole.mean() < 0.5
    assert (np.isnan(plane.depth) == hole).all() and (np.isnan(plane.normal).all(-1) == hole).all()
    assert ((plane.confidence == 0) == hole).all() and (plane.confidence <= 1).all()
    assert np.abs(np.linalg.norm(plane.normal[~hole], axis=1) - 1).max() < 1e-5


def test_the_unit_of_length_and_the_place_of_the_origin_do_not_matter(plane):
    for scale, shift in ((1e-3, 0), (1e3, 0), (1, 1e5)):
        moved = []
        for camera in CAMERAS:
            T = camera.T_camera_world.copy()
            T[:3, 3] = scale * T[:3, 3] - T[:3, :3] @ np.full(3, shift)
            moved.append(replace(camera, T_camera_world=T))
        result = kernels.StereoSolver(moved).solve(PICTURES, None, scale * RANGES)
        assert np.abs(np.isfinite(result.depth).mean() - np.isfinite(plane.depth).mean()) < 0.01
        assert np.nanmedian(np.abs(result.depth / scale - plane.depth)[:, 12:-12, 16:-16]) < 1e-4


def test_levels_of_the_pyramid_do_not_matter(plane):
    result = kernels.StereoSolver(CAMERAS, coarsest=16).solve(PICTURES, None, RANGES)  # four levels
    error = np.abs(off(result, CAMERAS))
    assert np.isfinite(error).mean() > 0.95 and np.nanmedian(error) < 0.06


def test_exposure_does_not_matter():
    dim = [PICTURES[0], 0.4 * PICTURES[1], 0.7 * PICTURES[2] + 30]  # up to 1.3 stops
    error = np.abs(off(kernels.StereoSolver(CAMERAS).solve(dim, None, RANGES), CAMERAS))
    assert np.isfinite(error).mean() > 0.95 and np.nanmedian(error) < 0.06


def test_a_region_without_texture_is_a_hole_and_not_a_surface():
    """Cameras that only differ in place, so that a rectangle of the scene is found in each picture by its rays."""
    pictures, plain = [], []
    for camera, picture in zip(CAMERAS, PICTURES):
        place = scene.hits(camera)[1]
        plain.append((np.abs(place[..., 0]) < 0.12) & (np.abs(place[..., 1]) < 0.1))
        pictures.append(np.where(plain[-1], 128, picture))
    result = kernels.StereoSolver(CAMERAS).solve(pictures, None, RANGES)
    from scipy.ndimage import binary_erosion

    within = np.stack([binary_erosion(p, iterations=6) for p in plain])
    assert within.sum() > 100 and (result.hole[within] == HOLES.index("untextured")).all()
    white = [np.where(p, 255, picture) for p, picture in zip(plain, pictures)]
    result = kernels.StereoSolver(CAMERAS).solve(white, None, RANGES)
    assert (result.hole[within] == HOLES.index("saturated")).all()


def test_noise_alone_gives_hardly_any_surface():
    noise = np.random.default_rng(0).uniform(0, 255, (3, 64, 80)).astype(np.float32)
    result = kernels.StereoSolver(CAMERAS).solve(noise, None, RANGES)
    assert np.isfinite(result.depth).mean() < 0.05


def test_masks_bound_what_is_looked_at(plane):
    masks = [np.hypot(*(scene.hits(camera)[1][..., k] for k in (0, 1))) < 0.12 for camera in CAMERAS]
    result = kernels.StereoSolver(CAMERAS).solve(PICTURES, masks)  # by their visual hull
    assert (result.hole[~np.array(masks)] == HOLES.index("masked")).all()
    inner = np.array(masks) & np.isfinite(result.depth)
    assert inner.sum() > 0.9 * np.sum(masks)
    truth = np.array([scene.hits(camera)[0] for camera in CAMERAS])
    assert np.median(np.abs(result.depth - truth)[inner]) < 0.1 / 160


def test_a_black_camera_among_others_does_no_harm():
    dark = [*PICTURES[:2], np.zeros_like(PICTURES[2])]
    masks = [np.ones((64, 80), bool)] * 2 + [np.zeros((64, 80), bool)]
    result = kernels.StereoSolver(CAMERAS).solve(dark, masks, RANGES)
    assert np.isnan(result.depth[2]).all()
    error = np.abs(off(result, CAMERAS))[:2]
    assert np.isfinite(error).mean() > 0.9 and np.nanmedian(error) < 0.12  # one pair is left


def test_a_result_unpacks_to_depth_normal_and_confidence(plane):
    depth, normal, confidence = plane
    assert depth is plane.depth and normal is plane.normal and confidence is plane.confidence
    assert depth.shape == confidence.shape == plane.hole.shape == (3, 64, 80) and normal.shape == (3, 64, 80, 3)


def test_bits_do_not_depend_on_threads(plane, threads):
    for n in (1, 2):
        threads(n)
        result = kernels.StereoSolver(CAMERAS).solve(PICTURES, None, RANGES)
        assert bits(result) == bits(plane)


def test_cameras_may_differ_in_size():
    small = replace(CAMERAS[0], height=50, width=60)
    cameras = [small, *CAMERAS[1:]]
    result = kernels.StereoSolver(cameras).solve([PICTURES[0][:50, :60], *PICTURES[1:]], None, RANGES)
    assert result.depth.shape == (3, 64, 80) and np.isnan(result.depth[0, 50:]).all()
    assert np.nanmedian(np.abs(result.depth[0] - scene.hits(CAMERAS[0])[0])) < 0.1 / 160


def test_fused_points_lie_on_the_plane_and_no_pixel_begins_a_point_again(plane):
    fused = kernels.fuse_depths(CAMERAS, plane.depth, plane.normal, plane.confidence)
    distance = np.abs(fused.points @ scene.NORMAL)
    assert np.median(distance) < 0.05 / 160 and (fused.views >= 2).all()
    seen = np.isfinite(plane.depth).sum()
    assert seen / 4 < len(fused.points) < seen / 2
    assert (fused.normals @ scene.NORMAL > 0.8).mean() > 0.98
    assert (fused.confidence > 0).all() and (fused.confidence <= 1).all()
    alone = kernels.fuse_depths(CAMERAS, plane.depth, plane.normal, plane.confidence, min_views=1)
    assert len(alone.points) > len(fused.points)


def test_a_surface_that_most_cameras_with_a_depth_there_contradict_is_none():
    cameras = scene.cameras(5, size=(64, 80))
    depth = np.array([scene.hits(camera)[0] for camera in cameras])
    for c in (3, 4):  # two cameras share a surface 5 cm before the true one
        to_plane = cameras[c].centre @ scene.NORMAL
        depth[c] *= (to_plane - 0.05) / to_plane
    normal = np.broadcast_to(scene.NORMAL, (*depth.shape, 3))
    fuse = lambda cameras, depth: (
        kernels.fuse_depths(cameras, depth, normal[: len(depth)], np.full(depth.shape, 0.9)).points
    )
    false = lambda points: (points @ scene.NORMAL > 0.04).sum()
    assert false(fuse(cameras[3:], depth[3:])) > 1000  # nobody contradicts them
    points = fuse(cameras, depth)
    inner = np.abs(points[:, :2]).max(1) < 0.1  # where all five look
    assert inner.sum() > 500 and np.abs(points[inner] @ scene.NORMAL).max() < 1e-6


@pytest.mark.parametrize(
    ("match", "change"),
    [
        ("neither masks nor depth_range", dict(depth_range=None)),
        (r"images\[1\] has shape", dict(images=[PICTURES[0], PICTURES[1][:-1], PICTURES[2]])),
        (r"images\[2\] has a value", dict(images=[*PICTURES[:2], np.full_like(PICTURES[2], np.nan)])),
        (r"images has 2 entries for 3", dict(images=PICTURES[:2])),
        (r"masks\[0\] has shape", dict(masks=[np.ones((2, 2))] * 3)),
        (r"depth_range\[0\] is", dict(depth_range=RANGES[:, ::-1])),
        (r"depth_range\[0\] is .*, inf", dict(depth_range=RANGES * [1, np.inf])),
        (r"depth_range.*shape", dict(depth_range=RANGES[:2])),
        ("the masks are empty", dict(masks=[np.zeros((64, 80))] * 3, depth_range=None)),
    ],
)
def test_bad_pictures_are_refused_by_name(match, change):
    arguments = dict(images=PICTURES, masks=None, depth_range=RANGES) | change
    with pytest.raises(kernels.InputError, match=match):
        kernels.StereoSolver(CAMERAS).solve(**arguments)


def test_bad_cameras_and_options_are_refused_by_name():
    with pytest.raises(kernels.InputError, match="1 cameras"):
        kernels.StereoSolver(CAMERAS[:1])
    with pytest.raises(kernels.InputError, match=r"cameras\[1\].distortion"):
        kernels.StereoSolver([CAMERAS[0], replace(CAMERAS[1], distortion=np.full(5, 0.1))])
    with pytest.raises(kernels.InputError, match=r"cameras\[0\].T_camera_world"):
        kernels.StereoSolver([replace(CAMERAS[0], T_camera_world=2 * np.eye(4)), CAMERAS[1]])
    for name, value in (("noise", 0), ("sources", 0), ("spacing", np.nan), ("iterations", -1)):
        with pytest.raises(kernels.InputError, match=name):
            kernels.StereoSolver(CAMERAS, **{name: value})


@pytest.mark.parametrize(
    "normal, confidence",
    [
        ((3, 4, 5, 2), (3, 4, 5)),
        ((3, 3, 4, 5), (3, 4, 5)),
        ((3, 5, 4, 3), (3, 4, 5)),
        ((3, 4, 5, 3), (3, 5, 4)),
        ((3, 4, 5, 3), (5, 4, 3)),
    ],
)
def test_depth_maps_of_other_shapes_are_not_fused_whatever_their_count(normal, confidence):
    with pytest.raises(kernels.InputError, match="not of one size"):
        kernels.fuse_depths(CAMERAS, np.ones((3, 4, 5)), np.ones(normal), np.ones(confidence))
