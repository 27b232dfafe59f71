"""A rigged figure in glTF moves as glTF's own equations say, once it is a body model."""

import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.foreign_body import write_body_model

NAMES = ("Armature", "hips", "LeftUpLeg", "LeftLeg", "spine", "LeftArm", "Body")
CHILDREN = {0: (1, 6), 1: (4, 2), 2: (3,), 4: (5,)}
JOINTS = (3, 1, 2, 4, 5)  # of the skin, a child before its parent


def local(node):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix() * np.array(
        node.get("scale", (1, 1, 1))
    )
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T


def globals_of(nodes):
    above = {c: i for i, n in enumerate(nodes) for c in n.get("children", ())}

    def whole(i):
        return (whole(above[i]) if i in above else np.eye(4)) @ local(nodes[i])

    return [whole(i) for i in range(len(nodes))]


def figure(seed=0):
    """(document, buffer, positions (n,3), joints (n,4), weights (n,4)): an armature in centimetres, turned on its back, two
    primitives that share a seam."""
    rng = np.random.default_rng(seed)
    nodes = [
        {"name": name} | ({"children": list(CHILDREN[i])} if i in CHILDREN else {}) for i, name in enumerate(NAMES)
    ]
    nodes[0] |= {"rotation": Rotation.from_euler("x", -90, degrees=True).as_quat().tolist(), "scale": [0.01] * 3}
    for i in JOINTS:
        nodes[i] |= {
            "translation": rng.normal(0, 30, 3).tolist(),
            "rotation": Rotation.random(random_state=i).as_quat().tolist(),
        }
    nodes[6] |= {"mesh": 0, "skin": 0}
    G = globals_of(nodes)
    inside = np.linalg.inv(G[0])  # the mesh lies in the armature's frame
    bind = np.array([np.linalg.inv(inside @ G[j]) for j in JOINTS])
    v = rng.normal(0, 40, (12, 3)).astype("<f4")
    v[8:] = v[:4]  # the seam
    idx = rng.integers(0, 5, (12, 4)).astype("u1")
    val = rng.random((12, 4)).astype("<f4")
    val /= val.sum(1, keepdims=True)
    idx[8:], val[8:] = idx[:4], val[:4]
    uv = rng.random((12, 2)).astype("<f4")
    faces = [np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6]], "<u2"), np.array([[0, 1, 2], [1, 3, 2]], "<u2")]
    data, views, accessors = b"", [], []

    def put(array, kind, component):
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": component, "count": len(array), "type": kind})
        data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        return len(accessors) - 1

    parts = []
    for rows, f in ((slice(0, 8), faces[0]), (slice(8, 12), faces[1])):
        attributes = {
            "POSITION": put(v[rows], "VEC3", 5126), "JOINTS_0": put(idx[rows], "VEC4", 5121),
            "WEIGHTS_0": put(val[rows], "VEC4", 5126), "TEXCOORD_0": put(uv[rows], "VEC2", 5126),
        }  # fmt: skip
        parts.append({"attributes": attributes, "indices": put(f.reshape(-1, 1), "SCALAR", 5123)})
    matrices = put(bind.swapaxes(1, 2).reshape(5, 16).astype("<f4"), "MAT4", 5126)
    document = {
        "asset": {"version": "2.0"}, "nodes": nodes, "meshes": [{"primitives": parts}], "accessors": accessors,
        "skins": [{"joints": list(JOINTS), "inverseBindMatrices": matrices}], "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }  # fmt: skip
    return document, data, v.astype(float), idx, val.astype(float), bind


def save(path, document, data):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
    return path


def test_a_rig_moves_as_gltf_says(tmp_path):
    document, data, v, idx, val, bind = figure()
    said = write_body_model(save(tmp_path / "rig.glb", document, data), tmp_path / "rig.npz")
    assert said == "glTF: 8 vertices, 5 joints, 0 shapes, 4 keypoints"
    model = load_body_model(tmp_path / "rig.npz", up="y")
    assert model.joint_names == ("hips", "LeftUpLeg", "spine", "LeftLeg", "LeftArm")
    assert model.parents.tolist() == [-1, 0, 0, 1, 2]
    turns = {
        name: Rotation.from_rotvec(r)
        for name, r in zip(model.joint_names, np.random.default_rng(4).normal(0, 0.5, (5, 3)))
    }
    # glTF: each joint's node is turned about world axes at rest; vertices are sum w G_j B_j v
    nodes = json.loads(json.dumps(document["nodes"]))
    rest = globals_of(nodes)
    for i in JOINTS:
        frame = Rotation.from_matrix(rest[i][:3, :3] / np.cbrt(np.linalg.det(rest[i][:3, :3])))
        own = Rotation.from_quat(nodes[i]["rotation"])
        nodes[i]["rotation"] = (own * frame.inv() * turns[NAMES[i]] * frame).as_quat().tolist()
    G = globals_of(nodes)
    skin = np.array([G[j] for j in JOINTS]) @ bind
    posed = np.einsum("nb,nbij,nj->ni", val, skin[idx], np.c_[v, np.ones(len(v))])[:, :3]
    pose = np.array([turns[name].as_rotvec() for name in model.joint_names])
    ours = model.skin(model.v_template, model.J, pose, np.zeros(3))
    np.testing.assert_allclose(ours, posed[:8], atol=2e-6)
    assert model.f.tolist() == [[0, 1, 2], [1, 2, 3], [4, 5, 6], [0, 1, 2], [1, 3, 2]] and model.uv.shape == (12, 2)
    assert set(model.keypoint_names) == {"body.root", "body.upperleg01.L", "body.lowerleg01.L", "body.upperarm01.L"}


def test_a_document_with_its_buffer_beside_it_is_the_same(tmp_path):
    document, data, *_ = figure()
    (tmp_path / "rig.bin").write_bytes(data)
    document["buffers"][0]["uri"] = "rig.bin"
    (tmp_path / "rig.gltf").write_text(json.dumps(document))
    for name in ("rig.gltf",):
        write_body_model(tmp_path / name, tmp_path / "a.npz")
    del document["buffers"][0]["uri"]
    write_body_model(save(tmp_path / "rig.glb", document, data), tmp_path / "b.npz")
    a, b = (load_body_model(tmp_path / f"{name}.npz", up="y") for name in "ab")
    assert np.array_equal(a.v_template, b.v_template) and np.array_equal(a.weights_val, b.weights_val)


def spoil(document, data, how):
    if how == "outside":
        document["buffers"][0]["uri"] = "../rig.bin"
    elif how == "too many":
        document["accessors"][0]["count"] = 10**9
    elif how == "no skin":
        document["skins"] = []
    elif how == "circle":
        document["nodes"][3]["children"] = [1]
        document["nodes"][0]["children"] = [6]
    elif how == "sparse":
        document["accessors"][0]["sparse"] = {}
    elif how == "cut":
        data = data[:40]
    return document, data


@pytest.mark.parametrize(
    "how, message",
    [
        ("outside", r"buffers\.0\.uri: '\.\./rig\.bin' lies outside"), ("too many", r"accessors\.0: 1000000000 entries, more"),
        ("no skin", "not a rigged figure"), ("circle", "own ancestor"), ("sparse", "sparse accessors are not read"),
        ("cut", "more than its buffer's 40 bytes hold"),
    ],
)  # fmt: skip
def test_a_bad_figure_is_refused_by_field_and_leaves_nothing(tmp_path, how, message):
    document, data = spoil(*figure()[:2], how)
    with pytest.raises(UserError, match=r"rig\.glb: .*" + message):
        write_body_model(save(tmp_path / "rig.glb", document, data), tmp_path / "rig.npz")
    assert [p.name for p in tmp_path.iterdir()] == ["rig.glb"]
