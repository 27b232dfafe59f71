"""Jitter and acceleration of motions whose second differences are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.shapes import sphere
from toile.measure.motion import Followed, MotionError, Slip

X = np.random.default_rng(0).standard_normal((5, 3))


def measured(places, trues):
    motion = MotionError()
    for number in places:
        motion.add(number, places[number], trues[number])
    return motion.measures()


def test_a_shake_of_known_size_adds_to_a_fall_of_known_speed():
    fall = {n: X - 0.002 * n**2 * np.array([0, 0, 1.0]) for n in range(6)}  # second difference 4 mm
    shake = {n: x + (-1) ** n * np.array([0.003 / 4, 0, 0]) for n, x in fall.items()}  # 3 mm
    assert measured(shake, fall) == pytest.approx({"jitter_mm": 3.0, "acceleration": 1.25})
    assert measured(fall, fall) == pytest.approx({"jitter_mm": 0.0, "acceleration": 1.0})
    still = {n: X for n in range(6)}
    assert measured(still, fall) == pytest.approx({"jitter_mm": 4.0, "acceleration": 0.0})
    assert measured(still, still)["acceleration"] is None


def test_frames_that_do_not_follow_one_another_say_nothing():
    apart = {n: X * n**2 for n in (0, 1, 3, 4, 6)}
    assert measured(apart, apart) == {"jitter_mm": None, "acceleration": None}


def test_points_of_a_true_body_are_followed_where_it_moves():
    V, F = sphere(24, 48)
    shown = np.arange(len(V)) % 7 > 0
    far = V.copy()
    far[1] *= 1.5
    followed = Followed(far, shown, V, F)
    assert followed.at.tolist() == np.flatnonzero(shown & (np.arange(len(V)) != 1)).tolist()
    assert np.allclose(followed.places(2 * V + [0, 0, 1]), 2 * V[followed.at] + [0, 0, 1], atol=1e-9)


def test_what_all_frames_err_by_alike_is_no_slip_also_of_a_garment_that_turns():
    V, F = sphere(24, 48, 0.3)
    slip = Slip()
    for number in range(4):
        R = Rotation.from_rotvec([0, 0.4 * number, 0.2 * number])
        normal = R.apply(V / 0.3)
        shake = (-1) ** number * 0.002
        slip.add((0.005 + shake) * normal, R.apply(V), F)
    found = slip.measures()
    assert found["shared_mm"] == pytest.approx(5, rel=1e-3) and found["slip_mm"] == pytest.approx(2, rel=1e-3)


def test_an_error_along_the_cloth_is_shared_wherever_the_garment_goes():
    """Each vertex lies up to 5 mm beside its place, the same way on the cloth in every frame."""
    V, F = sphere(24, 48, 0.3)
    beside, slip = 0.005 * np.cross([0, 0, 1], V / 0.3), Slip()
    for number in range(4):
        R = Rotation.from_rotvec([0.3 * number, 0, 0.5 * number])
        slip.add(R.apply(beside), R.apply(V) + [2.0 * number, -1, 0.5 * number**2], F)
    found = slip.measures()
    assert found["slip_mm"] < 1e-3
    assert found["shared_mm"] == pytest.approx(1e3 * np.linalg.norm(beside, axis=1).mean(), rel=1e-3)


def test_the_slip_of_a_fine_garment_is_that_of_some_of_its_vertices_and_of_one_frame_unknown():
    V, F = sphere(60, 120, 0.3)
    slip = Slip()
    slip.add(0.005 * V / 0.3, V, F)
    assert slip.measures() == {"slip_mm": None, "shared_mm": None}
    slip.add(0.007 * V / 0.3, V, F)
    assert slip.measures() == pytest.approx({"slip_mm": 1.0, "shared_mm": 6.0}, rel=1e-3)
    assert all(len(errors) <= 1000 < len(V) for errors in slip.errors)
