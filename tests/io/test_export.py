"""Clips written for other programs, read back by libraries and programs that are not ours."""

import json
import shutil
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.support.bending_clip import bending_clip
from tests.support.small_disk import largest_file
from toile.errors import UserError, first_line
from toile.io.bvh import read_bvh
from toile.io.export.clip import TO_Y_UP, blend_skinning, rest_surface
from toile.io.export.source import with_frames, with_layers, with_textures
from toile.io.export.writing import MOTIONS, format_of, whole_file, write_clip
from toile.scene import joint_transforms

NEAR = 1e-6  # m: half a step of single precision at 16 m


def quiet(*_):
    pass


def write(clip, out, kind=None, motion=None):
    return write_clip(clip, out, format_of(out, kind), motion, quiet)


@pytest.fixture
def clip():
    return bending_clip(loose=0.003)


@pytest.fixture
def textured(clip, tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    Image.new("RGB", (8, 8), (200, 10, 10)).save(folder / "t-shirt.png")
    return with_textures(clip, folder)


# arrays and sequences ---------------------------------------------------------------------------------------------------


def test_npz_holds_every_number_as_it_is(clip, tmp_path):
    write(clip, tmp_path / "clip.npz")
    found = np.load(tmp_path / "clip.npz")
    assert found["frames"].tolist() == [3, 4, 5, 7] and found["fps"] == 25 and found["up"] == "z"
    for layer in clip.layers:
        assert np.array_equal(found[f"{layer.name}.vertices"], [layer.at(f) for f in clip.frames])
        for part in ("faces", "uv", "face_uv", "joints", "weights"):
            assert np.array_equal(found[f"{layer.name}.{part}"], getattr(layer, part))
    poses = [clip.skeleton.pose(f) for f in clip.frames]
    assert np.array_equal(found["skeleton.rotations"], [r for r, _ in poses])
    assert np.array_equal(found["skeleton.translation"], [t for _, t in poses])
    assert found["skeleton.names"].tolist() == list(clip.skeleton.names)


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_sequences_keep_order_and_are_numbered_as_the_frames(clip, kind, tmp_path):
    write(clip, tmp_path / "out", kind)
    for layer in clip.layers:
        files = sorted((tmp_path / "out" / layer.name).iterdir())
        assert [p.name for p in files] == [f"{n:06d}.{kind}" for n in clip.frames]
        for path, frame in zip(files, clip.frames):
            mesh = trimesh.load(path, process=False, maintain_order=True)
            assert np.abs(mesh.vertices - layer.at(frame)).max() < NEAR
            assert np.array_equal(mesh.faces, layer.faces)


# USD ----------------------------------------------------------------------------------------------------------------------


def open_usd(path):
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdSkel, UsdValidation  # noqa: F401

    return pxr, pxr.Usd.Stage.Open(str(path))


def usd_name(layer):
    return layer.name.replace("-", "_")


@pytest.mark.parametrize("ending", ["usdc", "usda"])
def test_usd_holds_every_frame_at_its_number(clip, ending, tmp_path):
    write(clip, tmp_path / f"clip.{ending}")
    pxr, stage = open_usd(tmp_path / f"clip.{ending}")
    assert pxr.UsdGeom.GetStageMetersPerUnit(stage) == 1 and pxr.UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == clip.fps
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 7)
    for layer in clip.layers:
        mesh = pxr.UsdGeom.Mesh(stage.GetPrimAtPath(f"/clip/{usd_name(layer)}"))
        assert mesh.GetPointsAttr().GetTimeSamples() == list(clip.frames)
        for frame in clip.frames:
            V = np.array(mesh.GetPointsAttr().Get(frame))
            assert np.abs(V - layer.at(frame)).max() < NEAR
            assert np.allclose(mesh.GetExtentAttr().Get(frame), [V.min(0), V.max(0)])
        assert np.array_equal(np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3)), layer.faces)
        st = pxr.UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        assert np.allclose(np.array(st.ComputeFlattened()).reshape(-1, 3, 2), layer.uv[layer.face_uv], atol=1e-7)


