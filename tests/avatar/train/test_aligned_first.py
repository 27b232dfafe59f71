"""`toile train` and runs whose prints do not lie still yet: what is aligned first, and what stays as it was asked for."""

import json
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import zarr

from toile.align.outcome import Alignment
from toile.avatar.command import laid_still
from toile.avatar.model.checkpoint import asked_before
from toile.errors import UserError
from toile.io.layout import FAILED
from toile.io.registration import registration
from toile.io.run import open_run

QUIET = lambda stage, done, total, note=None: None


@pytest.fixture
def aligning(monkeypatch):
    """Folders that were aligned, in the place of the alignment: it copies the run."""
    made = []

    def align(run, out, progress):
        progress("reference", 1, 1)
        made.append(Path(out))
        if not Path(out).exists():
            shutil.copytree(run, out)
            with (out / "config.toml").open("a") as file:
                file.write(f"\n[align]\nrun = {json.dumps(str(Path(run).resolve()))}\n")
                registered = open_run(run)
                digest = registration(registered, registered.ok, registered.garments.values())
                file.write(f"registration = {json.dumps(digest)}\n")
        return Alignment((0, 1, 2), (), {3: "no garment is seen"}, (), True, ("tshirt is torn",))

    monkeypatch.setattr("toile.align.run.align", align)
    return made


def asked(folder, run):
    """AVATAR/avatar.json of a training that was asked to learn `run`."""
    folder.mkdir(exist_ok=True)
    (folder / "avatar.json").write_text(json.dumps({"run": str(Path(run).resolve()), "settings": {}}))


def still(run, folder, wanted=None):
    return laid_still(open_run(run), folder, wanted, QUIET).path.resolve()


def test_a_new_avatar_learns_a_run_whose_prints_lie_still(sample_run, tmp_path, aligning):
    folder = tmp_path / "avatar"
    assert still(sample_run, folder) == folder / "aligned" == aligning[0]
    assert still(sample_run, folder) == folder / "aligned"  # a training that was stopped goes on with it
    assert still(sample_run, folder, wanted=False) == Path(sample_run).resolve()


def test_what_went_wrong_with_aligning_is_said(sample_run, tmp_path, aligning, capsys):
    still(sample_run, tmp_path / "avatar")
    said = capsys.readouterr().err
    assert "tshirt is torn" in said and "frame 3: no garment is seen" in said


def test_an_avatar_that_is_there_keeps_the_run_that_it_was_trained_on(sample_run, tmp_path, aligning):
    asked(tmp_path / "one", sample_run)
    assert still(sample_run, tmp_path / "one") == Path(sample_run).resolve() and not aligning
    registered = shutil.copytree(sample_run, tmp_path / "registered")
    store = zarr.open_group(str(registered / "registered.zarr"), mode="r+")
    store["done"][3], store["pose/rotations"][3], store["pose/translation"][3] = FAILED, np.nan, np.nan
    own = still(registered, tmp_path / "other")
    asked(tmp_path / "other", own)
    assert still(registered, tmp_path / "other") == still(own, tmp_path / "other") == own
    assert len(aligning) == 1  # what is whole is opened: another version would not align it the same
    moved = shutil.copytree(registered, tmp_path / "moved")
    assert still(moved, tmp_path / "other") == own
    another = shutil.copytree(sample_run, tmp_path / "another")
    poses = zarr.open_group(str(another / "registered.zarr"), mode="r+")["pose/rotations"]
    poses[:] = poses[:] + 0.01
    with pytest.raises(
        UserError, match="aligned: was aligned from .*registered, asked is .*another: take another folder"
    ):
        still(another, tmp_path / "other")


def test_a_copied_avatar_is_taught_on_from_its_own_aligned_run(sample_run, tmp_path, aligning):
    asked(tmp_path / "one", still(sample_run, tmp_path / "one"))
    asked(tmp_path / "one" / "baseline", tmp_path / "one" / "aligned")
    copy = Path(shutil.copytree(tmp_path / "one", tmp_path / "elsewhere" / "copy"))
    assert still(sample_run, copy) == copy / "aligned" and len(aligning) == 1
    assert asked_before(copy)["run"] == asked_before(copy / "baseline")["run"] == str(copy / "aligned")


