import numpy as np
import pytest

from toile.errors import UserError


def test_offsets_lie_between_5_and_15_mm_and_outside_the_models_span(body):
    from toile.io.body import load_body_model

    largest = 1e3 * np.linalg.norm(body.offset, axis=1).max()
    assert 5 <= largest <= 15
    D = load_body_model("anny").shapedirs.reshape(-1, load_body_model("anny").shapedirs.shape[2])
    left = body.offset.ravel() - D @ np.linalg.lstsq(D, body.offset.ravel(), rcond=None)[0]
    assert np.linalg.norm(left) > 0.7 * np.linalg.norm(body.offset)


def test_skinning_weights_differ_from_the_pipelines_and_sum_to_one(body):
    from toile.io.body import load_body_model

    model = load_body_model("anny")
    theirs = np.zeros_like(body.dense_weights)
    np.put_along_axis(theirs, model.weights_idx, model.weights_val, axis=1)
    assert np.allclose(body.dense_weights.sum(1), 1)
    assert np.abs(body.dense_weights - theirs).sum(1).max() > 0.1
    assert np.array_equal(body.model.f, model.f)


def test_a_processor_on_which_anny_cuts_its_quads_otherwise_makes_the_same_body(body, monkeypatch):
    from toile.studio import body as studio

    load = studio.load_anny

    def elsewhere(**options):
        model = load(**options)
        faces = model.get_triangular_faces()
        other = faces.clone()
        flipped = 0
        for i in range(0, len(faces) - 1, 2):  # a quad's two triangles follow each other and share its diagonal
            shared = [v for v in faces[i].tolist() if v in faces[i + 1].tolist()]
            if flipped < 12 and len(shared) == 2:
                a, c = (v for t in faces[i : i + 2].tolist() for v in t if v not in shared)
                k = faces[i].tolist().index(a)
                b, d = faces[i].tolist()[(k + 1) % 3], faces[i].tolist()[(k + 2) % 3]
                other[i], other[i + 1] = other.new_tensor([a, b, c]), other.new_tensor([a, c, d])
                flipped += 1
        assert flipped == 12
        model.get_triangular_faces = lambda: other
        model.faces = other
        return model

    monkeypatch.setattr(studio, "load_anny", elsewhere)
    there = studio.make_body("fitted", np.random.default_rng(1))
    assert np.array_equal(there.model.f, body.model.f) and np.array_equal(there.skin_faces, body.skin_faces)
    assert (
        np.abs(there.rest - body.rest).max() < 1e-12 and np.abs(there.dense_weights - body.dense_weights).max() < 1e-12
    )


@pytest.mark.parametrize("name", ["walk", "rom", "talk", "talk+rom"])
def test_motions_start_near_the_a_pose_and_are_continuous(body, name):
    from toile.studio import motion
    from toile.studio.motions import make_motion

    m = make_motion(name, body, 12, np.random.default_rng(2))
    assert m.rotations.shape == (motion.RAMP + 12, len(body.J), 3)
    assert np.abs(m.rotations[0]).max() < np.radians(3)
    assert np.abs(np.diff(m.rotations, axis=0)).max() < np.radians(12)


def test_joined_motions_share_the_frames_and_pass_smoothly_into_each_other(body):
    from toile.studio import motion
    from toile.studio.motions import JOIN, make_motion

    n, half = 240, JOIN // 2
    cut = motion.RAMP + n // 2
    joined = make_motion("talk+rom", body, n, np.random.default_rng(4))
    rng = np.random.default_rng(4)
    talk = motion.eased(motion.talk(body, cut + half, rng))
    rom = motion.range_of_motion(body, motion.RAMP + n - cut + half, rng)
    assert joined.rotations.shape == (motion.RAMP + n, len(body.J), 3) and joined.grounded
    assert np.allclose(joined.rotations[: cut - half], talk.rotations[: cut - half])
    assert np.allclose(joined.rotations[cut + half :], rom.rotations[2 * half :])
    bend = np.abs(np.diff(joined.rotations, n=2, axis=0)).max((1, 2))
    assert bend[cut - half - 2 : cut + half].max() < 1.2 * max(bend[: cut - half].max(), bend[cut + half :].max())
    assert np.abs(joined.rotations[cut]).max() > 0.05


def test_a_long_range_of_motion_never_repeats_a_round(body):
    from toile.studio import motion

    turn = 12 * len(motion.ROM)
    R = motion.range_of_motion(body, 4 * turn, np.random.default_rng(5)).rotations
    limbs = [i for i, n in enumerate(body.model.joint_names) if not n.startswith("finger")]
    rounds = [R[28 + k * turn : (k + 1) * turn, limbs] for k in range(4)]
    assert all(np.abs(a - b).max() > 0.1 for i, a in enumerate(rounds) for b in rounds[:i])


def test_talk_stays_within_the_joint_limits(body):
    from toile.studio import motion

    m = motion.talk(body, 300, np.random.default_rng(3))
    for side, mirror in (("L", np.ones(3)), ("R", motion.MIRROR)):
        angles = np.degrees(m.rotations[:, body.model.joint(f"upperarm01.{side}")] * mirror)
        for axis, (low, high) in enumerate(motion.LIMITS["upperarm01"]):
            assert low - 1e-9 <= angles[:, axis].min() and angles[:, axis].max() <= high + 1e-9


BVH = """HIERARCHY
ROOT Hips
{ OFFSET 0 0 0
 CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
 JOINT LeftArm
 { OFFSET 3 4 0
  CHANNELS 3 Zrotation Yrotation Xrotation
  JOINT LeftForeArm
  { OFFSET 5 0 0
   CHANNELS 3 Zrotation Yrotation Xrotation
   JOINT LeftHand
   { OFFSET 3 0 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    { OFFSET 1 0 0
    } } } } }
MOTION
Frames: %d
Frame Time: 0.0333333
"""