def test_usds_skeleton_moves_the_rest_surfaces_as_ours_does(tmp_path):
    clip = bending_clip(loose=0.003)
    notes = write(clip, tmp_path / "clip.usda", motion="skeleton")
    pxr, stage = open_usd(tmp_path / "clip.usda")
    assert [note.split(",")[0] for note in notes] == ["inner", "t-shirt"]
    root = pxr.UsdSkel.Root(stage.GetPrimAtPath("/clip"))
    names = stage.GetPrimAtPath("/clip/skeleton").GetAttribute("jointNames").Get()
    assert tuple(names) == clip.skeleton.names
    assert pxr.UsdSkel.BakeSkinning(root, pxr.Gf.Interval(3, 7))
    for layer in clip.layers:
        mesh, (rest, off) = pxr.UsdGeom.Mesh(stage.GetPrimAtPath(f"/clip/{usd_name(layer)}")), rest_surface(clip, layer)
        assert 0.001 < np.median(off) < 0.01
        for frame in clip.frames:
            ours = blend_skinning(rest, clip.skeleton.J, *clip.skeleton.posed(frame), layer.joints, layer.weights)
            assert np.abs(np.array(mesh.GetPointsAttr().Get(frame)) - ours).max() < 2 * NEAR


@pytest.mark.parametrize("motion", MOTIONS)
def test_usd_is_found_sound_by_its_own_validators(textured, motion, tmp_path):
    write(textured, tmp_path / "clip.usdc", motion=motion)
    pxr, stage = open_usd(tmp_path / "clip.usdc")
    validators = pxr.UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    found = pxr.UsdValidation.ValidationContext(validators).Validate(stage)
    assert [(error.GetName(), error.GetMessage()) for error in found] == []


def test_usd_finds_its_textures_beside_it_wherever_it_is_moved(textured, tmp_path):
    (tmp_path / "made").mkdir()
    write(textured, tmp_path / "made" / "clip.usdc")
    shutil.move(tmp_path / "made", tmp_path / "moved")
    _, stage = open_usd(tmp_path / "moved" / "clip.usdc")
    file = stage.GetPrimAtPath("/clip/t_shirt_material/texture").GetAttribute("inputs:file").Get()
    assert file.resolvedPath and Image.open(file.resolvedPath).size == (8, 8)


def test_usd_files_of_one_name_and_two_endings_share_pictures_that_are_the_same_and_no_others(textured, tmp_path):
    for name in ("clip.usdc", "clip.usda", "clip.usda"):
        write(textured, tmp_path / name)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    other = tmp_path / "other" / "t-shirt.png"
    other.parent.mkdir()
    Image.new("RGB", (8, 8), (10, 200, 10)).save(other)
    green = with_textures(textured, other.parent)
    with pytest.raises(
        UserError, match=r"clip\.usda: clip\.usdc has another clip_textures/t-shirt\.png: give this one another name"
    ):
        write(green, tmp_path / "clip.usda")
    assert all(path.read_bytes() == bytes_then for path, bytes_then in before.items())
    (tmp_path / "clip.usdc").unlink()
    write(green, tmp_path / "clip.usda")
    assert (tmp_path / "clip_textures" / "t-shirt.png").read_bytes() == other.read_bytes()


def test_layers_and_joints_whose_names_usd_spells_alike_stay_apart(clip, tmp_path):
    names = ("t-shirt", "t_shirt", "skeleton", "t_shirt_material", "2nd", "3nd")
    shift = lambda k: lambda frame: clip.layers[0].at(frame) + [0, 0, k]
    layers = tuple(replace(clip.layers[0], name=name, at=shift(k)) for k, name in enumerate(names))
    count = len(clip.skeleton.names)
    skeleton = replace(
        clip.skeleton, names=("hip", *("arm.L", "arm-L") * count)[:count], parents=(-1, *[0] * (count - 1))
    )
    write(replace(clip, layers=layers, skeleton=skeleton), tmp_path / "clip.usda")
    pxr, stage = open_usd(tmp_path / "clip.usda")
    meshes = [pxr.UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(pxr.UsdGeom.Mesh)]
    assert len(meshes) == len(names)
    for mesh, layer in zip(meshes, layers):
        assert np.abs(np.array(mesh.GetPointsAttr().Get(4)) - layer.at(4)).max() < NEAR
    joints = stage.GetPrimAtPath("/clip/skeleton").GetAttribute("joints").Get()
    assert len(set(joints)) == count > 2


def test_an_x_axis_that_points_upwards_is_turned_in_usd(tmp_path):
    clip = bending_clip(up="x")
    write(clip, tmp_path / "clip.usda")
    pxr, stage = open_usd(tmp_path / "clip.usda")
    V = np.array(pxr.UsdGeom.Mesh(stage.GetPrimAtPath("/clip/inner")).GetPointsAttr().Get(4))
    assert pxr.UsdGeom.GetStageUpAxis(stage) == "Y"
    assert np.abs(V[:, 1] - clip.layers[0].at(4)[:, 0]).max() < NEAR


