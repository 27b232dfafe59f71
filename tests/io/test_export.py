"""Clips written for other programs, read back by libraries and programs that are not ours."""

import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.support.exported import NEAR, usd_name, write
from tests.support.small_disk import largest_file
from toile.errors import UserError, first_line
from toile.io.bvh import read_bvh
from toile.io.export.source import with_frames, with_layers, with_textures
from toile.io.export.writing import format_of, whole_file
from toile.kinematics import joint_transforms

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
