"""Smoothing over time on a bending tube with a sleeve: what moves evenly stays, what flickers goes, by the dense solution."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.bending_tube import VERTICES, posed, smoother
from toile.scene import HIDDEN, INTERPOLATED, OBSERVED
from toile.stages.motion import Roughness, Smoother, Strengths, _smoothing, scan_beside, strength_of
from toile.surface.pose_smoothing import STRENGTHS

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module", name="smoother")
def smoother_():
    return smoother()


def strengths(value, noise=0.002):
    return Strengths(np.full(4, float(value)), np.full(4, noise), float(value))


def shirts(frames):
    return np.stack([dressed["sleeve"].vertices for _, dressed in frames])


def second(x):
    return x[2:] - 2 * x[1:-1] + x[:-2]


def test_an_even_motion_passes_unchanged(smoother):
    drift = np.arange(9)[:, None, None] * np.array([0.001, 0, 0.002])
    frames = posed(smoother, np.zeros(9), drift, drift)
    for before, after in zip(frames, smoother.smooth(frames, strengths(5))):
        assert np.allclose(after[0].vertices, before[0].vertices, atol=1e-12)
        assert np.allclose(after[1]["sleeve"].vertices, before[1]["sleeve"].vertices, atol=1e-12)
    frames = posed(smoother, 0.05 * np.arange(9))  # a joint that turns at one speed about one axis
    for before, after in zip(frames, smoother.smooth(frames, strengths(5))):
        assert np.allclose(after[0].rotations, before[0].rotations, atol=1e-12)
        assert np.allclose(after[0].vertices, before[0].vertices, atol=1e-9)
        assert np.allclose(after[0].face, before[0].face, atol=1e-9)


def test_a_constant_acceleration_passes_away_from_the_ends(smoother):
    fall = 0.001 * np.arange(41.0)[:, None, None] ** 2 * np.array([0, 0, 1.0])
    after = shirts(smoother.smooth(posed(smoother, np.zeros(41), 0, fall), strengths(1, noise=1)))
    middle = slice(14, 27)
    assert np.allclose(second(after)[middle], second(fall)[middle], atol=2e-6)


def test_the_pose_of_a_frame_that_no_scan_tells_follows_those_that_one_tells(smoother):
    angles = np.zeros(11)
    angles[5] = 0.1
    frames = posed(smoother, angles)
    guessed = [
        (replace(tracked, confidence=np.full_like(tracked.confidence, INTERPOLATED)), dressed)
        for tracked, dressed in frames
    ]
    mixed = [*frames[:5], guessed[5], *frames[6:]]
    weight = smoother.settings.unscanned_weight
    told, alone, beside = (
        np.linalg.norm([tracked.rotations[1] for tracked, _ in smoother.smooth(of, strengths(strength))], axis=1)
        for of, strength in ((frames, 5), (guessed, 5 * weight), (mixed, 5))
    )
    assert np.allclose(told, alone)  # all as well known
    assert beside[5] < 0.7 * told[5] and beside[4] < 0.7 * told[4]


def test_a_stretch_without_scans_is_smoothed_alike_with_a_scan_far_off_and_with_none(smoother):
    """Blocks of a film share no seam, whichever of them holds a scan."""
    noisy = 0.1 * np.random.default_rng(9).standard_normal(60)
    frames = posed(smoother, noisy, confidence=INTERPOLATED)
    frames[0] = posed(smoother, noisy[:1])[0]
    turns = lambda of: np.array([tracked.rotations[1] for tracked, _ in smoother.smooth(of, strengths(1))])
    assert np.allclose(turns(frames)[40:], turns(frames[15:])[25:], atol=1e-5)


def test_where_no_scan_tells_surfaces_go_along_with_their_smoothed_pose(smoother):
    angles = np.zeros(11)
    angles[5] = 0.1
    frames = posed(smoother, angles, confidence=INTERPOLATED)
    after = smoother.smooth(frames, Strengths(np.zeros(4), np.zeros(4), 5.0))
    for tracked, dressed in after:
        again = posed(smoother, tracked.rotations[1, :1])[0]
        assert np.allclose(tracked.rotations, again[0].rotations, atol=1e-9)
        move = tracked.translation - again[0].translation
        assert np.allclose(tracked.vertices, again[0].vertices + move, atol=1e-9)
        assert np.allclose(dressed["sleeve"].vertices, again[1]["sleeve"].vertices + move, atol=1e-9)
    scanned = posed(smoother, angles)
    kept = smoother.smooth(scanned, Strengths(np.zeros(4), np.zeros(4), 5.0))
    assert np.allclose(shirts(kept), shirts(scanned), atol=1e-12)  # a scan shows where they lie


@pytest.mark.parametrize("strength", [0.0, 2.0])
def test_frames_without_scans_take_their_surfaces_from_the_scanned_ones_beside_them(smoother, strength):
    """What the scans show beside the pose, and all share, is found in every frame, whatever was guessed there, and nothing jumps."""
    T, scanned = 25, np.arange(25) % 6 == 0
    bends, off = 0.1 * np.sin(0.3 * np.arange(T)), 0.02 * RNG.standard_normal((VERTICES, 3))
    seen = np.where(scanned, OBSERVED, HIDDEN)[:, None]
    found = lambda guess: smoother.smooth(
        posed(smoother, bends, confidence=seen, sleeve=np.where(scanned[:, None, None], 0.0, guess)),
        strengths(strength),
    )
    plain, guessed = (shirts(found(guess)) for guess in (0.0, 0.1 * RNG.standard_normal((T, VERTICES, 3))))
    assert np.allclose(plain, guessed, atol=1e-12)
    level = posed(smoother, np.zeros(T), confidence=seen, sleeve=np.where(scanned[:, None, None], off, 0.0))
    after = shirts(smoother.smooth(level, strengths(strength)))
    assert np.allclose(after, after[0], atol=1e-12) and np.allclose(after[0], shirts(level)[0], atol=1e-12)


def test_what_is_said_of_such_a_frame_s_garment_is_what_its_scans_say(smoother):
    """But that no scan shows it, and what its own pose tells of hands."""
    frames = posed(smoother, np.zeros(7), confidence=np.where(np.arange(7) % 6 == 0, OBSERVED, HIDDEN)[:, None])
    for t, (_, dressed) in enumerate(frames):
        said = {"observed": float(t % 6 == 0), "hand_contact": 0.1 * t, "loop_mm.far": 10.0 * t}
        dressed["sleeve"] = replace(dressed["sleeve"], diagnostics=said)
    smoothed = smoother.smooth(frames, strengths(0))
    after = [dressed["sleeve"] for _, dressed in smoothed]
    assert [scan_beside(tracked) for tracked, _ in smoothed] == [0, -1, -2, -3, 2, 1, 0]
    assert [d.diagnostics["loop_mm.far"] for d in after] == [0, 0, 0, 0, 60, 60, 60]
    assert [d.diagnostics["observed"] for d in after] == [1, 0, 0, 0, 0, 0, 1]
    assert [d.diagnostics["hand_contact"] for d in after] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    assert [d.confidence[0] for d in after] == [OBSERVED, *[INTERPOLATED] * 5, OBSERVED]


def test_without_any_scan_garments_are_smoothed_as_strongly_and_guessed_ones_not_at_all(smoother):
    def roughness(confidence):
        flicker = 0.001 * np.random.default_rng(8).standard_normal((9, VERTICES, 3))
        frames = posed(smoother, np.zeros(9), 0, flicker)
        told = lambda one: replace(one, confidence=np.full_like(one.confidence, confidence))
        return smoother.gather([(told(t), {n: told(g) for n, g in dressed.items()}) for t, dressed in frames])

    observed, interpolated, hidden = map(roughness, (OBSERVED, INTERPOLATED, HIDDEN))
    assert np.array_equal(observed.total, interpolated.total) and np.array_equal(observed.count, interpolated.count)
    assert (hidden.count == 0).all() and (observed.count[2:] > 0).all()


def test_noise_of_a_still_body_falls_by_the_dense_solution(smoother):
    T, s = 12, 3.0
    noise = 0.001 * RNG.standard_normal((T, VERTICES, 3))
    D = np.diff(np.eye(T), 2, axis=0)
    weight = RNG.uniform(0.1, 1, (T, VERTICES))
    d = _smoothing(weight, s, second(noise))
    for v in (0, 7, 50):
        w = weight[:, v]
        M = np.diag(s * np.maximum.reduce([w[:-2], w[1:-1], w[2:]]))
        expected = np.linalg.solve(np.diag(w) + D.T @ M @ D, -D.T @ M @ D @ noise[:, v])
        assert np.allclose(d[:, v], expected, atol=1e-12)
    after = shirts(smoother.smooth(posed(smoother, np.zeros(T), 0, noise), strengths(s)))
    assert np.abs(second(after)).mean() < 0.25 * np.abs(second(noise)).mean()


def test_a_vertex_hidden_for_some_frames_follows_its_neighbours_in_time(smoother):
    T, hidden = 15, slice(5, 9)
    drift = np.arange(T)[:, None, None] * np.array([0.004, 0, 0])
    wrong, confidence = np.array(np.broadcast_to(drift, (T, VERTICES, 3))), np.full((T, VERTICES), OBSERVED)
    wrong[hidden, 3] += 0.02 * RNG.standard_normal((4, 3))
    confidence[hidden, 3] = HIDDEN
    after = shirts(smoother.smooth(posed(smoother, np.zeros(T), 0, wrong, confidence), strengths(2)))
    true = smoother.templates[0].rest[3] + drift[:, 0] + [0, 0, 1]
    before = np.linalg.norm(wrong[hidden, 3] - drift[hidden, 0], axis=1)
    assert np.linalg.norm(after[hidden, 3] - true[hidden], axis=1).max() < 0.1 * before.max()
    others = np.arange(VERTICES) != 3
    assert np.allclose(after[:, others], smoother.templates[0].rest[others] + drift + [0, 0, 1], atol=1e-12)


def test_a_frame_that_misplaced_an_observed_vertex_counts_little(smoother):
    wrong = np.zeros((11, VERTICES, 3))
    wrong[5, 3] = [0, 0, 0.1]
    after = shirts(smoother.smooth(posed(smoother, np.zeros(11), 0, wrong), strengths(1)))[:, 3]
    assert np.linalg.norm(after - smoother.templates[0].rest[3] - [0, 0, 1], axis=1).max() < 0.01


def test_what_no_frame_knows_well_is_smoothed_no_more_than_what_all_know(smoother):
    """A step at the end, as of cloth that the last frames place elsewhere: it must not be carried off along a line."""
    step = np.where(np.arange(11)[:, None, None] > 7, 0.03, 0.0) * np.ones((VERTICES, 3))
    seen, hidden = (
        shirts(smoother.smooth(posed(smoother, np.zeros(11), 0, step, known), strengths(5)))
        for known in (OBSERVED, HIDDEN)
    )
    assert np.allclose(hidden, seen, atol=1e-12)


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_a_loop_cut_off_or_run_over_in_some_frames_is_laid_by_the_others(smoother, share):
    """Elsewhere the loop hangs free of the scan; in these frames it lies on the border of a web."""
    template = smoother.templates[0]
    far = np.flatnonzero(template.rest[:, 2] == template.rest[:, 2].max())
    narrowed = np.zeros((12, VERTICES, 3))
    confidence = np.full((12, VERTICES), OBSERVED)
    confidence[:, far] = INTERPOLATED
    for t in (4, 9):
        narrowed[t, far, :2] = (share - 1) * template.rest[far, :2]
        confidence[t, far] = OBSERVED
    frames = posed(smoother, np.zeros(12), 0, narrowed, confidence)
    for t, (_, dressed) in enumerate(frames):
        length = share if t in (4, 9) else 1.0
        dressed["sleeve"] = replace(
            dressed["sleeve"], diagnostics={"loop_length.far": 1.1 * length, "loop_share.far": length}
        )
    looped = replace(template, loops=(far,), loop_names=("far",))
    smoothed = Smoother(smoother.model, smoother.person, (looped,), smoother.settings, 30.0).smooth(
        frames, strengths(3)
    )
    off = np.linalg.norm(shirts(smoothed) - template.rest - [0, 0, 1], axis=2)
    assert off.max() < 0.1 * np.linalg.norm(narrowed, axis=2).max()
    for _, dressed in smoothed:  # what is said of the loop is said of where it is laid
        assert dressed["sleeve"].diagnostics["loop_length.far"] == pytest.approx(1.1, rel=0.04)
        assert dressed["sleeve"].diagnostics["loop_share.far"] == pytest.approx(1, rel=0.04)
    assert frames[4][1]["sleeve"].diagnostics["loop_share.far"] == share


@pytest.mark.parametrize("noise, acceleration", [(2e-5, 2e-5), (1e-5, 4e-5), (2e-5, 1e-5)])
def test_noise_and_motion_are_told_apart_by_their_second_differences(smoother, noise, acceleration):
    """Noise and accelerations that are white, of these standard deviations a coordinate."""
    T, n = 50, VERTICES
    rng = np.random.default_rng(1)
    motion = acceleration * rng.standard_normal((T, n, 3)).cumsum(0).cumsum(0)
    frames = posed(smoother, np.zeros(T), 0, motion + noise * rng.standard_normal((T, n, 3)))
    found = strength_of(smoother.gather(frames), 1e3, 1)
    assert found.strength[2] == pytest.approx((noise / acceleration) ** 2, rel=0.3)  # along the sleeve
    assert found.noise[2] == pytest.approx(noise * np.sqrt(2), rel=0.2)


def test_what_the_strength_knows_of_and_what_it_does_not(smoother):
    count = np.ones((4, 2))
    total = np.array([[1.0, 1.0], [1, 6], [1, 16], [0, 0]])  # noise alone, motion alone, smoother than that, stillness
    missed = 1e-4 * (1.0 + np.abs(np.arange(len(STRENGTHS)) - 5))
    found = strength_of(Roughness(total, count, missed, 1.0), 7, 3)
    assert found.strength.tolist() == [7, 0, 0, 0] and found.pose == 3 * STRENGTHS[5]
    found = strength_of(smoother.gather(posed(smoother, [0.3, 0, 0.3, 0])), 7, 3)
    assert not found.strength.any() and not found.pose  # fewer than five frames
    frames = posed(smoother, [0.3, 0.0])
    assert smoother.smooth(frames, strengths(5)) == frames


def test_of_no_strength_nothing_moves(smoother):
    frames = posed(smoother, RNG.uniform(0, 1, 7), 0, 0.01 * RNG.standard_normal((7, VERTICES, 3)))
    assert np.array_equal(shirts(smoother.smooth(frames, strengths(0, noise=0))), shirts(frames))


def test_the_whole_scene_turned_and_moved_is_smoothed_alike(smoother):
    """The root carries the rigid motion, so all that was found of the frames turns with it."""
    noise = 0.003 * RNG.standard_normal((9, VERTICES, 3))
    R, shift = Rotation.from_rotvec([0.3, -1, 0.5]), np.array([2, -1, 0.5])
    frames = posed(smoother, 0.02 * np.arange(9) ** 1.5, noise, noise)
    turned = []
    for tracked, dressed in frames:
        turns = tracked.rotations.copy()
        turns[0] = (R * Rotation.from_rotvec(turns[0])).as_rotvec()
        joint = smoother.model.J[0]
        layers = [replace(x, vertices=R.apply(x.vertices) + shift) for x in (tracked, dressed["sleeve"])]
        pose = {"rotations": turns, "translation": R.apply(tracked.translation + joint) + shift - joint}
        turned.append((replace(layers[0], **pose), {"sleeve": layers[1]}))
    one, other = smoother.smooth(frames, strengths(1)), smoother.smooth(turned, strengths(1))
    assert np.allclose(R.apply(shirts(one).reshape(-1, 3)) + shift, shirts(other).reshape(-1, 3), atol=1e-9)
