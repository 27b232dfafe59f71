"""Loops traced in pictures: a tube of cloth that hangs free, with nothing under it for a label border to lie on."""

import numpy as np
import pytest

from tests.support.rig import ring_of_cameras
from tests.support.shapes import tube
from toile import kernels
from toile.config import LoopSettings, SegmentSettings
from toile.scene import Frame, Mesh, Segmented
from toile.surface.loops import LoopMatch
from toile.vision.evidence import Evidence, depth_views
from toile.vision.openings import Rivals, cloth_within, trace_opening, within
from toile.vision.visibility import DepthView

IDS, CLOTH = np.array([1, 2], np.uint8), 2


def cloth(low):
    """A tube of radius 0.2 m from `low` (a height, or one a direction) to 1.3 m."""
    V, F = tube(40, 96, 0.2, 1.0)
    bottom = low(np.arctan2(V[:, 1], V[:, 0])) if callable(low) else low
    V[:, 2] = bottom + V[:, 2] * (1.3 - bottom)
    return V, F


def wavy(angle):
    return 0.7 + 0.008 * np.sin(3 * angle)


@pytest.fixture(scope="module")
def seen():
    """Evidence of the true cloth, and Rivals."""
    V, F = cloth(wavy)
    cameras = ring_of_cameras(8, distortion=(0.0,) * 5)
    views = {name: DepthView(camera, V, F) for name, camera in cameras.items()}
    labels = {name: np.where(view.face >= 0, CLOTH, 0).astype(np.uint8) for name, view in views.items()}
    frame = Frame(0, Mesh(V, F), None, {}, {}, labels)
    segmented = Segmented(np.zeros(0, np.uint8), np.full(len(F), CLOTH, np.uint8), np.zeros((len(V), 2)), IDS, {}, {})
    return Evidence(frame, depth_views(frame.labels, cameras, V, F), Mesh(V, F), IDS, None, SegmentSettings()), Rivals(
        V, F, segmented, CLOTH
    )


def lowest_loop(V, F):
    return min(kernels.boundary_loops(F), key=lambda loop: V[loop, 2].mean())


@pytest.mark.parametrize("low", [0.69, 0.70, 0.71])
def test_a_free_opening_is_found_within_a_pixel_from_up_to_18_millimetres_off(seen, low):
    """A pixel is 5 mm wide at the cloth."""
    V, F = cloth(low)
    loop = lowest_loop(V, F)
    none = LoopMatch(V[loop], np.zeros(len(loop), bool), np.full(len(loop), np.nan))
    match = trace_opening(Mesh(V, F), loop, *seen, none, LoopSettings())
    off = match.target[:, 2] - wavy(np.arctan2(match.target[:, 1], match.target[:, 0]))
    assert match.observed.mean() > 0.95
    assert np.abs(off).mean() < 0.005
    assert np.abs(np.hypot(*match.target[:, :2].T) - 0.2).mean() < 0.007


def test_a_hem_that_swings_free_is_found_where_it_lies_beyond_the_usual_strip(seen):
    """Two fifths of the loop, blended over a tenth, lie 5 cm below cloth's end: more than the usual 3 cm."""
    turned = lambda angle: np.clip((np.cos(angle) - 0.3) / 0.3, 0, 1)
    V, F = cloth(lambda angle: 0.7 - 0.05 * turned(angle))
    loop = lowest_loop(V, F)
    none = LoopMatch(V[loop], np.zeros(len(loop), bool), np.full(len(loop), np.nan))
    angle = np.arctan2(V[loop, 1], V[loop, 0])
    low = turned(angle) == 1
    off = {}
    for reach in (0.03, 0.08):
        match = trace_opening(Mesh(V, F), loop, *seen, none, LoopSettings(far_reach=reach))
        off[reach] = np.abs(match.target[low, 2] - wavy(angle[low])).mean()
    assert off[0.03] > 0.03
    assert off[0.08] < 0.008


