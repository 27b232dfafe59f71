"""Clips written as USD, read back by its own library."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.support.bending_clip import bending_clip
from tests.support.exported import NEAR, usd_name, write
from toile.errors import UserError
from toile.io.export.clip import rest_surface
from toile.io.export.source import with_textures
from toile.io.export.writing import MOTIONS
from toile.kinematics import blend_skinning


def open_usd(path):
    pxr = pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdSkel, UsdValidation  # noqa: F401

    return pxr, pxr.Usd.Stage.Open(str(path))


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