# glTF ---------------------------------------------------------------------------------------------------------------------


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


# BVH and Alembic ------------------------------------------------------------------------------------------------------------


def test_bvh_holds_the_pose_and_fills_gaps(clip, tmp_path):
    notes = write(clip, tmp_path / "clip.bvh")
    found = read_bvh(tmp_path / "clip.bvh")
    assert found.names == clip.skeleton.names and found.parents == clip.skeleton.parents
    assert found.frame_time == pytest.approx(1 / 25, abs=1e-8) and notes == [
        "1 missing frames hold the pose before them: BVH knows no gaps"
    ]
    skeleton = clip.with_y_up().skeleton
    for row, frame in enumerate([3, 4, 5, 5, 7]):
        R, x = joint_transforms(skeleton.parents, skeleton.J, *skeleton.pose(frame))
        assert np.abs(found.rotations[row] - R).max() < NEAR and np.abs(found.places[row] - x).max() < NEAR
    assert np.abs(found.offsets[1:] - skeleton.offsets[1:]).max() < NEAR


BLENDER = shutil.which("blender")
IN_BLENDER = """
import json, sys
import bpy
path, first, last = sys.argv[-3], int(sys.argv[-2]), int(sys.argv[-1])
bpy.context.scene.render.fps = 25
for thing in list(bpy.data.objects): bpy.data.objects.remove(thing)
if path.endswith(".abc"): bpy.ops.wm.alembic_import(filepath=path)
else: bpy.ops.import_anim.bvh(filepath=path)
out = []
for frame in range(first, last + 1):
    bpy.context.scene.frame_set(frame)
    graph, found = bpy.context.evaluated_depsgraph_get(), {}
    for thing in bpy.data.objects:
        thing = thing.evaluated_get(graph)
        if thing.type == "MESH": found[thing.data.name] = [list(thing.matrix_world @ v.co) for v in thing.data.vertices]
        if thing.type == "ARMATURE": found |= {b.name: list(thing.matrix_world @ b.head) for b in thing.pose.bones}
    out.append(found)
print("FOUND" + json.dumps(out))
"""


def in_blender(folder, path, first, last):
    if BLENDER is None:
        pytest.skip("blender is not installed")
    (folder / "ask.py").write_text(IN_BLENDER)
    command = [BLENDER, "--background", "--python", str(folder / "ask.py"), "--", str(path), str(first), str(last)]
    done = subprocess.run(command, capture_output=True, text=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("FOUND"))
    return json.loads(line.removeprefix("FOUND"))


def test_blender_reads_the_alembic_that_it_was_asked_for(clip, tmp_path):
    if BLENDER is None:
        pytest.skip("blender is not installed")
    clip = replace(clip, frames=(3, 4, 5))
    write(clip, tmp_path / "clip.abc")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clip.abc"]
    for frame, meshes in zip((3, 4, 5), in_blender(tmp_path, tmp_path / "clip.abc", 3, 5)):
        assert len(meshes) == 2
        for layer in clip.layers:
            V = next(V for name, V in meshes.items() if usd_name(layer) in name)
            assert np.abs(np.array(V) - layer.at(frame)).max() < NEAR


def test_blender_reads_the_bvh(clip, tmp_path):
    clip = replace(clip, frames=(3, 4, 5))
    write(clip, tmp_path / "clip.bvh")
    for frame, bones in zip((3, 4, 5), in_blender(tmp_path, tmp_path / "clip.bvh", 1, 3)):
        _, x = clip.skeleton.posed(frame)
        for k, name in enumerate(clip.skeleton.names):
            assert np.abs(np.array(bones[name]) - x[k]).max() < 3 * NEAR


def test_rerun_reads_its_recording(clip, tmp_path):
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    write(clip, tmp_path / "clip.rrd")
    found = {}
    for chunk in RrdReader(tmp_path / "clip.rrd").stream().to_chunks():
        rows = chunk.to_record_batch()
        for name in {"frame", "Mesh3D:triangle_indices", "Mesh3D:vertex_positions"} & set(rows.schema.names):
            found.setdefault((chunk.entity_path, name), []).extend(rows.column(name).to_pylist())
    for layer in clip.layers:
        entity = f"/{layer.name}"
        assert tuple(found[entity, "frame"]) == clip.frames
        assert np.array_equal(found[entity, "Mesh3D:triangle_indices"][0], layer.faces)
        for V, frame in zip(found[entity, "Mesh3D:vertex_positions"], clip.frames):
            assert np.abs(np.array(V) - layer.at(frame)).max() < NEAR