def test_a_loop_that_no_camera_sees_stands(seen):
    V, F = cloth(0.7)
    loop = lowest_loop(V, F)
    stands = LoopMatch(V[loop] + 0.01, np.zeros(len(loop), bool), np.full(len(loop), np.nan))
    dark = Evidence(None, {}, Mesh(V, F), IDS, None, SegmentSettings())
    assert trace_opening(Mesh(V, F), loop, dark, seen[1], stands, LoopSettings()) is stands


def test_what_two_pictures_show_before_the_background_lies_outside(seen):
    evidence = seen[0]
    V, F = cloth(wavy)
    assert not evidence.outside(V).any()
    assert not evidence.outside(0.9 * V * [1, 1, 0] + V * [0, 0, 1]).any()  # within the tube
    assert evidence.outside(1.15 * V * [1, 1, 0] + V * [0, 0, 1]).all()  # 3 cm off it, six pixels
    one = Evidence.__new__(Evidence)
    one.__dict__ = evidence.__dict__ | {"views": dict(list(evidence.views.items())[:1])}
    assert not one.outside(1.15 * V * [1, 1, 0] + V * [0, 0, 1]).any()


def test_targets_outside_of_the_silhouettes_are_drawn_into_them_and_count_as_not_seen(seen):
    """A loop of which a third has its targets on a web, 5 cm off the cloth."""
    evidence = seen[0]
    V, F = cloth(wavy)
    at = V[lowest_loop(V, F)]
    every, none = np.ones(len(at), bool), np.zeros(len(at), bool)
    good = LoopMatch(at, every, np.zeros(len(at)))
    assert within(at, good, evidence, Mesh(V, F), LoopSettings()) is good
    web = np.arange(len(at)) < len(at) // 3
    target = np.where(web[:, None], at * [1.25, 1.25, 1], at)
    match = within(at, LoopMatch(target, every, np.zeros(len(at))), evidence, Mesh(V, F), LoopSettings())
    np.testing.assert_array_equal(match.observed, ~web)
    assert np.linalg.norm(match.target - at, axis=1).max() < 0.02  # from 5 cm; the silhouettes leave two pixels
    all_outside = Mesh(V, F[:0])
    match = LoopMatch(target, none, np.zeros(len(at)))
    assert within(at, match, evidence, all_outside, LoopSettings()) is match


def test_where_masks_lack_the_cloth_or_little_of_a_loop_is_seen_it_stays(seen):
    evidence = seen[0]
    V, F = cloth(wavy)
    at = V[lowest_loop(V, F)]
    every, few = np.ones(len(at), bool), np.arange(len(at)) < len(at) // 5
    web = np.where((np.arange(len(at)) < len(at) // 3)[:, None], at * [1.25, 1.25, 1], at)
    covered = LoopMatch(web, few, np.where(few, 0.0, np.nan))
    assert within(at, covered, evidence, Mesh(V, F), LoopSettings()) is covered
    most_outside = LoopMatch(at * [1.25, 1.25, 1], every, np.zeros(len(at)))
    assert within(at, most_outside, evidence, Mesh(V, F), LoopSettings()) is most_outside
    far = np.where(few[:, None], most_outside.target, at * [3, 3, 1])  # of these the cloth lies beyond `far_reach`
    beyond = LoopMatch(far, every, np.zeros(len(at)))
    assert within(at, beyond, evidence, Mesh(V, F), LoopSettings()) is beyond


def test_cloth_within_the_silhouettes_is_none_where_pictures_and_scan_disagree(seen):
    evidence = seen[0]
    V, F = cloth(wavy)
    np.testing.assert_array_equal(cloth_within(Mesh(V, F), evidence).faces, F)
    beside = V * [1.25, 1.25, 1]
    few = np.concatenate([F, F[: len(F) // 20] + len(V)])
    np.testing.assert_array_equal(cloth_within(Mesh(np.concatenate([V, beside]), few), evidence).faces, F)
    assert len(cloth_within(Mesh(np.concatenate([V, beside]), np.concatenate([F, F + len(V)])), evidence).faces) == 0
