"""Laws of the packaged body model and of the loader."""

import numpy as np
import pytest

from tests.support.smpl import smpl_fields
from toile.errors import UserError
from toile.io.body import load_body_model


@pytest.fixture(scope="module")
def anny_model():
    return load_body_model("anny")


@pytest.fixture
def small():
    """The fields of a two-joint model of four vertices."""
    v = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    return dict(
        v_template=v,
        f=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        J=v[:2] / 2,
        parents=np.array([-1, 0]),
        weights=np.array([[1, 0], [0, 1], [0.5, 0.5], [0.25, 0.75]]),
        shapedirs=np.ones((4, 3, 2)),
        J_shapedirs=np.ones((2, 3, 2)),
    )


def save(tmp_path, fields):
    path = tmp_path / "model.npz"
    np.savez(path, **fields)
    return path


def test_packaged_model_is_sound_and_symmetric(anny_model):
    assert anny_model.v_template.shape == (13718, 3) and len(anny_model.parents) == 104
    assert anny_model.core is anny_model.core  # the core checks it all over again, once
    points = dict(zip(anny_model.keypoint_names, anny_model.keypoints(anny_model.v_template, anny_model.J)))
    for name, p in points.items():
        if name.endswith(".L"):
            twin = points[name[:-2].replace("hand_left", "hand_right") + ".R"]
            assert np.linalg.norm(twin * [-1, 1, 1] - p) < 1e-4, name
    assert sum(name.startswith("face.") for name in points) >= 20
    parts = [
        v
        for s, v in anny_model.segments.items()
        if s not in ("scalp", "eyes", "eye_sockets", "mouth_interior", "tongue")
    ]
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(13718))


def test_kinematics_reproduce_anny_in_a_random_pose(anny_model):
    pytest.importorskip("anny")
    torch = pytest.importorskip("torch")
    from scipy.spatial.transform import Rotation

    from toile.studio.make_body_model import load_anny

    other = load_anny()
    rng = np.random.default_rng(3)
    pose = torch.eye(4, dtype=torch.float64).repeat(1, 104, 1, 1)
    pose[0, :, :3, :3] = torch.as_tensor(Rotation.from_rotvec(rng.normal(0, 0.3, (104, 3))).as_matrix())
    phenotype = {
        k: torch.tensor([0.55], dtype=torch.float64)
        for k in ("gender", "age", "muscle", "weight", "height", "proportions")
    }
    with torch.no_grad():
        body = other(pose_parameters=pose, phenotype_kwargs=phenotype)
    rest, J = body["rest_vertices"][0].numpy(), body["rest_bone_heads"][0].numpy()
    G = body["bone_poses"][0, :, :3, :3].numpy() @ body["rest_bone_poses"][0, :, :3, :3].numpy().swapaxes(1, 2)
    parents = anny_model.parents
    local = [G[k] if p < 0 else G[p].T @ G[k] for k, p in enumerate(parents)]
    rotations = Rotation.from_matrix(np.array(local)).as_rotvec()
    translation = body["bone_poses"][0, 0, :3, 3].numpy() - J[0]
    posed = anny_model.skin(rest, J, rotations, translation)
    assert np.abs(posed - body["vertices"][0].numpy()).max() < 1e-12


def test_basis_holds_an_unseen_adult_to_two_millimetres(anny_model):
    pytest.importorskip("anny")
    pytest.importorskip("torch")
    from toile.studio.make_body_model import load_anny, sample_bodies

    V, J = sample_bodies(load_anny(), samples=5, seed=99)
    for v, j in zip(V, J):
        shape, *_ = np.linalg.lstsq(
            anny_model.shapedirs.reshape(-1, 16), (v - anny_model.v_template).ravel(), rcond=None
        )
        rest, joints = anny_model.rest(shape)
        assert np.linalg.norm(rest - v, axis=1).mean() < 2e-3 and np.linalg.norm(joints - j, axis=1).max() < 5e-3
        assert np.abs(shape).max() < 4