# refusals -----------------------------------------------------------------------------------------------------------------


def test_formats_are_those_of_the_endings(tmp_path):
    assert format_of(tmp_path / "a.usda", None) == "usd" and format_of(tmp_path / "a", "ply") == "ply"
    for name, kind, said in (
        ("a", None, "--format: expected one of usd, glb"),
        ("a.fbx", None, "--format: expected one of"),
        ("a.glb", "usd", "--format usd: expected a file that ends in .usdc or .usda or .usd"),
        ("a.glb", "obj", "--format obj is a folder of numbered files, .glb is glb"),
        ("a.glb", "fbx", "--format fbx: expected one of"),
    ):
        with pytest.raises(UserError, match=said):
            format_of(tmp_path / name, kind)


def test_what_is_not_there_is_refused_by_name(clip, tmp_path):
    with pytest.raises(UserError, match="--layers hat: there are inner, t-shirt"):
        with_layers(clip, ["inner", "hat"])
    with pytest.raises(UserError, match=r"--frames 6: it failed or is not in bend \(4 frames from 3 to 7\)"):
        with_frames(clip, [3, 6])
    with pytest.raises(UserError, match="expected a folder with some of inner.png, t-shirt.png"):
        with_textures(clip, tmp_path)
    bare = replace(clip, skeleton=None)
    with pytest.raises(UserError, match="--motion skeleton: bend has no skeleton"):
        write(bare, tmp_path / "clip.glb", motion="skeleton")
    with pytest.raises(UserError, match="--motion skeleton: --format obj holds none: usd and glb do"):
        write(clip, tmp_path / "out", "obj", "skeleton")
    with pytest.raises(UserError, match="--format bvh: bend has no skeleton"):
        write(bare, tmp_path / "clip.bvh")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(clip, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    with pytest.raises(UserError, match="exists already and is not empty"):
        write(clip, tmp_path / "out", "ply")
    assert [p.name for p in tmp_path.rglob("*")] == ["out", "mine"]


@pytest.mark.parametrize("name", ["a.usdc", "a.glb", "a.npz", "out"])
def test_nothing_half_written_is_left(clip, name, tmp_path):
    """The third frame cannot be read: what was there before stays, and nothing else."""

    def broken(frame):
        if frame == 5:
            raise UserError("its chunk is missing")
        return clip.layers[1].at(frame)

    if name != "out":
        (tmp_path / name).write_text("before")
    bad = replace(clip, layers=(clip.layers[0], replace(clip.layers[1], at=broken)), skeleton=None)
    with pytest.raises(UserError, match="its chunk is missing"):
        write(bad, tmp_path / name, "ply" if name == "out" else None)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == ([] if name == "out" else [(name, "before")])


@pytest.mark.parametrize("name", ["a.usdc", "a.usda", "a.glb", "a.npz", "a.bvh", "out"])
def test_a_full_disk_is_told_by_the_name_that_was_asked_for(clip, name, tmp_path):
    with largest_file(300), pytest.raises((UserError, OSError)) as raised:
        write(clip, tmp_path / name, "ply" if name == "out" else None)
    line = first_line(raised.value)
    assert line.startswith(f"{tmp_path / name}") and line.endswith("File too large") and ".part" not in line
    assert list(tmp_path.iterdir()) == []


def test_a_file_stands_under_its_name_only_once_it_is_whole(tmp_path):
    with whole_file(tmp_path / "a.bin") as part:
        part.write_text("whole")
        assert not (tmp_path / "a.bin").exists()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.bin", "whole")]


def test_coordinates_that_single_precision_coarsens_are_told(clip, tmp_path):
    far = replace(clip.layers[0], at=lambda frame: clip.layers[0].at(frame) + [40.0, 0, 0])
    notes = write(replace(clip, layers=(far,), skeleton=None), tmp_path / "a.usdc")
    assert notes == ["coordinates of up to 40 m: single precision rounds them by 2 micrometres"]
    assert write(replace(clip, layers=(far,), skeleton=None), tmp_path / "a.npz") == []
