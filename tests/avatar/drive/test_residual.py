"""What is learnt over the poses of a training beside physics: near them it is used, far from them physics is left."""

import numpy as np

from toile.avatar.drive.residual import (
    CLOTH,
    CODES,
    FEWEST,
    FOLDS,
    JOINED,
    MEAN,
    MIXED,
    Residual,
    best_share,
    moving,
    teach,
)

RNG = np.random.default_rng(3)
MODES = RNG.normal(size=(2, 30, 3)) * 0.01


def sequence(T, swing=1.0):
    """Poses (T,2) on a circle, cloth that follows them exactly, and a simulation of `swing` times its motion, 2 cm too low."""
    a = np.linspace(0, 4 * np.pi, T)
    poses = 0.1 * np.stack([np.cos(a), np.sin(a)], 1)
    worn = 0.3 + np.tensordot(poses * 10, MODES, 1)
    hung = worn.mean(0) + swing * (worn - worn.mean(0)) - np.array([0, 0, 0.02])
    return poses, hung, worn


def error(residual, poses, hung, worn):
    return np.abs(np.stack([residual.add(s, p) for s, p in zip(hung, poses)]) - worn).max()


def test_where_physics_is_right_but_for_its_mean_that_alone_is_added():
    poses, hung, worn = sequence(40)
    found = teach(poses, hung, worn)
    assert error(found, poses, hung, worn) < 1e-3
    far = found.add(hung[3] + 0.05, np.array([9.0, 9.0]))
    assert np.allclose(far, hung[3] + 0.05 + [0, 0, 0.02], atol=1e-12)


def test_what_physics_gets_wrong_is_learnt_near_the_poses_and_left_to_physics_far_from_them():
    poses, hung, worn = sequence(60, swing=-0.5)
    found, means = teach(poses, hung, worn), Residual._means(worn.mean(0), hung.mean(0))
    between = (poses[1:] + poses[:-1]) / 2, (hung[1:] + hung[:-1]) / 2, (worn[1:] + worn[:-1]) / 2
    assert error(found, *between) < 0.1 * error(means, *between)
    assert np.allclose(found.add(hung[5], np.array([9.0, 9.0])), means.add(hung[5], poses[5]), atol=1e-12)


def test_poses_that_say_nothing_are_not_believed():
    poses, hung, worn = sequence(40)
    found = teach(RNG.normal(size=poses.shape), hung, worn + 0.001 * RNG.normal(size=worn.shape))
    means = Residual._means(found.registered, found.simulated)
    new = RNG.normal(size=(20, 2))
    shown = [np.stack([r.add(s, p) for s, p in zip(hung, new)]) for r in (found, means)]
    assert np.abs(shown[0] - shown[1]).max() < 0.003


