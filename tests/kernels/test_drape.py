"""drape: what falls, hangs, rests and slides as mechanics says; the least energy by another code; refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.spatial.transform import Rotation

from tests.support.cloths import GRAVITY, ball, edge_lengths, energy, sheet, slab, solver
from toile import kernels

FRAME = 1 / 30
FAR = ball(at=(0, 0, -50))


def advanced(cloth, body_V, seconds, dt=FRAME):
    for _ in range(round(seconds / dt)):
        result = cloth.step(body_V, dt)
    return result


def test_a_free_sheet_falls_by_half_g_t_squared_and_keeps_its_shape():
    V, F = sheet()
    cloth = solver(V, F, *FAR)
    cloth.start(V, FAR[0], settle=0)
    fallen = advanced(cloth, FAR[0], 0.5).V - V
    assert np.allclose(fallen, [0, 0, -GRAVITY * 0.5**2 / 2], atol=0.003 * GRAVITY * 0.5**2 / 2)
    assert np.ptp(fallen, axis=0).max() < 1e-9


def test_drag_leads_to_the_velocity_of_fall():
    V, F = sheet()
    cloth = solver(V, F, *FAR, drag=10)
    cloth.start(V, FAR[0], settle=0)
    before = advanced(cloth, FAR[0], 1).V
    speed = (before - cloth.step(FAR[0], FRAME).V)[:, 2] / FRAME
    assert np.allclose(speed, GRAVITY / 10, rtol=0.01)


def test_dry_drag_takes_its_deceleration_from_a_fall():
    V, F = sheet()
    cloth = solver(V, F, *FAR, dry_drag=GRAVITY / 4)
    cloth.start(V, FAR[0], settle=0)
    fallen = advanced(cloth, FAR[0], 0.5).V - V
    assert np.allclose(fallen, [0, 0, -GRAVITY * (3 / 4) * 0.5**2 / 2], atol=0.004 * GRAVITY * 0.5**2 / 2)


def test_dry_drag_leaves_a_swinging_sheet_still_where_without_it_swings_on():
    V, F = sheet(across=3, along=9, size=(0.1, 0.4))
    held = np.flatnonzero(V[:, 1] > 0.199)
    hanging = (
        np.stack([V[:, 0], 0 * V[:, 0], V[:, 1]], axis=1) @ Rotation.from_euler("x", 20, degrees=True).as_matrix().T
    )
    speed = {}
    for dry_drag in (0.0, 1.0):
        cloth = solver(hanging, F, *FAR, held=held, dry_drag=dry_drag)
        cloth.start(hanging, FAR[0], settle=0)
        before = advanced(cloth, FAR[0], 4).V
        speed[dry_drag] = np.linalg.norm(cloth.step(FAR[0], FRAME).V - before, axis=1).max() / FRAME
    assert speed[1.0] < 1e-3 < 0.1 < speed[0.0]  # [m/s]


def test_a_strip_held_at_both_ends_hangs_in_a_catenary():
    V, F = sheet(across=2, along=41, size=(0.02, 1.0))
    ends = np.flatnonzero(np.abs(V[:, 1]) > 0.499)
    cloth = solver(V, F, *FAR, held=ends, stretch=5000, bending=0, drag=2)
    cloth.start(V, FAR[0], settle=0)
    held = V[ends] * [1, 0.8, 1]
    for share in np.linspace(0.05, 1, 20):
        cloth.step(FAR[0], FRAME, V[ends] + share * (held - V[ends]))
    hung = advanced(cloth, FAR[0], 4).V
    a = brentq(lambda a: 2 * a * np.sinh(0.8 / (2 * a)) - 1.0, 0.05, 5)
    expected = a * np.cosh(hung[:, 1] / a) - a * np.cosh(0.4 / a)
    assert (
        np.abs(hung[:, 2] - expected).max() < 0.01
    )  # of 0.26 m: one sweep a substep leaves links of a long chain stretched


def test_a_sheet_held_at_two_corners_comes_to_the_least_energy_that_another_code_finds():
    V, F = sheet(across=6, along=6)
    fabric = dict(density=0.2, stretch=20.0, bending=1e-4)
    held = [0, 5]
    cloth = solver(V, F, *FAR, held=held, drag=4, **fabric)
    cloth.start(V, FAR[0], settle=0)
    hung = advanced(cloth, FAR[0], 6).V
    value, free = energy(V, F, **fabric), np.setdiff1d(np.arange(len(V)), held)

    def of_free(x):
        whole = V.copy()
        whole[free] = x.reshape(-1, 3)
        found, gradient = value(whole.ravel())
        return 1e3 * found, 1e3 * gradient.reshape(-1, 3)[free].ravel()

    least = minimize(
        of_free, hung[free].ravel(), jac=True, method="L-BFGS-B", options=dict(maxiter=5000, ftol=1e-15, gtol=1e-9)
    )
    assert np.abs(hung[:, 2]).max() > 0.3  # it hangs
    assert np.linalg.norm(least.x.reshape(-1, 3) - hung[free], axis=1).max() < 2e-3


def test_a_sheet_comes_to_rest_outside_of_a_ball():
    V, F = sheet(across=25, along=25, height=0.25)
    body_V, body_F = ball(0.2, subdivisions=4)
    cloth = solver(V, F, body_V, body_F, margin=0.004)
    settled = cloth.start(V, body_V, settle=1)
    assert settled.inside == 0 and settled.contacts > 50 and settled.strain < 0.1
    distance = kernels.signed_distance(settled.V, body_V, body_F)
    assert distance.min() > 0.95 * 0.004 and settled.V[:, 2].max() < 0.21
    assert len(kernels.intersecting_pairs(settled.V, F, body_V, body_F)) == 0
    after = advanced(cloth, body_V, 1).V
    again = cloth.step(body_V, FRAME).V
    assert np.linalg.norm(again - after, axis=1).mean() < 1e-3 and np.abs(after - settled.V).max() < 0.05


def tilted(angle):
    return GRAVITY * np.array([np.sin(angle), 0, -np.cos(angle)])


@pytest.mark.parametrize("friction, degrees", [(0.6, 25), (0.6, 40), (0.3, 15), (0.3, 30), (0, 5)])
def test_a_sheet_sticks_below_the_angle_of_friction_and_slides_above_as_coulomb_says(friction, degrees):
    V, F = sheet(height=0.002)
    body_V, body_F = slab((6.0, 2.0, 0.2))
    angle = np.radians(degrees)
    cloth = solver(V, F, body_V, body_F, friction=friction, gravity=tilted(angle))
    cloth.start(V, body_V, settle=0)
    slid = (advanced(cloth, body_V, 0.5).V - V)[:, 0]
    expected = max(0.0, GRAVITY * (np.sin(angle) - friction * np.cos(angle))) * 0.5**2 / 2
    assert np.allclose(slid, expected, rtol=0.01, atol=1e-4)


def test_a_body_that_starts_gently_carries_the_sheet_along_and_one_that_jerks_leaves_it_behind():
    V, F = sheet(height=0.002)
    body_V, body_F = slab()
    for acceleration, expected in [(0.1 * 0.6 * GRAVITY, 0.1), (3 * 0.6 * GRAVITY, 1.0)]:  # of what friction can give
        cloth = solver(V, F, body_V, body_F)
        cloth.start(V, body_V, settle=0.1)
        for t in np.arange(1, 11) * FRAME:
            result = cloth.step(body_V + [acceleration * t**2 / 2, 0, 0], FRAME)
        moved = (result.V - V)[:, 0] / (0.6 * GRAVITY * t**2 / 2)
        assert np.allclose(moved, expected, rtol=0.02)


def test_pushing_out_gives_no_velocity():
    V, F = sheet(height=-0.003)
    body_V, body_F = slab()
    cloth = solver(V, F, body_V, body_F, gravity=(0, 0, 0))
    started = cloth.start(V, body_V, settle=0)
    assert started.inside == len(V) and np.array_equal(started.V, V)
    out = cloth.step(body_V, FRAME)
    assert out.inside == 0 and np.allclose(out.V[:, 2], 0.002)
    assert np.allclose(advanced(cloth, body_V, 0.3).V, out.V, atol=1e-9)


def turned_out(body_V, body_F):
    """A ball whose top is lifted and mirrored: its faces look inwards there, as those of an armpit that folds through itself."""
    body_V, top = body_V.copy(), body_V[:, 2] > 0.15
    body_V[top] = body_V[top] * [-1, 1, 1] + [0, 0, 0.1]
    return body_V, body_F


def test_cloth_beside_a_body_that_folds_through_itself_is_not_drawn_through_it():
    body_V, body_F = turned_out(*ball(0.2))
    V, F = sheet(across=21, along=21, height=body_V[:, 2].max() + 0.03)
    cloth = solver(V, F, body_V, body_F, gravity=(0, 0, 0))
    assert cloth.start(V, body_V, settle=0.1).inside == 0
    for way in np.arange(1, 6)[:, None] * [0.005, 0, 0.002]:  # beside and towards it
        found = cloth.step(body_V + way, FRAME)
    assert found.inside == 0 and np.abs(found.V - V).max() < 1e-9


def test_cloth_lies_on_the_part_of_a_body_that_is_turned_out():
    body_V, body_F = turned_out(*ball(0.2))
    V, F = sheet(across=25, along=25, height=body_V[:, 2].max() + 0.01)
    cloth = solver(V, F, body_V, body_F)
    settled = cloth.start(V, body_V, settle=0.5)
    assert settled.inside == 0 and settled.strain < 0.2 and settled.V[:, 2].max() > body_V[:, 2].max()


def fallen(V, F, body_V, body_F, seconds=0.2, **options):
    cloth = solver(V, F, body_V, body_F, **options)
    cloth.start(V, body_V, settle=0)
    return advanced(cloth, body_V, seconds).V


def test_a_rigid_motion_of_cloth_body_and_gravity_moves_the_answer_along():
    (V, F), body = sheet(height=0.21), ball()
    R, t = Rotation.from_rotvec([0.5, -1.2, 0.7]).as_matrix(), np.array([3.0, -2, 1])
    here = fallen(V, F, *body)
    there = fallen(V @ R.T + t, F, body[0] @ R.T + t, body[1], gravity=R @ [0, 0, -GRAVITY])
    assert np.abs(there - (here @ R.T + t)).max() < 1e-6


@pytest.mark.parametrize("s", [1e-3, 1e3])
def test_other_units_of_length_give_the_same_answer(s):
    """With the density [kg/m^2] kept, forces per length grow by s^2 and bending by s^4."""
    (V, F), body = sheet(height=0.21), ball()
    here = fallen(V, F, *body)
    units = dict(
        gravity=(0, 0, -GRAVITY * s), margin=0.002 * s, max_depth=0.05 * s, stretch=500 * s**2, bending=1e-5 * s**4
    )
    assert np.abs(fallen(V * s, F, body[0] * s, body[1], **units) / s - here).max() < 1e-6


def test_frames_may_be_cut_in_any_way():
    (V, F), body = sheet(height=0.21), ball()
    whole, halves = solver(V, F, *body), solver(V, F, *body)
    for cloth in (whole, halves):
        cloth.start(V, body[0], settle=0)
    assert np.abs(advanced(whole, body[0], 0.2).V - advanced(halves, body[0], 0.2, dt=FRAME / 2).V).max() < 1e-3


def test_the_function_is_the_solver_frame_after_frame():
    (V, F), (body_V, body_F) = sheet(height=0.21), ball()
    bodies = np.stack([body_V, body_V + [0.02, 0, 0], body_V + [0.04, 0, 0]])
    cloth = solver(V, F, body_V, body_F, friction=0.4)
    expected = [cloth.start(V, bodies[0]).V, *(cloth.step(body, FRAME).V for body in bodies[1:])]
    assert np.array_equal(kernels.drape(V, F, edge_lengths(V, F), bodies, body_F, FRAME, friction=0.4), expected)


def test_the_number_of_threads_changes_no_bit(threads):
    (V, F), body = sheet(across=90, along=90, height=0.21), ball()
    found = []
    for count in (1, 4):
        threads(count)
        found.append(fallen(V, F, *body, seconds=3 * FRAME))
    assert np.array_equal(*found)


V, F = sheet()
LENGTHS = edge_lengths(V, F)
REFUSED = {
    "lengths has 3 entries": dict(lengths=[1.0, 1, 1]),
    r"lengths\[2\] is nan": dict(lengths=np.where(np.arange(len(LENGTHS)) == 2, np.nan, LENGTHS)),
    r"lengths\[0\] is -1": dict(lengths=-np.ones(len(LENGTHS))),
    "lengths leave the faces of cloth_F no area": dict(lengths=0 * LENGTHS),
    r"held\[1\]": dict(held=[0, 81]),
    "cloth_F is empty": dict(F=np.zeros((0, 3), np.int32)),
    "margin is -": dict(margin=-0.1),
    "stretch is 0": dict(stretch=0),
    "density is inf": dict(density=np.inf),
    "substep is 0": dict(substep=0),
    "gravity is not finite": dict(gravity=(0, 0, np.nan)),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_makes_no_cloth_is_refused_by_name(message):
    given = dict(F=F, lengths=LENGTHS, held=()) | REFUSED[message]
    cloth_F, lengths, held = (given.pop(name) for name in ("F", "lengths", "held"))
    with pytest.raises(kernels.InputError, match=f"drape: {message}"):
        kernels.DrapeSolver(cloth_F, len(V), lengths, FAR[1], len(FAR[0]), held, **given)


def test_places_and_times_that_cannot_be_are_refused_by_name():
    body_V, body_F = FAR
    cloth = solver(V, F, body_V, body_F, held=[0])
    with pytest.raises(kernels.InputError, match="drape: step without start"):
        cloth.step(body_V, FRAME)
    cloth.start(V, body_V, settle=0)
    hole = np.where(np.arange(len(body_V))[:, None] == 7, np.nan, body_V)
    for message, call in {
        r"V has 3 rows": lambda: cloth.start(V[:3], body_V),
        r"body_V\[7\] is not finite": lambda: cloth.step(hole, FRAME),
        r"body_V has 2 rows": lambda: cloth.step(body_V[:2], FRAME),
        r"held_V has 2 rows": lambda: cloth.step(body_V, FRAME, V[:2]),
        r"dt is 0": lambda: cloth.step(body_V, 0),
        r"dt is nan": lambda: cloth.step(body_V, np.nan),
        r"dt is 1000000": lambda: cloth.step(body_V, 1e6),
        r"settle is -1": lambda: cloth.start(V, body_V, settle=-1),
        r"body_V and body_F close on themselves around no volume": lambda: cloth.start(V, body_V * [1, 1, 0]),
    }.items():
        with pytest.raises(kernels.InputError, match=f"drape: {message}"):
            call()
    assert cloth.step(body_V, FRAME).V.shape == V.shape  # a refusal leaves the cloth as it was
