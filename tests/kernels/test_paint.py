"""paint: textures read where the rays of pixels meet known faces."""

import numpy as np
import pytest

from toile.kernels import InputError, paint, raster

K = np.array([[64.0, 0, 32], [0, 64, 24], [0, 0, 1]])
SIZE = (48, 64)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
UV = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])


def slanted(distance=2.0):
    """A square that fills the picture, its right side twice as far."""
    return distance * np.array([[-1.0, -1, 1], [2, -2, 2], [2, 2, 2], [-1, 1, 1]])


def ramp(size=64):
    """(T,T,2): u and v of each texel's centre."""
    at = (np.arange(size) + 0.5) / size
    return np.stack([np.tile(at, (size, 1)), np.tile(1 - at[:, None], (1, size))], -1).astype(np.float32)


def painted(V, textures, F=SQUARE, uv=UV, face_uv=SQUARE, first_face=(0,)):
    face = raster(V, F, K, SIZE).face
    return face, paint(face, V, F, uv, face_uv, K, textures, first_face)


def test_uvs_are_those_where_rays_meet_the_plane():
    face, picture = painted(slanted(), [ramp(256)])
    v, u = np.nonzero(face >= 0)
    ray = np.stack([(u + 0.5 - 32) / 64, (v + 0.5 - 24) / 64, np.ones(len(u))], 1)
    a, b, c = slanted()[[0, 1, 3]]
    normal = np.cross(b - a, c - a)
    point = ray * (a @ normal / (ray @ normal))[:, None]
    expected_u = (point[:, 2] - 2) / 2
    inside = (expected_u > 0.01) & (expected_u < 0.99)
    assert inside.sum() > 500
    assert np.abs(picture[0, v, u] - expected_u)[inside].max() < 1e-5


def test_beyond_the_outermost_texel_centres_a_texture_is_constant_and_empty_pixels_are_0():
    V = np.array([[-0.2, -0.2, 1], [0.2, -0.2, 1], [0.2, 0.2, 1], [-0.2, 0.2, 1]])
    face, picture = painted(V, [ramp(4)])
    seen = picture[:, face >= 0]
    assert seen.min() >= 0.125 - 1e-6 and seen.max() <= 0.875 + 1e-6
    assert (picture[:, face < 0] == 0).all() and (face < 0).any()


def test_each_layer_has_its_own_texture():
    behind, front = slanted(4), 0.5 * slanted(2) * [0.3, 0.3, 1]
    red, blue = (np.full((8, 8, 3), colour, np.float32) for colour in ([1, 0, 0], [0, 0, 1]))
    V, F = np.concatenate([behind, front]), np.concatenate([SQUARE, SQUARE + 4])
    uv, face_uv = np.concatenate([UV, UV]), np.concatenate([SQUARE, SQUARE + 4])
    face, picture = painted(V, [red, blue], F, uv, face_uv, (0, 2))
    np.testing.assert_allclose(picture[0], (face >= 0) & (face < 2), atol=1e-6)
    np.testing.assert_allclose(picture[2], face >= 2, atol=1e-6)
    assert picture[0].any() and picture[2].any()


def test_the_same_bits_for_any_number_of_threads(threads):
    answers = []
    for count in (1, 4):
        threads(count)
        answers.append(painted(slanted(), [ramp()])[1])
    assert np.array_equal(*answers)


def test_a_face_seen_edge_on_has_the_colour_of_its_middle():
    V = np.array([[1e-6, -1, 1], [-1e-6, -1, 5], [-1e-6, 1, 5]])
    K_through = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # the ray of the only pixel is the axis
    picture = paint([[0]], V, [[0, 1, 2]], UV[:3], [[0, 1, 2]], K_through, [ramp(64)])
    np.testing.assert_allclose(picture[:, 0, 0], [2 / 3, 2 / 3], atol=1e-5)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"face": np.full(SIZE, 2, np.int32)}, "paint: face has an index"),
        ({"V": slanted() * np.nan}, "vertices_camera"),
        ({"face_uv": SQUARE + 4}, "face_uv"),
        ({"face_uv": SQUARE[:1]}, "paint: face_uv has 1 rows, F 2"),
        ({"uv": UV + np.inf}, "uv"),
        ({"K": np.zeros((3, 3))}, "paint: K is not a camera matrix"),
        ({"textures": []}, "paint: 0 textures for 1 layers"),
        ({"textures": [np.zeros((4, 3, 3))]}, r"paint: a texture is not \(T,T,C\)"),
        ({"textures": [np.zeros((0, 0, 3))]}, "paint: textures are empty"),
        ({"first_face": (1,)}, "paint: first_face does not ascend from 0"),
        ({"face": np.zeros(3, np.int32)}, r"paint: face has shape \(3,\)"),
    ],
)
def test_bad_input_is_refused(change, words):
    given = {
        "face": np.zeros(SIZE, np.int32), "V": slanted(), "F": SQUARE, "uv": UV, "face_uv": SQUARE, "K": K,
        "textures": [ramp()], "first_face": (0,),
    } | change  # fmt: skip
    with pytest.raises(InputError, match=words):
        paint(*given.values())
