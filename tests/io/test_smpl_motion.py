"""Motions of the SMPL family, as AMASS has them: the body lies as the file's own joints do, whatever its rate, axes and kind."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.smpl import smpl_fields
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.export.bvh import write_bvh
from toile.io.export.clip import Clip, ClipSkeleton
from toile.io.motion import read_motion
from toile.io.smpl_motion import role_of
from toile.io.smpl_rest import KINDS, names_of, offsets_of, parents_of
from toile.io.strays import ASTRAY

START = np.array([0, 0, 0.9])
TREE = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]  # SMPL's kintree_table
STANDS = Rotation.from_rotvec([np.pi / 2, 0, 0])  # y up -> z up
LIMBS = [("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle")]
LIMIT = 0.1  # degrees of limbs: joints that lie between theirs, such as upperarm02, lie beside the straight line


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


def moved(kind, frames=24, turned=0.7, seed=0):
    """(T,j,3) poses of who walks with `turned` [rad] of heading, z up, every joint swinging, and (T,3) its path."""
    names, rng = names_of(kind), np.random.default_rng(seed)
    time = np.linspace(0, 1, frames)[:, None, None]
    poses = np.sin(2 * np.pi * (time + rng.uniform(size=(1, len(names), 1)))) * rng.normal(size=(len(names), 3)) * 0.25
    fingers = [j for j, name in enumerate(names) if role_of(name).startswith("finger")]
    poses[:, fingers] *= 0.5
    poses[:, 0] = (Rotation.from_rotvec(np.outer(turned + time[:, 0, 0], [0, 0, 1])) * STANDS).as_rotvec()
    return poses, np.array([1.0, 2.0, 0.95]) + time[:, 0] * [0.4, -1.1, 0.05]


def fields(turns, path, fps=30.0, **changed):
    """Of an AMASS file; what is None is left out."""
    whole = {"poses": turns.reshape(len(turns), -1) if len(turns) else np.zeros((0, 72)), "trans": path}
    unread = {"betas": np.zeros(16), "gender": "neutral", "dmpls": np.zeros((len(turns), 8))}
    return whole | {"mocap_framerate": fps} | unread | changed


def saved(path, given):
    np.savez(path, **{name: value for name, value in given.items() if value is not None})
    return path


def read(path, model, fps=30.0):
    return read_motion(path, model, model.J, fps, START)


def turned_y_up(poses, trans):
    """The same motion in a world whose y is up."""
    poses = poses.copy()
    poses[:, 0] = (STANDS.inv() * Rotation.from_rotvec(poses[:, 0])).as_rotvec()
    return poses, STANDS.inv().apply(trans)


def file_joints(kind, poses, trans):
    """{joint: (T,3)} where the file's own joints lie, z up, turned about it so that the first frame faces -y."""
    names, parents, offsets = names_of(kind), parents_of(names_of(kind)), offsets_of(kind, names_of(kind))
    front = Rotation.from_rotvec(poses[0, 0]).apply([0, 0, 1])
    face = Rotation.from_rotvec([0, 0, -np.arctan2(front[0], -front[1])])
    world, places = {}, {}
    for name, parent, offset, turn in zip(names, parents, offsets, np.swapaxes(poses, 0, 1)):
        above = face if parent < 0 else world[names[parent]]
        world[name] = above * Rotation.from_rotvec(turn)
        places[name] = face.apply(trans) if parent < 0 else places[names[parent]] + above.apply(offset)
    return places


def body_joints(model, motion):
    """(T,K,3) where the driven body's joints lie."""
    of = zip(motion.rotations, motion.translation)
    return np.stack([model.joint_transforms(model.J, turns, place)[1] for turns, place in of])


def angles(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1)))


