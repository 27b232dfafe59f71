"""What `toile animate` leaves, read again."""

import json

import numpy as np
import pytest

from tests.support.bending_clip import bending_clip, write_animation
from toile.errors import UserError
from toile.io.animation import mesh_file, open_animation, skeleton_file


@pytest.fixture
def folder(tmp_path):
    write_animation(bending_clip(), tmp_path)
    return tmp_path


def test_an_animation_is_read_as_it_was_written(folder):
    clip, found = bending_clip(), open_animation(folder)
    assert (found.fps, found.up, found.frames) == (clip.fps, clip.up, clip.frames)
    assert found.skeleton.names == clip.skeleton.names and found.skeleton.parents == clip.skeleton.parents
    for frame in clip.frames:
        for a, b in zip(found.skeleton.pose(frame), clip.skeleton.pose(frame)):
            assert np.array_equal(a, b)
        for ours, theirs in zip(found.layers, clip.layers):
            assert np.abs(ours.at(frame) - theirs.at(frame)).max() < 1e-6
    for ours, theirs in zip(found.layers, clip.layers):
        assert ours.name == theirs.name and ours.texture.exists()
        for part in ("faces", "uv", "face_uv", "joints", "weights"):
            assert np.array_equal(getattr(ours, part), getattr(theirs, part))


def test_what_is_missing_or_strange_is_refused_by_name(folder):
    facts = folder / "animation.json"
    facts.write_text(json.dumps({"layers": ["../../etc"]}))
    with pytest.raises(UserError, match="animation.json: layers: expected names"):
        open_animation(folder)
    facts.write_text(json.dumps({"layers": ["inner"]}))
    mesh_file(folder, "inner", 4).write_bytes(mesh_file(folder, "inner", 4).read_bytes()[:200])
    with pytest.raises(UserError, match="inner/000004.ply"):
        open_animation(folder).layers[0].at(4)
    skeleton_file(folder).unlink()
    with pytest.raises(UserError, match="the animation is of an older version, animate it again"):
        open_animation(folder)
    (folder / "meshes").rename(folder / "gone")
    with pytest.raises(UserError, match="made with --no-meshes"):
        open_animation(folder)