def test_a_run_beside_a_copied_avatar_is_not_taken_for_its_own(sample_run, tmp_path):
    asked(tmp_path / "one", shutil.copytree(sample_run, tmp_path / "aligned"))
    copy = Path(shutil.copytree(tmp_path / "one", tmp_path / "elsewhere" / "copy"))
    shutil.copytree(sample_run, tmp_path / "elsewhere" / "aligned")
    assert asked_before(copy)["run"] == str(tmp_path / "aligned")


def test_what_was_learnt_as_it_is_is_not_aligned_in_vain(sample_run, tmp_path, aligning):
    asked(tmp_path / "one", sample_run)
    with pytest.raises(UserError, match="--align: .*one was trained on .* as it is: take another folder"):
        still(sample_run, tmp_path / "one", wanted=True)
    assert not aligning and not (tmp_path / "one" / "aligned").exists()


def test_an_avatar_does_not_go_on_with_what_was_aligned_of_an_older_registration(sample_run, tmp_path, aligning):
    run = Path(shutil.copytree(sample_run, tmp_path / "run"))
    own = still(run, tmp_path / "avatar")
    asked(tmp_path / "avatar", own)
    assert still(run, tmp_path / "avatar") == own
    shirt_of = lambda one: next(zarr.open_group(str(one / "registered.zarr"), mode="r+")["garment"].groups())[1][
        "vertices"
    ]
    slid = shirt_of(own)
    slid[1] = slid[1] + 0.01
    assert still(Path(shutil.copytree(own, tmp_path / "copy")), tmp_path / "avatar") == own
    shirt = shirt_of(run)
    shirt[0] = shirt[0] + 0.05
    with pytest.raises(
        UserError, match="aligned: was aligned from another registration than that of .*run: take another folder"
    ):
        still(run, tmp_path / "avatar")


def test_what_is_aligned_is_not_aligned_again(sample_run, tmp_path, aligning):
    aligned = Path(shutil.copytree(sample_run, tmp_path / "run"))
    with (aligned / "config.toml").open("a") as file:
        file.write('\n[align]\nrun = "elsewhere"\n')
    assert still(aligned, tmp_path / "avatar") == aligned.resolve() and not aligning
    assert still(aligned, tmp_path / "avatar", wanted=True) == tmp_path / "avatar" / "aligned"


def test_garments_slid_by_register_are_not_slid_again(sample_run, tmp_path, aligning):
    run = open_run(sample_run)
    scene = replace(run.capture.scene, garments=[replace(g, prints=True) for g in run.capture.scene.garments])
    slid = SimpleNamespace(path=run.path, garments=run.garments, config={}, capture=SimpleNamespace(scene=scene))
    assert laid_still(slid, tmp_path / "avatar", None, QUIET) is slid and not aligning


def test_several_processes_align_nothing(sample_run, tmp_path, aligning, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert still(sample_run, tmp_path / "avatar") == Path(sample_run).resolve() and not aligning
    with pytest.raises(UserError, match="--align: not by torchrun: toile align .* ALIGNED"):
        still(sample_run, tmp_path / "avatar", wanted=True)


def test_bad_requests_are_refused_before_anything_is_aligned(sample_run, tmp_path, aligning):
    from toile.avatar.settings import preset
    from toile.avatar.train.make import Request, make_avatar

    request = Request(sample_run, preset("draft"), holdout="0-3", still=partial(laid_still, asked=None, progress=QUIET))
    with pytest.raises(UserError, match="leaves no pictured frame"):
        make_avatar(request, tmp_path / "avatar")
    assert not aligning


@pytest.mark.slow(seconds=60)
def test_the_avatar_of_an_unaligned_run_is_that_of_its_aligned_one(sample_run, tmp_path, monkeypatch, capsys):
    """The command as it is typed, and the two steps by hand: the same losses."""
    from toile.cli import main

    def toile(*arguments):
        monkeypatch.setattr("sys.argv", ["toile", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code in (0, None), capsys.readouterr().err

    few = "--quality", "draft", "--steps", "1,1,2"
    toile("train", sample_run, tmp_path / "at once", *few)
    toile("align", sample_run, tmp_path / "aligned")
    toile("train", tmp_path / "aligned", tmp_path / "by hand", *few)
    losses = [(tmp_path / name / "losses.jsonl").read_text().splitlines() for name in ("at once", "by hand")]
    losses = [[{k: v for k, v in json.loads(line).items() if "second" not in k} for line in lines] for lines in losses]
    assert losses[0] == losses[1] and len(losses[0]) == 4
    assert open_run(tmp_path / "at once" / "aligned").ok == open_run(tmp_path / "aligned").ok
