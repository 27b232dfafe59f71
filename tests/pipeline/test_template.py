"""`toile template`: a garment cut from a run, whatever body model the run has and wherever the command is given."""

import json
import shutil

import numpy as np
import pytest
import zarr

from toile import cli
from toile.io.body import PACKAGED
from toile.io.layout import DOUBTFUL, GOOD, WRONG
from toile.io.mesh import read_mesh
from toile.io.run import open_run
from toile.kernels import boundary_loops


@pytest.fixture
def own_model(sample_run, tmp_path):
    """The registered frames as if the capture had brought its body model along."""
    run = shutil.copytree(sample_run, tmp_path / "run")
    capture = shutil.copytree(
        open_run(sample_run).capture.root, tmp_path / "capture", ignore=shutil.ignore_patterns("frames", "truth")
    )
    shutil.copy(PACKAGED["anny"], capture / "person.npz")
    zarr.open_group(str(run / "registered.zarr"), mode="r+").attrs["body_model"] = "person.npz"
    (run / "config.toml").write_text(f"capture = {json.dumps(str(capture))}\n")
    return run


def command(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["toile", "template", *map(str, words)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return stopped.value.code


def test_a_run_with_a_body_model_of_its_own_gives_the_same_template(
    own_model, sample_run, tmp_path, monkeypatch, capsys
):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for run, out in ((own_model, "own.obj"), (sample_run, "packaged.obj")):
        assert command(monkeypatch, run, out, "--name", "tshirt", "--label", "tshirt") == 0, capsys.readouterr().err
    own, packaged = read_mesh("own.obj"), read_mesh("packaged.obj")
    assert np.array_equal(own.vertices, packaged.vertices) and np.array_equal(own.faces, packaged.faces)
    assert own.uv is not None and len(boundary_loops(own.faces)) >= 3
    assert f"tshirt from {own_model}" in capsys.readouterr().out


def test_what_is_made_of_frames_that_are_judged_wrong_says_so(own_model, tmp_path, monkeypatch, capsys):
    zarr.open_group(str(own_model / "registered.zarr"), mode="r+")["verdict"][:] = [WRONG, DOUBTFUL, WRONG, GOOD]
    said = "of 4 frames 2 wrong and 1 doubtful: see toile report"
    assert command(monkeypatch, own_model, tmp_path / "t.obj", "--name", "tshirt", "--label", "tshirt") == 0
    assert said in capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["toile", "export", str(own_model), str(tmp_path / "clip.npz")])
    with pytest.raises(SystemExit):
        cli.main()
    assert said in capsys.readouterr().err and (tmp_path / "clip.npz").exists()


def test_an_unknown_label_is_refused_by_name(sample_run, tmp_path, monkeypatch, capsys):
    assert command(monkeypatch, sample_run, tmp_path / "t.obj", "--name", "coat", "--label", "coat") == 1
    assert "--label coat: the run knows" in capsys.readouterr().err and not (tmp_path / "t.obj").exists()