def test_dense_and_sparse_weights_and_a_joint_regressor_load_the_same_model(tmp_path, small):
    one = load_body_model(save(tmp_path, small))
    regressor = np.linalg.lstsq(np.c_[small["v_template"], np.ones(4)].T, np.c_[small["J"], np.ones(2)].T, rcond=None)[
        0
    ].T
    fields = {k: v for k, v in small.items() if k not in ("J", "J_shapedirs", "weights")}
    fields |= dict(J_regressor=regressor, weights_idx=one.weights_idx, weights_val=one.weights_val)
    two = load_body_model(save(tmp_path, fields))
    for name in ("J", "weights_val", "J_shapedirs", "v_template"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), atol=1e-14)


def test_units_and_up_convert(tmp_path, small):
    model = load_body_model(save(tmp_path, small | dict(units="cm", up="y")), up="z")
    np.testing.assert_allclose(model.v_template[2], [0, 0, 0.01])  # what pointed up still does
    assert np.linalg.det(model.v_template[1:]) > 0
    np.testing.assert_allclose(model.shapedirs, 0.01)


@pytest.mark.parametrize(
    "field, value, message",
    [
        ("f", np.array([[0, 1, 9]]), r"f\[0, 2\] is 9"),
        ("v_template", np.full((4, 3), np.nan), r"v_template\[0, 0\] is not finite"),
        ("parents", np.array([-1, 1]), r"parents\[1\] is 1"),
        ("weights", np.full((4, 2), 0.3), r"weights\[0\] sums to 0.6"),
        ("shapedirs", np.ones((5, 3, 2)), r"shapedirs has shape \(5, 3, 2\)"),
        ("units", "ell", "units is 'ell'"),
        ("posedirs", np.ones((4, 3, 9)), "posedirs is not zero"),
        ("J", None, "J_regressor is missing"),
    ],
)
def test_a_bad_field_is_refused_by_file_and_name(tmp_path, small, field, value, message):
    fields = small | {field: value} if value is not None else {k: v for k, v in small.items() if k != field}
    with pytest.raises(UserError, match=r"model\.npz: " + message):
        load_body_model(save(tmp_path, fields))


def test_pickles_and_absent_files_are_refused(tmp_path, small):
    with pytest.raises(UserError, match="pickled objects"):
        load_body_model(save(tmp_path, small | dict(joint_names=np.array([{}, []], dtype=object))))
    with pytest.raises(UserError, match="no such body model"):
        load_body_model(tmp_path / "nothing.npz")
    (tmp_path / "text.npz").write_text("not a zip")
    with pytest.raises(UserError, match="not a .npz"):
        load_body_model(tmp_path / "text.npz")


def test_a_foreign_skeleton_s_hands_are_those_of_the_packaged_model(tmp_path, anny_model):
    model = load_body_model(save(tmp_path, smpl_fields()))
    for name in ("hand_left", "hand_right"):
        ours, theirs = set(anny_model.segments[name].tolist()), set(model.segments[name].tolist())
        assert len(ours & theirs) > 0.97 * len(ours | theirs), name
    assert [model.joint_names[model.joint(role)] for role in ("head", "upperarm01.L", "lowerleg01.R", "foot.L")] == [
        "head",
        "left_shoulder",
        "right_knee",
        "left_ankle",
    ]


def test_segments_and_roles_of_the_file_come_before_what_names_tell(tmp_path):
    roles = np.array(["root", *["spine"] * 23])
    fields = smpl_fields() | dict(joint_roles=roles)
    fields |= dict(segment_names=["hand_left"], segment_vertices=[3, 5], segment_starts=[0, 2])
    model = load_body_model(save(tmp_path, fields))
    assert model.segments["hand_left"].tolist() == [3, 5] and "hand_right" not in model.segments
    assert model.joint_roles == tuple(roles) and model.joint("head") is None


def test_eyes_that_a_joint_moves_lie_within_the_skin(tmp_path, small, anny_model):
    names = np.array(["pelvis", "left_eye_smplhf"])
    model = load_body_model(save(tmp_path, small | dict(joint_names=names)))
    assert model.inside.tolist() == [False, True, False, True]
    assert not load_body_model(save(tmp_path, small)).inside.any()
    assert 1000 < anny_model.inside.sum() < 2000
