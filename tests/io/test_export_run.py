"""`toile export` on a run."""

import numpy as np
import pytest
import trimesh
import zarr
from typer.testing import CliRunner

from tests.support.synthetic_run import copy_capture, true_run
from toile.io.command import export
from toile.io.run import open_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Six frames, of which the third failed."""
    folder = tmp_path_factory.mktemp("exported")
    run = true_run(copy_capture(folder), folder)
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store["done"][2] = 2
    return run


@pytest.fixture(scope="module")
def ask():
    from typer import Typer

    app = Typer()
    app.command()(export)
    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])


def test_the_body_and_the_garments_of_registered_frames_are_handed_on(run, ask, tmp_path):
    done = ask(run, tmp_path / "out", "--format", "ply")
    assert done.exit_code == 0, done.output
    opened = open_run(run)
    assert opened.ok == [0, 1, 3, 4, 5]
    for layer in (opened.inner, opened.garments["tshirt"]):
        files = sorted((tmp_path / "out" / layer.name).iterdir())
        assert [p.name for p in files] == [f"{n:06d}.ply" for n in (0, 1, 3, 4, 5)]
        mesh = trimesh.load(files[2], process=False)
        assert np.abs(mesh.vertices - layer.at(3)).max() < 1e-6 and np.array_equal(mesh.faces, layer.faces)
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_frames_that_failed_are_named_where_they_were_asked_for(run, ask, tmp_path):
    words = "warning: {}: 1 frames failed or are not registered, and are left out: 2"
    for frames in ((), ("--frames", "1-3")):
        assert words.format(run) in " ".join(ask(run, tmp_path / "out.npz", *frames).output.split())
    assert "left out" not in ask(run, tmp_path / "out.npz", "--frames", "3-5").output


def test_layers_and_frames_are_those_asked_for(run, ask, tmp_path):
    done = ask(run, tmp_path / "out.npz", "--layers", "tshirt,track", "--frames", "1-3")
    assert done.exit_code == 0, done.output
    found = np.load(tmp_path / "out.npz")
    assert found["frames"].tolist() == [1, 3]
    assert {name.split(".")[0] for name in found.files} == {"tshirt", "track", "skeleton", "frames", "fps", "up"}
    assert np.array_equal(found["track.vertices"][1], open_run(run).track.at(3))


@pytest.mark.parametrize(
    "words, said",
    [
        (("out.npz", "--frames", "2"), "--frames 2: it failed or is not in"),
        (("out.npz", "--layers", "trousers"), "--layers trousers: there are track, inner, tshirt"),
        (("out.glb", "--format", "npz"), "--format npz: expected a file that ends in .npz"),
        (("out.glb", "--motion", "bones"), "--motion bones: expected points or skeleton"),
        (("out.bvh", "--layers", "tshirt"), "--layers: --format bvh holds the skeleton alone"),
        (("out.bvh", "--motion", "points"), "--motion points: --format bvh holds the skeleton alone"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_name(run, ask, tmp_path, words, said):
    done = ask(run, tmp_path / words[0], *words[1:])
    assert said in str(done.exception) and list(tmp_path.iterdir()) == []
