"""Motions of other exporters: the body lies where the file's joints do, or it is said where not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.motion import read_motion

FIGURE = {  # joint: (parent, place at rest), y up, facing z
    "Hips": (None, (0, 0, 0)),
    "Spine": ("Hips", (0, 10, 0)),
    "Neck": ("Spine", (0, 40, 0)),
    "Head": ("Neck", (0, 10, 0)),
    **{
        f"{side}{joint}": (above if above in ("Hips", "Neck") else f"{side}{above}", (sign * x, y, z))
        for side, sign in (("Left", 1), ("Right", -1))
        for joint, above, (x, y, z) in (
            ("Arm", "Neck", (15, -5, 0)),
            ("ForeArm", "Arm", (28, 0, 0)),
            ("Hand", "ForeArm", (25, 0, 0)),
            ("UpLeg", "Hips", (10, -5, 0)),
            ("Leg", "UpLeg", (0, -45, 0)),
            ("Foot", "Leg", (0, -45, 0)),
            ("ToeBase", "Foot", (0, -5, 15)),
        )
    },
}
START = np.array([0, 0, 0.9])


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


def written(path, figure=FIGURE, placed=("Hips",), frames=({},), frame_time=1 / 30):
    """A BVH file; joints `placed` have channels of their place. `frames` of {joint: (place or None, turns about z, x, y)}."""
    order = []

    def of(name, depth):
        order.append(name)
        place = "Xposition Yposition Zposition " if name in placed else ""
        below = [line for child, (above, _) in figure.items() if above == name for line in of(child, depth + 1)]
        below = below or ["End Site", "{", "OFFSET 0 1 0", "}"]
        channels = f"CHANNELS {6 if place else 3} {place}Zrotation Xrotation Yrotation"
        offset = "OFFSET {:g} {:g} {:g}".format(*figure[name][1])
        return ["JOINT " * (depth > 0) + "ROOT " * (depth == 0) + name, "{", offset, channels, *below, "}"]

    head = of(next(iter(figure)), 0)
    rows = []
    for frame in frames:
        row = []
        for name in order:
            place, *turns = frame.get(name, (None, 0, 0, 0))
            row += [*(figure[name][1] if place is None else place)] * (name in placed) + turns
        rows.append(" ".join(f"{value:.9g}" for value in row))
    clip = ["MOTION", f"Frames: {len(rows)}", f"Frame Time: {frame_time:.9f}", *rows, ""]
    path.write_text("\n".join(["HIERARCHY", *head, *clip]))
    return path


def read(path, model):
    return read_motion(path, model, model.J, 30.0, START)


def under(name, figure=FIGURE):
    """The figure below a joint of this name at the origin, as some exporters write it."""
    return {name: (None, (0, 0, 0))} | {joint: (above or name, place) for joint, (above, place) in figure.items()}


@pytest.mark.parametrize("origin", ["Reference", "root"])
def test_hips_that_walk_below_a_joint_at_the_origin_walk(model, tmp_path, origin):
    steps = [{"Hips": ((0, 100, 10 * k), 0, 0, 0)} for k in range(5)]
    plain = read(written(tmp_path / "plain.bvh", frames=steps), model)
    below = read(written(tmp_path / "below.bvh", under(origin), frames=steps), model)
    assert plain.translation[-1, 1] < -0.3
    np.testing.assert_allclose(below.translation, plain.translation, atol=1e-9)
    np.testing.assert_allclose(below.rotations, plain.rotations, atol=1e-9)


def test_a_joint_above_the_hips_that_turns_carries_them_round(model, tmp_path):
    turns = [{"Reference": (None, 0, 0, 90 * k), "Hips": ((0, 100, 50), 0, 0, 0)} for k in (0, 1)]
    motion = read(written(tmp_path / "turns.bvh", under("Reference"), frames=turns), model)
    x, y, z = motion.translation[1] - motion.translation[0]
    assert abs(x - y) < 1e-9 < 0.3 < x and abs(z) < 1e-9  # from before the origin to its left


@pytest.mark.parametrize("swapped", [False, True])
def test_a_figure_whose_feet_point_backwards_is_refused(model, tmp_path, swapped):
    """Mirrored, or its sides swapped: knees would bend backwards."""
    side = lambda name: name and name.replace("Left", "?").replace("Right", "Left").replace("?", "Right")
    mirrored = {joint: (above, (-x, y, z)) for joint, (above, (x, y, z)) in FIGURE.items()}
    figure = {side(joint): (side(above), place) for joint, (above, place) in FIGURE.items()} if swapped else mirrored
    said = (
        "mirrored.bvh: at rest LeftFoot and RightFoot point backwards: left and right are swapped, or the file is mirr"
    )
    with pytest.raises(UserError, match=said):
        read(written(tmp_path / "mirrored.bvh", figure), model)
    bare = {joint: of for joint, of in figure.items() if "Toe" not in joint}
    assert len(read(written(tmp_path / "without_toes.bvh", bare), model)) == 1  # nothing tells


def test_a_figure_that_faces_backwards_at_rest_is_none_mirrored(model, tmp_path):
    turned = {joint: (above, (-x, y, -z)) for joint, (above, (x, y, z)) in FIGURE.items()}
    assert not read(written(tmp_path / "turned.bvh", turned), model).strays


def test_a_motion_that_starts_seated_stands_up_on_the_floor(model, tmp_path):
    sits = {f"{s}{j}": (None, 0, a, 0) for s in ("Left", "Right") for j, a in (("UpLeg", -90), ("Leg", 90))}
    frames = [sits | {"Hips": ((0, 55, 0), 0, 0, 0)}, {"Hips": ((0, 100, 0), 0, 0, 0)}]
    motion = read(written(tmp_path / "sits.bvh", frames=frames), model)
    np.testing.assert_allclose(motion.translation[1], START, atol=1e-9)
    assert 0.4 < motion.translation[0, 2] < 0.6


def test_limbs_that_lie_otherwise_than_the_file_leads_them_are_told(model, tmp_path):
    stretched = {"LeftHand": ((25, 25, 0), 0, 0, 0)}  # the hand leaves its place in the forearm
    motion = read(written(tmp_path / "hand.bvh", placed=("Hips", "LeftHand"), frames=[{}, stretched]), model)
    said = "LeftForeArm to LeftHand lies up to 45 degrees off where the motion leads it, most in frame 1"
    assert motion.unfollowed([0, 1])[1:] == [said] and not motion.unfollowed([0])[1:]  # the first: what the file lacks
    bent = FIGURE | {
        "Neck": ("Spine", (0, 30, 28)),
        "Head": ("Neck", (0, 5, 8)),
    }  # a rest that stoops: by turns alone it stands
    _, told = read(written(tmp_path / "stoops.bvh", bent, frames=[{}] * 2), model).unfollowed([0, 1])
    assert told.startswith("Hips to Neck lies up to 3")
    assert not read(written(tmp_path / "plain.bvh"), model).strays


def test_legs_that_point_up_at_rest_hang_where_the_motion_turns_them_down(model, tmp_path):
    up = {
        joint: (above, (x, 45, z)) if y == -45 else (above, (x, y, z)) for joint, (above, (x, y, z)) in FIGURE.items()
    }
    down = {f"{side}UpLeg": (None, 0, 180, 0) for side in ("Left", "Right")}
    motion = read(written(tmp_path / "up.bvh", up, frames=[down]), model)
    assert not any("Leg to" in told for told in motion.unfollowed([0]))
    straight = model.joint_transforms(model.J, motion.rotations[0], motion.translation[0])[1]
    assert straight[model.joint("foot.L"), 2] < straight[model.joint("upperleg01.L"), 2] - 0.6


@pytest.mark.parametrize("fps", [24.0, 50.0])
def test_a_steady_turn_of_a_file_is_steady_at_the_avatars_rate(model, tmp_path, fps):
    frames = [
        {"LeftForeArm": (None, 0, 0, -100 * k / fps), "Hips": ((0, 100, 90 * k / fps), 0, 0, 0)} for k in range(40)
    ]
    motion = read(written(tmp_path / "turn.bvh", frames=frames, frame_time=1 / fps), model)
    arm = Rotation.from_rotvec(motion.rotations[:, model.joint("lowerarm01.L")])
    assert len(motion) == int(39 * 30 / fps) + 1
    np.testing.assert_allclose(np.degrees((arm[1:] * arm[:-1].inv()).magnitude()), 100 / 30, atol=0.05)
    np.testing.assert_allclose(np.diff(motion.translation[:, 1], 2), 0, atol=1e-4)


UPS = {  # rows: where x, y, z of the figure lead in the file; how turns about the figure's y are turned there, about z, x, y
    "z": ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], (1, 0, 0)),
    "x": ([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (0, 1, 0)),
    "-y": ([[-1, 0, 0], [0, -1, 0], [0, 0, 1]], (0, 0, -1)),
}


@pytest.mark.parametrize("up", UPS)
def test_a_file_of_another_up_drives_as_the_one_turned_to_y(model, tmp_path, up):
    to, axis = np.array(UPS[up][0], float), np.array(UPS[up][1])
    assert np.linalg.det(to) > 0
    moves = lambda place, about: [
        {"Hips": (np.array([0, 100, 30 * k]) @ place, *(20 * k * about)), "LeftArm": (None, *(-30 * k * about))}
        for k in range(3)
    ]
    plain = read(written(tmp_path / "plain.bvh", frames=moves(np.eye(3), np.array([0, 0, 1]))), model)
    figure = {joint: (above, np.array(place, float) @ to) for joint, (above, place) in FIGURE.items()}
    turned = read(written(tmp_path / "turned.bvh", figure, frames=moves(to, axis)), model)
    np.testing.assert_allclose(turned.rotations, plain.rotations, atol=1e-9)
    np.testing.assert_allclose(turned.translation, plain.translation, atol=1e-9)
    assert np.abs(plain.rotations).max() > 0.5


def test_a_file_that_moves_otherwise_than_it_rests_is_refused(model, tmp_path):
    """Joints along their own bones' axes at rest: nothing tells what a standing figure's turns are."""
    figure = {joint: (above, np.array(place, float) @ UPS["z"][0]) for joint, (above, place) in FIGURE.items()}
    path = written(tmp_path / "lies.bvh", figure, frames=[{"Hips": ((0, 100, 0), 0, -90, 0)}] * 3)
    with pytest.raises(
        UserError, match="lies.bvh: at rest Hips to Head leads along z, and in most frames does not: it has"
    ):
        read(path, model)


def test_what_the_body_has_not_makes_no_motion_start_lower(model, tmp_path):
    """Toes that point down at rest, or something in a hand that is longer than the legs, are of no height of the hips."""
    down = FIGURE | {f"{side}ToeBase": (f"{side}Foot", (0, -15, 0)) for side in ("Left", "Right")}
    level = {f"{side}Foot": (None, 0, -80, 0) for side in ("Left", "Right")}
    pole = FIGURE | {"Pole": ("RightHand", (-30, -200, 0))}
    for name, figure, frame in (("down", down, level), ("pole", pole, {"RightHand": (None, -90, 0, 0)})):
        motion = read(written(tmp_path / f"{name}.bvh", figure, frames=[frame] * 3), model)
        np.testing.assert_allclose(motion.translation, np.tile(START, (3, 1)), atol=1e-9)


def test_places_that_are_written_as_nothing_leave_joints_where_they_rest(model, tmp_path):
    """As of exporters that give every joint six channels and move only the hips."""
    steps = [{"Hips": ((0, 100, 10 * k), 0, 0, 0), "LeftArm": (None, 20 * k, 0, 0)} for k in range(3)]
    nothing = {joint: ((0, 0, 0), 0, 0, 0) for joint in FIGURE}
    plain = read(written(tmp_path / "plain.bvh", frames=steps), model)
    turned = [
        nothing | {joint: (place or (0, 0, 0), *turns) for joint, (place, *turns) in step.items()} for step in steps
    ]
    motion = read(written(tmp_path / "all.bvh", placed=tuple(FIGURE), frames=turned), model)
    np.testing.assert_array_equal(motion.translation, plain.translation)
    np.testing.assert_array_equal(motion.rotations, plain.rotations)
