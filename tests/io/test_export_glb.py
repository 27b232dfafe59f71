"""Clips written as glTF, read back as its specification reads it, and by programs that are not ours."""

import json
import shutil
import struct
import subprocess

import numpy as np
import pytest
import trimesh

from tests.support.bending_clip import bending_clip
from tests.support.exported import NEAR, write
from toile.io.export.clip import TO_Y_UP
from toile.io.export.writing import MOTIONS


class Glb:
    """A GLB as its specification reads it, by json, struct and numpy alone."""

    def __init__(self, path):
        data = path.read_bytes()
        length = struct.unpack("<I", data[12:16])[0]
        self.tree, self.binary = json.loads(data[20 : 20 + length]), data[28 + length :]

    def array(self, i):
        accessor = self.tree["accessors"][i]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4", 5121: "u1", 5123: "<u2"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        flat = np.frombuffer(self.binary, kind, accessor["count"] * width, view.get("byteOffset", 0))
        return flat.reshape(-1, width).astype(np.float64 if kind == "<f4" else np.int64)

    def primitive(self, name):
        mesh = next(mesh for mesh in self.tree["meshes"] if mesh["name"] == name)
        return mesh["primitives"][0], mesh["extras"]["vertices"]


def y_up(V):
    return V @ TO_Y_UP["z"].T


def test_glb_holds_every_frame_as_a_morph_target(clip, tmp_path):
    write(clip, tmp_path / "clip.glb")
    glb = Glb(tmp_path / "clip.glb")
    sampler = glb.tree["animations"][0]["samplers"][0]
    assert np.allclose(glb.array(sampler["input"]).ravel(), [0, 0.04, 0.08, 0.16])
    weights = glb.array(sampler["output"]).reshape(4, 3)
    for layer in clip.layers:
        primitive, n = glb.primitive(layer.name)
        base = glb.array(primitive["attributes"]["POSITION"])
        targets = np.array([glb.array(target["POSITION"]) for target in primitive["targets"]])
        for row, frame in zip(weights, clip.frames):
            V = base + np.einsum("t,tni->ni", row, targets)
            assert np.abs(V[:n] - y_up(layer.at(frame))).max() < NEAR
        corners = glb.array(primitive["indices"]).reshape(-1, 3)
        assert np.abs(base[corners] - base[:n][layer.faces]).max() == 0
        uv = glb.array(primitive["attributes"]["TEXCOORD_0"])[corners]
        assert np.allclose(uv, layer.uv[layer.face_uv] * [1, -1] + [0, 1], atol=1e-7)


def test_glbs_joints_move_the_rest_surface_to_the_frames(tmp_path):
    clip = bending_clip()
    write(clip, tmp_path / "clip.glb", motion="skeleton")
    glb = Glb(tmp_path / "clip.glb")
    skin, nodes = glb.tree["skins"][0], glb.tree["nodes"]
    inverse = glb.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
    animation = glb.tree["animations"][0]
    played = {
        (c["target"]["node"], c["target"]["path"]): glb.array(animation["samplers"][c["sampler"]]["output"])
        for c in animation["channels"]
    }
    for row, frame in enumerate(clip.frames):
        world = trimesh_world(nodes, skin["joints"][0], played, row, np.eye(4), {})
        matrices = np.array([world[j] for j in skin["joints"]]) @ inverse
        for layer in clip.layers:
            primitive, n = glb.primitive(layer.name)
            parts = (glb.array(primitive["attributes"][name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
            V, joints, weights = parts
            V = np.einsum("nb,nbij,nj->ni", weights, matrices[joints], np.c_[V, np.ones(len(V))])[:, :3]
            assert np.abs(V[:n] - y_up(layer.at(frame))).max() < NEAR


def trimesh_world(nodes, i, played, row, above, found):
    """{node: world matrix (4,4)} of a node and those under it at one key of the animation."""
    turn = played.get((i, "rotation"))
    own = np.eye(4) if turn is None else trimesh.transformations.quaternion_matrix(np.roll(turn[row], 1))
    shift = played.get((i, "translation"))
    own[:3, 3] = nodes[i]["translation"] if shift is None else shift[row]
    found[i] = above @ own
    for child in nodes[i].get("children", []):
        trimesh_world(nodes, child, played, row, found[i], found)
    return found


@pytest.mark.parametrize("motion", MOTIONS)
def test_glb_is_found_sound_by_khronos_validator(textured, motion, tmp_path):
    write(textured, tmp_path / "clip.glb", motion=motion)
    ask = (
        "const fs = require('fs'); require('gltf-validator').validateBytes(new Uint8Array(fs.readFileSync("
        "process.argv[1]))).then(r => console.log(JSON.stringify(r.issues)))"
    )
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    done = subprocess.run(["node", "-e", ask, str(tmp_path / "clip.glb")], capture_output=True, text=True)
    if "Cannot find module" in done.stderr:
        pytest.skip("npm's gltf-validator is not installed, or not on NODE_PATH")
    issues = json.loads(done.stdout)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_glb_is_read_by_trimesh_with_its_texture(textured, tmp_path):
    write(textured, tmp_path / "clip.glb")
    scene = trimesh.load(tmp_path / "clip.glb", process=False)
    shirt, layer = scene.geometry["t-shirt"], textured.layers[1]
    assert np.abs(shirt.vertices[: len(layer.at(3))] - y_up(layer.at(3))).max() < NEAR
    assert shirt.visual.material.baseColorTexture.getpixel((4, 4)) == (200, 10, 10)
