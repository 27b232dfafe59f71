"""Motions from runs, BVH and npz: what was written is what drives."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.smpl import smpl_fields
from toile.errors import RoomError, UserError
from toile.io.body import load_body_model
from toile.io.bvh import read_bvh
from toile.io.export.bvh import write_bvh
from toile.io.export.clip import Clip, ClipSkeleton
from toile.io.motion import read_motion
from toile.io.retargeting import MIDDLE, SIDED, starts_at


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


def read(path, model, fps=30.0):
    return read_motion(path, model, model.J, fps, np.array([0, 0, 0.9]))


def saved(path, **fields):
    np.savez(path, **fields)
    return path


def still(model, T=4, **changed):
    K = len(model.parents)
    return {"rotations": np.zeros((T, K, 3)), "translation": np.zeros((T, 3)), "fps": 30.0} | changed


def test_an_npz_comes_back_as_written(model, tmp_path):
    rng = np.random.default_rng(0)
    wanted = still(model, rotations=rng.normal(size=(4, len(model.parents), 3)), translation=rng.normal(size=(4, 3)),
                   face=0.1 * rng.normal(size=(4, 7, 3)))  # fmt: skip
    motion = read(saved(tmp_path / "m.npz", **wanted), model)
    for name in ("rotations", "translation", "face"):
        assert np.array_equal(getattr(motion, name), wanted[name])
    assert motion.frames.tolist() == [0, 1, 2, 3] and motion.fps == 30


def test_a_rate_that_holds_the_avatars_gives_its_own_frames(model, tmp_path):
    path = saved(tmp_path / "m.npz", **still(model, 9, translation=np.arange(27.0).reshape(9, 3), fps=120.0))
    assert read(path, model).translation[:, 0].tolist() == [0, 12, 24]


@pytest.mark.parametrize("fps", [15.0, 24.0, 25.0, 50.0, 59.94, 240.0])
def test_a_steady_motion_is_steady_at_another_rate(model, tmp_path, fps):
    """The nearest of 24 frames a second stand still in every fifth of 30: a stop that physics and temporal models would read."""
    T, a_second = int(2 * fps), lambda n: 1.5 * np.arange(n) / fps
    rotations = np.zeros((T, len(model.parents), 3))
    rotations[:, :3] = a_second(T)[:, None, None] * [[1, 0, 0], [0, 0.6, 0.8], [0, 0, -1]]
    steady = still(model, T, rotations=rotations, translation=np.outer(a_second(T), [1, 2, 3]), fps=fps)
    face = np.tile(0.1 * a_second(T)[:, None, None], (1, 2, 3))
    face[T // 2, 1] = np.nan
    motion = read(saved(tmp_path / "m.npz", **steady, face=face), model)
    at = 1.5 * np.arange(len(motion)) / 30
    near = 2 * 0.011 / fps  # files round their frame time: a hundredth of a frame is none
    assert abs(len(motion) - 60) <= 2
    np.testing.assert_allclose(motion.translation, np.outer(at, [1, 2, 3]), atol=3 * near)
    np.testing.assert_allclose(np.linalg.norm(motion.rotations[:, :3], axis=2), np.tile(at[:, None], 3), atol=near)
    np.testing.assert_allclose(motion.face[:, 0], np.tile(0.1 * at[:, None], 3), atol=near)
    assert 0 < np.isnan(motion.face[:, 1]).all(1).sum() <= 2 * 30 / fps + 1


@pytest.mark.parametrize(
    "changed, said",
    [
        ({"rotations": np.zeros((4, 3, 3))}, "rotations"),
        ({"translation": np.full((4, 3), np.nan)}, "translation is not finite"),
        ({"translation": np.full((4, 3), 1e30)}, r"translation: 1e\+30 m in frame 0, expected at most 10000"),
        ({"rotations": np.full((4, 104, 3), -1e5)}, r"rotations: 1.73e\+05 rad in frame 0, expected at most 1000"),
        (
            {"rotations": np.full((4, 104, 3), 30.0)},
            r"rotations: 52 rad \(are they in degrees\?\) in frame 0, .* 6.283",
        ),
        ({"fps": 0.0}, "fps 0"),
        ({"fps": 1e-9}, r"4 frames at 1e-09 a second are 9e\+10 at 30, expected at most 1000000"),
        ({"fps": "thirty"}, "fps"),
        ({"face": np.zeros((3, 7, 3))}, "face"),
        ({"face": np.full((4, 7, 3), 90.0)}, "face: 90 m from the head joint in frame 0, expected at most 1"),
        ({"face": np.full((4, 7, 3), np.inf)}, "face: inf m from the head joint in frame 0, expected at most 1"),
        ({"rotations": np.array([object()])}, "pickled objects"),
    ],
)
def test_a_bad_npz_is_refused_by_file_and_field(model, tmp_path, changed, said):
    path = saved(tmp_path / "bad.npz", **still(model, **changed))
    with pytest.raises(UserError, match=f"bad.npz.*{said}"):
        read(path, model)


def test_a_missing_field_or_file_is_refused(model, tmp_path):
    path = saved(tmp_path / "bad.npz", **{k: v for k, v in still(model).items() if k != "fps"})
    with pytest.raises(UserError, match="bad.npz: fps is missing"):
        read(path, model)
    with pytest.raises(UserError, match="nothing: no such file or folder"):
        read(tmp_path / "nothing", model)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(UserError, match="text.npz: not a .npz"):
        read(tmp_path / "text.npz", model)


BVH = """HIERARCHY
ROOT Hips
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT Spine
{
OFFSET 0 10 0
CHANNELS 3 Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 10 0
}
}
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 90 0 0 0 0 0 0 0
0 90 0 0 0 0 0 0 10
0 90 0 0 0 0 0 0 20
"""


def test_a_bvh_turns_its_own_joints_and_reports_those_it_lacks(model, tmp_path):
    (tmp_path / "a.bvh").write_text(BVH)
    motion = read(tmp_path / "a.bvh", model)
    spine = model.joint("spine04")
    assert np.allclose(np.degrees(motion.rotations[:, spine, 2]), [0, 10, 20])
    others = np.delete(motion.rotations, spine, 1)
    assert np.abs(others).max() < 1e-9
    assert np.allclose(motion.translation, [0, 0, 0.9])
    assert "upperarm01.L" in motion.missing and "spine04" not in motion.missing


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("Frame Time: ", "Frame Time: -", "Frame Time: -"),
        ("Frame Time: 0.0333333", "Frame Time: 33.3333", "Frame Time: 33.3333: it is in seconds, not in milliseconds"),
        ("Frames: 3", "Frames: 0", "Frames: 0"),
        ("Frames: 3", "Frames: 4", "27 numbers for 4 frames of 9 channels"),
        ("0 90 0 0 0 0 0 0", "0 90 nan 0 0 0 0 0", "frame 0, channel 2: nan"),
        (
            "CHANNELS 3 Zrotation",
            "CHANNELS 3 Zscale",
            "joint Spine: channel Zscale: expected positions and rotations about",
        ),
        ("Frame Time", "Time", "after MOTION expected 'Frames: N' and 'Frame Time: SECONDS'"),
    ],
)
def test_a_broken_bvh_is_refused_by_what_is_wrong(model, tmp_path, old, new, said):
    assert old in BVH
    (tmp_path / "a.bvh").write_text(BVH.replace(old, new, 1))
    with pytest.raises(UserError, match=f"broken BVH: {said}"):
        read(tmp_path / "a.bvh", model)


def test_how_the_words_of_motion_are_capitalised_and_spaced_does_not_matter(model, tmp_path):
    played = []
    for words in ("Frame Time:", "Frame time:", "FRAME TIME :", "FrameTime:"):
        (tmp_path / "a.bvh").write_text(BVH.replace("Frame Time:", words))
        played.append(read(tmp_path / "a.bvh", model).rotations)
    assert all(np.array_equal(one, played[0]) for one in played)


def test_a_motion_whose_frames_last_too_long_is_refused(model, tmp_path):
    path = saved(tmp_path / "a.npz", **still(model, fps=1e-4))
    with pytest.raises(UserError, match="a.npz: 4 frames at 0.0001 a second are 9e.07 at 3000"):
        read(path, model, 3000.0)


LIMB = (
    BVH.replace("Spine", "LeftArm")
    .replace("0 90 0 0 0 0 0 0", "0 90 0 0 0 0 0 30")
    .replace("OFFSET 0 10 0", "OFFSET 9 0 0")
)


def test_a_bvh_turns_the_joints_of_the_same_roles_in_another_skeleton(model, tmp_path):
    (tmp_path / "a.bvh").write_text(LIMB)
    other = load_body_model(saved(tmp_path / "smpl.npz", **smpl_fields()))
    ours, theirs = read(tmp_path / "a.bvh", model), read(tmp_path / "a.bvh", other)
    arm, shoulder = model.joint("upperarm01.L"), other.joint_names.index("left_shoulder")
    assert np.abs(ours.rotations[0, arm]).max() > 0.3
    np.testing.assert_allclose(theirs.rotations[:, shoulder], ours.rotations[:, arm], atol=1e-12)
    assert np.abs(np.delete(theirs.rotations, shoulder, 1)).max() < 1e-9
    np.testing.assert_allclose(theirs.translation, ours.translation, atol=1e-12)


def turn_to(up):
    """What takes z to the axis `up`, as body models are turned."""
    return np.roll(np.eye(3), "xyz".index(up) - 2, axis=0)


SMPLS = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x left, y back, z up -> x left, y up, z front
STANDS = {
    "x up": (turn_to("x"), "x"),
    "y up": (turn_to("y"), "y"),
    "z up": (turn_to("z"), "z"),
    "as SMPL, y up": (SMPLS, "y"),
    "as SMPL, z up": (turn_to("y").T @ SMPLS, "z"),
}


@pytest.fixture(scope="module")
def walk(model):
    """Rotations (T,K,3) and translations (T,3) of a person, z up, who turns by 90 degrees on the way and moves every joint that a
    BVH file is asked for."""
    time, moved = np.linspace(0, 1, 12)[:, None], sorted({*SIDED} & {n.split(".")[0] for n in model.joint_roles})
    names = [*MIDDLE, *(f"{name}.{side}" for name in moved for side in "LR")]
    rotations = np.zeros((12, len(model.parents), 3))
    for name, axis in zip(names, np.random.default_rng(0).normal(size=(len(names), 3))):
        rotations[:, model.joint(name)] = 0.4 * time * axis
    rotations[:, 0] = time * [0, 0, np.pi / 2]
    return rotations, np.array([0, 0, 0.9]) + time * [0.5, -1.0, 0.1]


def bvh_of(path, model, walk, turn, up):
    """The file that `toile export` writes of the walk by a body turned by `turn`."""
    pose = lambda frame: (walk[0][frame] @ turn.T, turn @ walk[1][frame])
    skeleton = ClipSkeleton(model.joint_names, tuple(model.parents.tolist()), model.J @ turn.T, pose)
    write_bvh(Clip("walk", 30.0, up, tuple(range(len(walk[0]))), (), skeleton), path)
    return path


@pytest.mark.parametrize("stands", STANDS)
def test_a_bvh_moves_a_turned_body_as_it_moves_the_body_turned(model, walk, stands, tmp_path):
    turn, up = STANDS[stands]
    path = bvh_of(tmp_path / "walk.bvh", model, walk, np.eye(3), "z")
    upright = read(path, model)
    motion = read_motion(path, model, model.J @ turn.T, 30.0, turn @ [0, 0, 0.9], up)
    np.testing.assert_allclose(motion.rotations, upright.rotations @ turn.T, atol=1e-9)
    np.testing.assert_allclose(motion.translation, upright.translation @ turn.T, atol=1e-9)


@pytest.mark.parametrize("stands", STANDS)
def test_an_exported_bvh_comes_back_as_the_motion_that_it_was(model, walk, stands, tmp_path):
    turn, up = STANDS[stands]
    path = bvh_of(tmp_path / "walk.bvh", model, walk, turn, up)
    motion = read_motion(path, model, model.J @ turn.T, 30.0, turn @ walk[1][0], up)
    np.testing.assert_allclose(motion.rotations, walk[0] @ turn.T, atol=1e-6)
    np.testing.assert_allclose(motion.translation, walk[1] @ turn.T, atol=1e-6)


def test_a_motion_that_memory_has_no_room_for_is_refused_before_it_is_taken(model, tmp_path, monkeypatch):
    slow = saved(tmp_path / "slow.npz", **still(model, fps=0.003))
    monkeypatch.setattr("toile.io.motion.free_memory", lambda: 2**30)
    with pytest.raises(
        RoomError, match=r"slow.npz: 4 frames at 0.003 a second are 3e\+04 at 30: they take 3 GiB of memory, 1 are"
    ):
        read(slow, model)
    monkeypatch.setattr("toile.io.motion.free_memory", lambda: None)
    assert len(read(saved(tmp_path / "a.npz", **still(model)), model)) == 4


def test_a_joints_name_may_be_of_several_words_and_is_written_as_one(model, tmp_path):
    (tmp_path / "a.bvh").write_text(BVH)
    (tmp_path / "b.bvh").write_text(BVH.replace("Spine", "Lower Back"))
    one, other = (read_bvh(tmp_path / name) for name in ("a.bvh", "b.bvh"))
    assert other.names == tuple(name.replace("Spine", "Lower Back") for name in one.names) != one.names
    first, second = (read(tmp_path / name, model) for name in ("a.bvh", "b.bvh"))
    assert np.array_equal(first.rotations, second.rotations) and first.missing == second.missing
    pose = lambda frame: (np.zeros((3, 3)), np.zeros(3))
    skeleton = ClipSkeleton(("hips", "Lower Back", "Lower_Back"), (-1, 0, 0), np.eye(3), pose)
    clip = Clip("a", 30.0, "y", (0,), (), skeleton)
    write_bvh(clip, tmp_path / "c.bvh")
    assert read_bvh(tmp_path / "c.bvh").names == ("hips", "Lower_Back", "Lower_Back_")  # two joints, two names


@pytest.mark.parametrize(
    "turns, start", [([170, 0, 1, 2], 1), ([0, 30, 55, 80], 0), ([0, 1, 2, 30], 0), ([0, 40], 0), ([0], 0)]
)
def test_a_first_frame_is_left_out_where_a_leap_from_it_is_the_only_one(tmp_path, turns, start):
    rows = [f"0 90 0 0 0 0 0 0 {turn}" for turn in turns]
    head = BVH.split("Frames")[0] + f"Frames: {len(rows)}\nFrame Time: 0.0333333\n"
    (tmp_path / "a.bvh").write_text(head + "\n".join(rows) + "\n")
    assert starts_at(read_bvh(tmp_path / "a.bvh")) == start


def test_a_real_bvh_keeps_the_feet_near_the_ground(model, shared_data):
    motion = read(shared_data / "cmu_bvh_asf" / "01_01.bvh", model)
    assert len(motion) > 30 and np.isfinite(motion.rotations).all()
    ground = -model.v_template[:, 2].min()
    for k in (0, len(motion) // 2):
        V = model.skin(model.v_template, model.J, motion.rotations[k], motion.translation[k] + [0, 0, ground - 0.9])
        assert -0.3 < V[:, 2].min() < 0.5  # jumps and steps, scaled from the capture


@pytest.mark.parametrize(
    "old, new, said",
    [
        ("OFFSET 0 10 0\nCHANNELS", "CHANNELS", "broken BVH: joint Spine: its OFFSET is missing or not finite"),
        ("OFFSET 0 10 0\nCHANNELS", "OFFSET 0 nan 0\nCHANNELS", "broken BVH: joint Spine: its OFFSET"),
    ],
)
def test_a_joint_without_a_place_at_rest_is_refused(model, tmp_path, old, new, said):
    (tmp_path / "a.bvh").write_text(BVH.replace(old, new, 1))
    with pytest.raises(UserError, match=f"a.bvh: {said}"):
        read(tmp_path / "a.bvh", model)


def test_a_limb_without_length_is_refused(model, tmp_path):
    arm = "JOINT LeftArm\n{\nOFFSET 2 0 0\nCHANNELS 0\nJOINT LeftForeArm\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\n}\n"
    (tmp_path / "a.bvh").write_text(BVH.replace("End Site", arm + "End Site", 1))
    with pytest.raises(UserError, match="a.bvh: the bone from LeftArm to LeftForeArm has no length"):
        read(tmp_path / "a.bvh", model)


def test_a_motion_about_axes_of_another_up_is_refused(model, tmp_path, monkeypatch):
    with pytest.raises(UserError, match="m.npz: up is y there, z in the avatar's scene"):
        read(saved(tmp_path / "m.npz", **still(model, up="y")), model)
    assert len(read(saved(tmp_path / "n.npz", **still(model, up="z")), model)) == 4
    run = SimpleNamespace(scene=SimpleNamespace(up="y"))
    monkeypatch.setattr("toile.io.motion.is_run", lambda path: True)
    monkeypatch.setattr("toile.io.motion.open_run", lambda path: run)
    with pytest.raises(UserError, match="run: up is y there, z in the avatar's scene"):
        read(tmp_path / "run", model)


def test_a_run_of_another_body_model_is_refused_by_its_joints_names(model, tmp_path, monkeypatch):
    names = [*model.joint_names[:7], "tail", *model.joint_names[8:]]
    pose = SimpleNamespace(rotations=np.zeros((2, len(names), 3)))
    run = SimpleNamespace(scene=SimpleNamespace(up="z"), rows=lambda: [0, 1], pose=pose, joint_names=tuple(names))
    monkeypatch.setattr("toile.io.motion.is_run", lambda path: True)
    monkeypatch.setattr("toile.io.motion.open_run", lambda path: run)
    with pytest.raises(UserError, match=f"run: joint 7 of the run is tail, of the avatar {model.joint_names[7]}"):
        read(tmp_path / "run", model)


def test_an_npz_that_numbers_its_frames_is_played_as_they_lie_apart(model, tmp_path):
    apart = still(model, 3, translation=np.arange(9.0).reshape(3, 3), frames=np.array([10, 12, 16]))
    assert read(saved(tmp_path / "m.npz", **apart), model).translation[:, 0].tolist() == [0, 1.5, 3, 3.75, 4.5, 5.25, 6]
    far = still(model, 2, translation=np.outer([0, 400.0], [1, 0, 0]), frames=np.array([0, 400]))
    np.testing.assert_allclose(read(saved(tmp_path / "far.npz", **far), model).translation[:, 0], np.arange(401))
    with pytest.raises(UserError, match="bad.npz: frames is .* rising whole numbers"):
        read(saved(tmp_path / "bad.npz", **(apart | {"frames": np.array([0, 2, 1])})), model)