def write_bvh(path, rows):
    path.write_text(BVH % len(rows) + "\n".join(" ".join(map(str, r)) for r in rows) + "\n")
    return str(path)


def test_bvh_limbs_take_the_files_bone_directions(body, tmp_path):
    from toile.studio import motion, motion_file

    n = motion.RAMP + 4
    rows = [[0, 9, 0, 0, 0, 0, 0, 0, 0, 0, -40, 0, 0, 0, 0]] * n  # forearm turned about y (up): to the front
    m = motion_file.motion_of_file(write_bvh(tmp_path / "a.bvh", rows), body, n)
    _, x = body.model.joint_transforms(body.J, m.rotations[-1], np.zeros(3))
    at = lambda name: x[body.model.joint(name)]
    arm, fore = at("lowerarm01.L") - at("upperarm01.L"), at("wrist.L") - at("lowerarm01.L")
    assert np.allclose(arm / np.linalg.norm(arm), [1, 0, 0], atol=1e-9)
    expected = [np.cos(np.radians(40)), -np.sin(np.radians(40)), 0]
    assert np.allclose(fore / np.linalg.norm(fore), expected, atol=1e-9)
    assert "upperarm01.R" in m.missing and "upperarm01.L" not in m.missing


def amass(path, frames, arms):
    """A file of SMPL's body whose upper arms hang `arms` [rad] below level, and who walks 3 m to the front."""
    poses = np.zeros((frames, 22, 3))
    poses[:, 0] = [np.pi / 2, 0, 0]  # z up
    poses[:, 16], poses[:, 17] = [0, 0, -arms], [0, 0, arms]
    trans = np.linspace([0, 0, 0.9], [0, -3, 0.9], frames)
    np.savez(path, poses=poses.reshape(frames, -1), trans=trans, mocap_framerate=30.0, surface_model_type="smplh")
    return str(path)


@pytest.mark.parametrize("arms", [0.3, 1.4])
def test_the_studio_reads_a_motion_of_amass_as_an_animation_does_but_for_arms_that_hang(body, tmp_path, arms):
    from toile.io.motion import read_motion
    from toile.studio.motion_file import LOWERING, TRAVEL
    from toile.studio.motions import RAMP, make_motion

    path = amass(tmp_path / "m.npz", RAMP + 4, arms)
    made = make_motion(path, body, 4, np.random.default_rng(0))
    theirs = read_motion(path, body.model, body.J, 30.0, np.zeros(3))
    low = lambda rotations: _below(body, rotations) - _below(body, np.zeros_like(rotations))
    if low(theirs.rotations[-1]) < LOWERING:
        assert np.allclose(made.rotations[RAMP:], theirs.rotations[RAMP:], atol=1e-12)
    else:
        assert low(made.rotations[-1]) == pytest.approx(LOWERING, abs=1e-6)
    assert theirs.translation[-1, 1] < -2 and -TRAVEL <= made.root[-1, 1] < -0.9 * TRAVEL


def _below(body, rotations):
    """Angle [rad] by which the left upper arm hangs below level, in the frontal plane."""
    _, x = body.model.joint_transforms(body.J, rotations, np.zeros(3))
    arm = x[body.model.joint("lowerarm01.L")] - x[body.model.joint("upperarm01.L")]
    return np.arctan2(-arm[2], abs(arm[0]))


def test_poses_of_a_body_model_are_no_motion_of_the_studio(body, tmp_path):
    from toile.studio.motions import make_motion

    np.savez(tmp_path / "own.npz", rotations=np.zeros((9, 4, 3)), translation=np.zeros((9, 3)), fps=30.0)
    with pytest.raises(UserError, match="own.npz: holds poses of a body model"):
        make_motion(str(tmp_path / "own.npz"), body, 4, np.random.default_rng(0))


@pytest.mark.parametrize("text", ["", "HIERARCHY\nMOTION\n", BVH % 2 + "1 2 3\n", BVH % 1 + "nan " * 15])
def test_broken_bvh_is_refused_with_its_name(tmp_path, text):
    from toile.io.bvh import read_bvh

    path = tmp_path / "broken.bvh"
    path.write_text(text)
    with pytest.raises(UserError, match="broken.bvh"):
        read_bvh(path)


def test_cmu_clip_is_retargeted_with_no_joint_missing(body, shared_data):
    from toile.studio import motion_file

    m = motion_file.motion_of_file(str(shared_data / "cmu_bvh_asf" / "01_01.bvh"), body, 60)
    assert m.missing == ()
    assert np.linalg.norm(m.root[:, :2], axis=1).max() <= motion_file.TRAVEL
    assert np.abs(np.diff(m.rotations[1:], axis=0)).max() < np.radians(40)


def test_hands_reach_the_belly_without_entering_it(body):
    from toile.studio import touch
    from toile.studio.motions import make_motion
    from toile.studio.truth import clearance

    m = make_motion("hands-on-cloth", body, 20, np.random.default_rng(0))
    V = body.pose(m.rotations[-1], np.zeros(3))
    trunk = body.dense_weights[:, [n.startswith("spine") for n in body.model.joint_names]].sum(1) > 0.9
    F = body.skin_faces[trunk[body.skin_faces].all(1)]
    for side in "LR":
        gap = clearance(V[touch.vertices_of(body, touch.HAND, side)], V, F)
        assert 0.008 < gap < 0.03
