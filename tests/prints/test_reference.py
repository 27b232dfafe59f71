"""A template's own texture as the reference: it tells the slide that all frames share."""

import numpy as np
import pytest

from tests.support.printed_tube import RADIUS, around_and_up, dots, tube
from toile import kernels
from toile.config import PrintSettings
from toile.prints.colours import CHANNELS
from toile.prints.lattice import Lattice
from toile.prints.matching import Matcher
from toile.prints.reference import Reference, mean_print, print_of_texture, pyramid_of, reference_of
from toile.prints.sliding import SlidingSurface
from toile.vision.unwrapping import Unwrapped

SETTINGS = PrintSettings(lattice_spacing=0.012, blurs=(0.012,), blur_steps=(5,), mean_rounds=1)


def seen(points, turn):
    """What one camera that sees everything reads of the tube's dots, turned by `turn` [m]."""
    colours = np.clip(90 + 60 * dots(points, turn), 1, 255).astype(np.uint8)
    return [Unwrapped(np.arange(len(points)), colours, np.ones(len(points)))]


@pytest.mark.parametrize("textured", [True, False])
def test_only_a_texture_tells_what_all_frames_share(textured):
    V, F = tube()
    matcher = Matcher(SlidingSurface(V, F, kernels.boundary_loops(F), SETTINGS.lattice_spacing), V, SETTINGS)
    points = matcher.surface.lattice.positions
    frames, posed = [seen(points, turn) for turn in (0.030, 0.032)], [V, V]
    texture = np.log(seen(points, 0)[0].colours / 255 + 0.04) @ CHANNELS.T if textured else None
    reference = reference_of(matcher, [7, 9], frames, posed, 2, texture)
    assert reference.frames.tolist() == [7, 9] and len(reference.slides) == 2
    if not textured:
        assert reference.start is None
        return
    around, up = around_and_up(matcher, reference.start)
    inside = ~matcher.surface.on_loop
    assert np.abs(around[inside] - 0.030).mean() < 0.002 and np.abs(up[inside]).mean() < 0.002
    near = matcher.about(reference.start)
    pyramid = pyramid_of(near, frames[1], reference.offsets)
    found = near.match(pyramid, near.target(reference.values, reference.weights), V, reference.start)
    assert np.abs(around_and_up(matcher, found.d)[0][inside] - 0.032).mean() < 0.001


def test_a_frame_that_follows_none_begins_like_the_nearest_of_the_reference_or_like_all():
    """Slides of 60 mm are found from those of 55 mm, and not from none; where none fits better, that is taken."""
    V, F = tube()
    matcher = Matcher(SlidingSurface(V, F, kernels.boundary_loops(F), SETTINGS.lattice_spacing), V, SETTINGS)
    points, inside = matcher.surface.lattice.positions, ~matcher.surface.on_loop
    offsets, about = np.zeros((1, 3)), np.stack([-V[:, 1], V[:, 0], 0 * V[:, 0]], 1) / RADIUS
    frames = {number: pyramid_of(matcher, seen(points, turn), offsets) for number, turn in ((0, 0.0), (52, 0.060))}
    far = np.einsum("gai,gi->ga", matcher.surface.frames, 0.055 * about)
    slides = np.stack([0 * far, far])
    reference = Reference(V, *mean_print(matcher, [frames[0][-1:]], [0 * far]), offsets, np.array([0, 49]), slides)
    onto = matcher.target(reference.values, reference.weights)
    assert reference.starts(20)[0] is not None and not reference.starts(20)[0].any()

    def off(found, turn):
        return np.abs(around_and_up(matcher, found.d)[0][inside] - turn).mean()

    assert off(matcher.match(frames[52], onto, V), 0.060) > 0.02
    assert off(matcher.best(frames[52], onto, V, reference.starts(52)), 0.060) < 0.003
    assert off(matcher.best(frames[0], onto, V, [far, None]), 0.0) < 0.001


def test_a_texture_is_read_where_its_uvs_are():
    """A square whose UVs are its own places, v up, under a picture that grows to the right in red and upwards in green."""
    V = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    F = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    ramp = (np.arange(256) + 0.5) / 256 * 200 + 20
    picture = np.stack([np.tile(ramp, (256, 1)), np.tile(ramp[::-1, None], (1, 256)), np.full((256, 256), 99)], -1)
    lattice = Lattice(V, F, 8)
    found = print_of_texture(lattice, V[:, :2], F, picture.astype(np.uint8))
    x, y = lattice.positions[:, :2].T
    inner = (np.minimum(x, y) > 0.1) & (np.maximum(x, y) < 0.9) & (np.abs(x - y) > 0.1)
    red, green, blue = (np.log(c / 255 + 0.04) for c in (200 * x + 20, 200 * y + 20, 0 * x + 99))
    assert np.allclose(found[inner, 1], (red - green)[inner], atol=0.02)
    assert np.allclose(found[inner, 2], (blue - (red + green) / 2)[inner], atol=0.02)