def test_the_skeleton_is_smpls():
    assert list(parents_of(names_of("smpl"))) == TREE
    assert list(parents_of(names_of("smplx"))) == [*TREE[:22], 15, 15, 15, *_hand(20, 25), *_hand(21, 40)]
    for kind in KINDS:
        offsets = offsets_of(kind, names_of(kind))
        places = np.zeros_like(offsets)
        for j, parent in enumerate(parents_of(names_of(kind))):
            places[j] = (places[parent] if parent >= 0 else 0) + offsets[j]
        at = {name: places[j] for j, name in enumerate(names_of(kind))}
        for name, place in at.items():  # either side mirrors the other but for how bodies are uneven
            other = at[name.replace("left", "right")] if "left" in name else place
            np.testing.assert_allclose(other * [-1, 1, 1], place * [1 if "left" in name else -1, 1, 1], atol=0.04)
        assert at["left_wrist"][0] > 0.6 and at["left_foot"][2] > 0.05 and at["left_ankle"][1] < -0.8


def _hand(wrist, first):
    return [parent for f in range(first, first + 15, 3) for parent in (wrist, f, f + 1)]


@pytest.mark.parametrize("up", ["z", "y"])
@pytest.mark.parametrize("kind", KINDS)
def test_bones_point_where_the_files_own_joints_lie(model, tmp_path, kind, up):
    poses, trans = moved(kind)
    given = (poses, trans) if up == "z" else turned_y_up(poses, trans)
    motion = read(saved(tmp_path / "m.npz", fields(*given)), model)
    ours, theirs = body_joints(model, motion), file_joints(kind, poses, trans)
    at = lambda name: ours[:, model.joint(role_of(name))]
    for side in ("left", "right"):
        for a, b in ((f"{side}_{a}", f"{side}_{b}") for a, b in LIMBS):
            assert angles(at(b) - at(a), theirs[b] - theirs[a]).max() < LIMIT, (a, b)
        foot = angles(at(f"{side}_foot") - at(f"{side}_ankle"), theirs[f"{side}_foot"] - theirs[f"{side}_ankle"])
        assert foot.max() < ASTRAY["foot"]
    assert angles(at("neck") - at("pelvis"), theirs["neck"] - theirs["pelvis"]).max() < ASTRAY["trunk"]
    assert not motion.strays and ("fingers" in motion.missing) == (kind == "smpl")
    leg = ("left_hip", "left_knee", "left_ankle")
    of_body = _length([model.J[model.joint(role_of(name))] for name in leg])
    scale = of_body / _length([theirs[name][0] for name in leg])
    path = scale * (theirs["pelvis"] - theirs["pelvis"][0])
    np.testing.assert_allclose(motion.translation - motion.translation[0], path, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_soles_that_stand_flat_in_the_file_stand_flat(model, tmp_path, kind):
    """Shins at rest lead 8 degrees and more otherwise in one body than in the other; soles are flat in both."""
    poses, trans = moved(kind, 4)
    poses[:, 1:] = 0
    motion = read(saved(tmp_path / "m.npz", fields(poses, trans)), model)
    for k in range(4):
        turns = model.joint_transforms(model.J, motion.rotations[k], motion.translation[k])[0]
        for side in "LR":
            np.testing.assert_allclose(turns[model.joint(f"foot.{side}")][:3, :3] @ [0, 0, 1], [0, 0, 1], atol=1e-9)


def _length(places):
    return np.linalg.norm(np.diff(places, axis=0), axis=1).sum()


@pytest.mark.parametrize("kind", ["smplh", "smplx"])
def test_fingers_seen_from_the_palm_point_as_the_files(model, tmp_path, kind):
    poses, trans = moved(kind)
    motion = read(saved(tmp_path / "m.npz", fields(poses, trans)), model)
    ours, theirs = body_joints(model, motion), file_joints(kind, poses, trans)
    for side in ("left", "right"):
        at = lambda name, side=side: ours[:, model.joint(role_of(f"{side}_{name}"))]
        of = lambda name, side=side: theirs[f"{side}_{name}"]
        for finger in ("thumb", "index", "middle", "ring", "pinky"):
            for i in (1, 2):
                seen = [
                    np.swapaxes(_palm(place), 1, 2) @ (place(f"{finger}{i + 1}") - place(f"{finger}{i}"))[..., None]
                    for place in (at, of)
                ]
                assert angles(seen[0][..., 0], seen[1][..., 0]).max() < LIMIT, (side, finger, i)


def _palm(place):
    """(T,3,3) whose columns are along the palm, across it, and off it, by the wrist and two knuckles."""
    along = (place("index1") + place("pinky1")) / 2 - place("wrist")
    off = np.cross(along, place("index1") - place("pinky1"))
    axes = np.stack([along, np.cross(off, along), off], axis=2)
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def test_every_fourth_of_120_frames_a_second_drives_as_all_of_them(model, tmp_path):
    poses, trans = moved("smplh", 121)
    fast = read(saved(tmp_path / "fast.npz", fields(poses, trans, 120.0)), model)
    slow = read(saved(tmp_path / "slow.npz", fields(poses[::4], trans[::4], 30)), model)
    assert len(fast) == len(slow) == 31
    np.testing.assert_allclose(fast.rotations, slow.rotations, atol=1e-9)
    np.testing.assert_allclose(fast.translation, slow.translation, atol=1e-9)


def test_a_world_with_y_up_drives_as_with_z_up_and_it_is_said(model, tmp_path):
    poses, trans = moved("smplx")
    z = read(saved(tmp_path / "z.npz", fields(poses, trans)), model)
    y = read(saved(tmp_path / "y.npz", fields(*turned_y_up(poses, trans))), model)
    np.testing.assert_allclose(y.rotations, z.rotations, atol=1e-9)
    np.testing.assert_allclose(y.translation, z.translation, atol=1e-9)
    said = "y is taken as the motion's axis up"
    assert any(said in line for line in y.unfollowed([0])) and not any(said in line for line in z.unfollowed([0]))


def test_who_lies_is_refused_unless_the_file_says_which_axis_is_up(model, tmp_path):
    poses, trans = moved("smpl")
    poses[:, 0] = [0, 0, np.pi / 2]  # along x
    said = 'lies.npz: from pelvis to neck it leads in most frames neither .* add a field up, "z" or "y"'
    with pytest.raises(UserError, match=said):
        read(saved(tmp_path / "lies.npz", fields(poses, trans)), model)
    motion = read(saved(tmp_path / "told.npz", fields(poses, trans, up="z")), model)
    joints = body_joints(model, motion)
    trunk = joints[:, model.joint("neck01")] - joints[:, 0]
    assert np.abs(trunk[:, 2]).max() < 0.5 * np.linalg.norm(trunk, axis=1).min()
    with pytest.raises(UserError, match="bad.npz: up is x, expected y or z"):
        read(saved(tmp_path / "bad.npz", fields(poses, trans, up="x")), model)


def test_a_walk_starts_where_the_body_stood_and_as_it_faces(model, tmp_path):
    for turned in (0.0, 2.0):
        motion = read(saved(tmp_path / "m.npz", fields(*moved("smplh", turned=turned))), model)
        root = Rotation.from_rotvec(motion.rotations[:, 0])
        front = root.apply([0, -1, 0])
        np.testing.assert_allclose(front[0], [0, -1, 0], atol=1e-9)
        np.testing.assert_allclose(front[-1], [np.sin(1), -np.cos(1), 0], atol=1e-9)  # it turns by 1 rad to its left
        np.testing.assert_allclose(motion.translation[0, :2], START[:2], atol=1e-9)


def bvh_of(path, poses, trans):
    """The file of the same motion whose joints are called as roles."""
    names, parents = names_of("smpl"), parents_of(names_of("smpl"))
    poses, trans = turned_y_up(poses, trans)
    places = offsets_of("smpl", names)
    for j, parent in enumerate(parents):
        places[j] += places[parent] if parent >= 0 else 0
    pose = lambda frame: (poses[frame], trans[frame])
    skeleton = ClipSkeleton(tuple(role_of(name) for name in names), parents, places, pose)
    write_bvh(Clip("walk", 30.0, "y", tuple(range(len(poses))), (), skeleton), path)
    return path


def test_a_bvh_of_the_same_motion_drives_to_the_same_poses(model, tmp_path):
    poses, trans = moved("smpl")
    poses[:, names_of("smpl").index("spine2")] = (
        0  # of three joints of the spine a BVH file's middle one is not matched
    )
    ours = read(saved(tmp_path / "m.npz", fields(poses, trans)), model)
    theirs = read(bvh_of(tmp_path / "m.bvh", poses, trans), model)
    feet = [model.joint(f"foot.{side}") for side in "LR"]  # of a BVH file they are turned with their shin's rest
    ours_at, theirs_at = (np.delete(motion.rotations, feet, axis=1) for motion in (ours, theirs))
    np.testing.assert_allclose(ours_at, theirs_at, atol=1e-6)
    np.testing.assert_allclose(ours.translation, theirs.translation, atol=1e-6)
    assert np.linalg.norm(ours.rotations, axis=2).max() > 0.5


SMPLS = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x left, y back, z up -> x left, y up, z front


@pytest.mark.parametrize("turn, up", [(SMPLS, "y"), (np.eye(3), "z")])
def test_a_body_that_is_smpls_takes_its_turns_as_they_are(tmp_path, turn, up):
    body = load_body_model(saved(tmp_path / "smpl.npz", smpl_fields()))
    names, poses, trans = names_of("smpl"), *moved("smpl", turned=0.0)
    assert body.joint_names == names
    poses[:, 0] = (Rotation.from_rotvec(np.outer(np.linspace(0, 1, len(poses)), [0, 0, 1])) * STANDS).as_rotvec()
    J = offsets_of("smpl", names) * 1.1  # a taller one
    J += np.random.default_rng(0).normal(size=J.shape) * 0.005  # of another shape
    for j, parent in enumerate(TREE):
        J[j] += J[parent] if parent >= 0 else 0
    J = (J @ SMPLS) @ turn.T  # SMPL's axes -> x left, y back, z up -> those of the scene
    motion = read_motion(saved(tmp_path / "m.npz", fields(poses, trans)), body, J, 30.0, turn @ START, up)
    given = poses.copy()
    given[:, 0] = (STANDS.inv() * Rotation.from_rotvec(poses[:, 0])).as_rotvec()  # to the body's own axes
    np.testing.assert_allclose(motion.rotations, given @ SMPLS @ turn.T, atol=1e-9)
    np.testing.assert_allclose(
        motion.translation - motion.translation[0], (trans - trans[0]) @ turn.T, atol=1e-9
    )  # of its own length of legs
    assert not motion.notes and not motion.missing


def test_parts_are_the_poses_that_they_make_up(model, tmp_path):
    poses, trans = moved("smplx")
    whole = read(saved(tmp_path / "m.npz", fields(poses, trans)), model)
    flat, cuts = poses.reshape(len(poses), -1), [3, 66, 69, 75]
    parts = dict(zip(("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand"), np.split(flat, cuts, axis=1)))
    given = fields(poses, trans, poses=None, mocap_framerate=None, mocap_frame_rate=30.0, surface_model_type="smplx")
    for name, extra in (("parts", {}), ("both", {"poses": flat})):
        motion = read(saved(tmp_path / f"{name}.npz", given | parts | extra), model)
        np.testing.assert_allclose(motion.rotations, whole.rotations, atol=1e-12)
    with pytest.raises(UserError, match="other.npz: poses and root_orient are not of one motion"):
        read(saved(tmp_path / "other.npz", given | parts | {"poses": flat[::-1]}), model)
    bare = given | {name: parts[name] for name in ("root_orient", "pose_body")}
    assert read(saved(tmp_path / "bare.npz", bare), model).missing == ("fingers",)
    with pytest.raises(UserError, match="unsaid.npz: surface_model_type is missing: of 22 joints nothing else tells"):
        read(saved(tmp_path / "unsaid.npz", bare | {"surface_model_type": None}), model)


def test_joints_that_turn_and_do_not_follow_are_told(model, tmp_path):
    poses, trans = moved("smplx")
    motion = read(saved(tmp_path / "m.npz", fields(poses, trans)), model)
    assert motion.unfollowed([0]) == ["the motion turns the jaw, toes, which do not follow it: they rest"]
    for j, name in enumerate(names_of("smplx")):
        if name == "jaw" or "foot" in name:
            poses[:, j] = 0
    assert not read(saved(tmp_path / "still.npz", fields(poses, trans)), model).unfollowed([0])


def bad(**changed):
    return lambda poses, trans: fields(poses, trans, **changed)


REFUSED = {
    "mocap_framerate is missing, and so is mocap_frame_rate": bad(mocap_framerate=None),
    "mocap_framerate is 0.0, expected one rate": bad(fps=0.0),
    "mocap_framerate is nan, expected one rate": bad(fps=np.nan),
    r"mocap_framerate is float64 \(2,\), expected one rate": bad(fps=np.ones(2)),
    "mocap_framerate is fast, expected one rate": bad(fps="fast"),
    "mocap_framerate is 30, mocap_frame_rate 60: they have to agree": bad(mocap_frame_rate=60.0),
    "trans is missing": bad(trans=None),
    r"trans is float64 \(24, 2\), expected numbers \(T,3\)": lambda p, t: fields(p, t[:, :2]),
    "poses has 24 frames, trans 23, expected as many": lambda p, t: fields(p, t[1:]),
    "trans has 0 frames, trans 0, expected as many, and one at least": lambda p, t: fields(p[:0], t[:0]),
    r"poses is float64 \(24, 75\), expected numbers \(T,66\) or \(T,72\)": lambda p, t: fields(
        p, t, poses=np.zeros((24, 75))
    ),
    r"poses is float64 \(24, 24, 3\), expected numbers": lambda p, t: fields(p, t, poses=p),
    "poses is not finite in frame 3": lambda p, t: fields(np.where(np.arange(24)[:, None, None] == 3, np.nan, p), t),
    "trans is not finite in frame 0": lambda p, t: fields(p, t * np.nan),
    r"trans: 1e\+30 m in frame 0, expected at most 10000": lambda p, t: fields(p, t * 0 + 1e30),
    r"poses: .* rad \(are they in degrees\?\) in frame .*, expected at most 6.283": lambda p, t: fields(
        np.degrees(p), t
    ),
    "surface_model_type is mano, expected smpl, smplh, smplx": bad(surface_model_type="mano"),
    "poses have 24 joints, of surface_model_type smplx 55 are expected": bad(surface_model_type="smplx"),
    "poses: holds pickled objects, expected plain arrays": bad(poses=np.array([{}], object)),
    "24 frames at 0.0001 a second are": bad(fps=1e-4),
    "rotations is missing, and so is poses, as of AMASS": bad(poses=None),
}


@pytest.mark.parametrize("said", REFUSED)
def test_a_bad_file_is_refused_by_what_is_wrong(model, tmp_path, said):
    path = saved(tmp_path / "bad.npz", REFUSED[said](*moved("smpl")))
    with pytest.raises(UserError, match=f"bad.npz: {said}") as told:
        read(path, model, 3000.0)
    assert "\n" not in str(told.value)


def test_a_pickle_of_poses_is_refused(model, tmp_path):
    (tmp_path / "m.pkl").write_bytes(b"")
    with pytest.raises(UserError, match="m.pkl: neither a run, nor a .bvh or .npz file"):
        read(tmp_path / "m.pkl", model)


def test_a_shape_that_is_not_the_mean_one_is_said_not_to_be_used(model, tmp_path):
    poses, trans = moved("smplh")
    notes = lambda **given: read(saved(tmp_path / "m.npz", fields(poses, trans, **given)), model).notes
    said = lambda **given: [text for text in notes(**given) if "betas" in text]
    assert not said() and not said(betas=None)
    (text,) = said(betas=np.r_[0.0, 1.5, np.zeros(14)])
    assert text == "the motion's betas are not used: how far it walks is scaled as if it were of the mean shape"