def test_where_the_same_pose_hangs_in_two_ways_the_simulated_shape_says_which():
    """Cloth that lies left or right as it came there, in equal poses; its simulation goes the same ways, too short and elsewhere."""
    side = np.where(np.arange(48) // 3 % 2, 1.0, -1.0)
    poses, worn, hung = np.full((48, 2), 0.1), 0.3 + side[:, None, None] * MODES[0], side[:, None, None] * MODES[1]
    poses[:, 0] += 1e-3 * RNG.normal(size=48)
    found = teach(poses, hung, worn)
    assert found.swing_reach < 1 and error(found, poses, hung, worn) < 0.1 * np.abs(MODES[0]).max()


def test_what_was_missed_in_frames_left_out_is_kept_and_tells_cloth_that_slid_away():
    poses, hung, worn = sequence(40, swing=0.8)
    found = teach(poses, hung, worn).missed
    assert found.keys() == {MEAN, CLOTH, JOINED} and found[JOINED] <= found[CLOTH] < found[MEAN]
    motion = np.linalg.norm(worn - worn.mean(0), axis=2)
    assert np.isclose(found[MEAN], np.sqrt(np.square(motion).mean()), rtol=0.2)
    slid = hung + np.linspace(0, 0.3, 40)[:, None, None]
    assert teach(poses, slid, worn).missed[CLOTH] > found[MEAN]


def test_what_is_missed_is_by_choices_that_did_not_see_the_frames():
    """Poses and cloth of pure noise: the least of hundreds of errors would say that they tell something."""
    noise = lambda: RNG.normal(size=(24, 30, 3)) * 0.01
    found = [teach(RNG.normal(size=(24, 2)), noise(), noise()).missed for _ in range(12)]
    assert np.mean([one[JOINED] / one[MEAN] for one in found]) > 1.0


def test_cloth_and_codes_have_their_share_as_they_err():
    poses, hung, worn = sequence(60, swing=0.8)
    off = 0.01 * RNG.normal(size=worn.shape)
    right, wrong = teach(poses, hung, worn, worn), teach(poses, hung, worn, worn + off)
    assert right.trust < 0.01 and right.missed[MIXED] < 0.1 * right.missed[JOINED] and right.missed[CODES] < 1e-12
    assert wrong.trust > 0.9 and wrong.missed[MIXED] <= wrong.missed[JOINED] < wrong.missed[CODES]
    known = worn + off
    known[::2] = np.nan  # frames without a code
    some = teach(poses, hung, worn, known)
    assert np.isclose(some.missed[CODES], np.sqrt(np.square(off[1::2]).sum(2).mean())) and some.trust > 0.9


def test_what_is_missed_mixed_is_by_the_share_that_other_stretches_ask_for():
    """Codes that are right in one stretch alone: there the others, where codes err, give cloth all say."""
    poses, hung, worn = sequence(60, swing=0.8)
    codes = worn + 0.05 * RNG.normal(size=worn.shape)
    stretch = np.array_split(np.arange(60), FOLDS)[1]
    codes[stretch] = worn[stretch]
    found = teach(poses, hung, worn, codes)
    assert 0.9 < found.trust < 1.0 and found.missed[MIXED] >= 0.999 * found.missed[JOINED]


def test_the_share_is_the_one_of_least_error():
    registered, joined, decoded = (RNG.normal(size=(9, 5, 3)) for _ in range(3))
    near = RNG.uniform(size=9)
    error = lambda w: np.square(joined + ((1 - w) * near)[:, None, None] * (decoded - joined) - registered).sum()
    shares = np.linspace(0, 1, 1001)
    assert np.isclose(best_share(registered, joined, decoded, near), min(shares, key=error), atol=1e-3)
    assert best_share(registered, joined, decoded, 0 * near) == 1.0  # codes have no say
    assert (
        best_share(registered, registered, decoded, near) == 1.0
        and best_share(decoded, joined, decoded, near**0) == 0.0
    )


def test_few_frames_and_still_ones_keep_their_means():
    poses, hung, worn = sequence(FEWEST - 1)
    assert len(teach(poses, hung, worn).poses) == 0
    still = teach(np.zeros((8, 2)), np.repeat(hung[:1], 8, 0), np.repeat(worn[:1], 8, 0))
    assert np.allclose(still.add(hung[0], np.zeros(2)), worn[0])


def test_order_of_vertices_and_rigid_shifts_change_nothing():
    poses, hung, worn = sequence(30, swing=0.3)
    order, shift = RNG.permutation(30), np.array([1.0, -2.0, 0.5])
    plain, moved = teach(poses, hung, worn), teach(poses, hung[:, order] + shift, worn[:, order] + shift)
    at = hung[7] + 0.01
    assert np.allclose(plain.add(at, poses[7])[order] + shift, moved.add(at[order] + shift, poses[7]), atol=1e-9)


def test_a_pose_is_told_with_its_velocity_whatever_the_rate():
    times = np.arange(0, 1, 0.1)
    features = np.stack([2 * times, 0 * times], 1)
    found = moving(features, times)
    assert np.allclose(found[1:, 2], 2 / 6) and np.allclose(found[:, 3], 0) and found[0, 2] == 0
    assert np.allclose(moving(features[::2], times[::2])[1:], found[2::2])


def test_on_another_body_a_garment_moved_by_its_refit_is_corrected_alike():
    poses, hung, worn = sequence(40, swing=0.5)
    found, by = teach(poses, hung, worn), RNG.normal(size=worn[0].shape) * 0.1
    for pose in (poses[7], np.array([9.0, 9.0])):
        assert np.allclose(found.moved(by).add(hung[7] + by, pose), found.add(hung[7], pose) + by, atol=1e-12)
