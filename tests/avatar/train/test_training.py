"""Training on a registered run: what it reaches, what it reads, and what it refuses."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, default_collate

from toile.avatar.model.assets import read_assets
from toile.avatar.model.checkpoint import load_avatar, read_facts
from toile.avatar.settings import DataSettings, NetworkSettings, preset
from toile.avatar.train.data import AvatarData
from toile.avatar.train.make import Request, make_avatar
from toile.avatar.train.training import reading
from toile.cli import main
from toile.errors import UserError
from toile.io.run import open_run

STEPS = dict(body_steps=60, garment_steps=100, joint_steps=50, joint_rate=1.0)
SMALL = dict(
    data=DataSettings(geometry_size=64, texture_size=64, image=(128, 128)),
    network=NetworkSettings(latent=8, width=16, least_width=4, ao_rays=4, ao_size=32),
    batch=2, joint_batch=1, checkpoint_every=20, picture_every=1000,
)  # fmt: skip


def chosen(**changes):
    return preset("draft").model_copy(update=SMALL | changes)


def request(run, settings, **options):
    return Request(run, settings, say=lambda message: None, **options)


def losses(folder):
    return [json.loads(line) for line in (folder / "losses.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def trained(sample_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained") / "avatar"
    make_avatar(request(sample_run, chosen(**STEPS)), folder)
    return folder


@pytest.mark.parametrize(
    "phase, term, stated",
    [
        ("body", "geometry", 0.025),  # [cm^2]; 0.037 untrained
        ("body", "texture", 0.0003),  # 0.0004
        ("garment", "geometry", 0.04),  # 0.066
        ("garment", "texture", 0.00015),  # 0.0002
        ("garment", "kl", 60.0),
        ("joint", "image", 0.031),  # 0.036
        ("joint", "mask", 0.005),
        ("joint", "laplacian", 0.005),
    ],
)
def test_small_training_reaches_the_stated_losses(phase, term, stated, trained):
    """Means over the last ten of few steps."""
    values = [line[term] for line in losses(trained) if line["phase"] == phase]
    assert np.mean(values[-10:]) < stated


def test_holdout_is_never_read(sample_run, tmp_path):
    """A hold-out of noise and NaN changes no bit of the losses, nor of the mean textures."""
    import zarr

    folder = tmp_path / "poisoned"
    run = Path(shutil.copytree(sample_run, folder / "run"))
    config = (run / "config.toml").read_text().splitlines()
    capture = Path(json.loads(config[0].removeprefix("capture = ")))
    capture = Path(shutil.copytree(capture, folder / "capture", ignore=shutil.ignore_patterns("truth")))
    (run / "config.toml").write_text("\n".join([f"capture = {json.dumps(str(capture))}", *config[1:]]))
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    for name in ("inner/vertices", "track/vertices", "garment/tshirt/vertices", "pose/rotations", "pose/translation"):
        store[name][3] = np.nan
        store[name][3, 0] = 0  # a frame of nothing but NaN has lost its chunk, and is refused
    for path in (capture / "frames" / "000003").rglob("*.*"):
        path.write_bytes(b"poison")
    settings = chosen(body_steps=1, garment_steps=1, joint_steps=2)
    for source, name in ((sample_run, "clean"), (run, "spoiled")):
        make_avatar(request(source, settings, holdout="3"), tmp_path / name)
    assert losses(tmp_path / "clean") == losses(tmp_path / "spoiled")
    assert read_facts(tmp_path / "clean")["holdout"] == [3] and read_facts(tmp_path / "clean")["frames"] == [0, 1, 2]
    clean, spoiled = (load_avatar(tmp_path / name).state_dict() for name in ("clean", "spoiled"))
    assert all(torch.equal(clean[name], spoiled[name]) for name in clean)


@pytest.mark.slow(seconds=240)
def test_killed_processes_go_on_to_the_bit(sample_run, tmp_path):
    """SIGKILL in each phase: losses and weights are those of an undisturbed run."""

    def start(folder):
        arguments = ["train", sample_run, folder, "--quality", "draft", "--steps", "4,4,8"]
        return subprocess.Popen([sys.executable, "-c", "from toile.cli import main; main()", *map(str, arguments)])

    def taken(folder):
        return (folder / "losses.jsonl").read_bytes().count(b"\n") if (folder / "losses.jsonl").exists() else 0

    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert start(whole).wait() == 0
    for lines in (2, 7, 12):
        process = start(killed)
        while process.poll() is None and taken(killed) < lines:
            time.sleep(0.05)
        process.kill()
        assert process.wait() != 0
    assert start(killed).wait() == 0
    for name in ("losses.jsonl", "avatar.safetensors"):
        assert (whole / name).read_bytes() == (killed / name).read_bytes()


@pytest.mark.slow(seconds=40)
def test_two_processes_of_torchrun_learn_as_one_of_twice_the_batch(sample_run, tmp_path):
    """The body alone: of what has codes, each process draws its own noise. Means are weighted within a process."""
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--no-python"]
    small = ["--set", "data.texture_size=64", "--set", "data.image=[64,64]", "--set", "network.width=16"]
    for name, before, pictures in (("one", [], 4), ("two", torchrun, 2)):
        command = [sys.executable, "-c", "from toile.cli import main; main()", "train", sample_run, tmp_path / name]
        options = ["--quality", "draft", "--steps", "6,0,0", "--no-align", "--set", f"batch={pictures}", *small]
        subprocess.run([*before, *map(str, command), *options], check=True)
    one, two = ([line["loss"] for line in losses(tmp_path / name)] for name in ("one", "two"))
    assert len(one) == 6 and one[-1] < one[0]
    assert two == pytest.approx(one, rel=0.01)


def test_samples_that_processes_read_are_those_read_here(sample_run, tmp_path):
    """As for a GPU."""
    data = AvatarData(sample_run, chosen().data, tmp_path)
    order = [[0, 3], [5, 1], [2, 2]]
    loader = DataLoader(data, batch_sampler=order, num_workers=2, multiprocessing_context=reading())
    for numbers, found in zip(order, loader, strict=True):
        expected = default_collate([data[i] for i in numbers])
        assert found.keys() == expected.keys()
        assert all(torch.equal(found[name], value) for name, value in expected.items())


def test_loaded_avatar_is_the_trained_one(trained):
    avatar, facts = load_avatar(trained), read_facts(trained)
    assert facts["steps"] == {"body": 60, "garment": 100, "joint": 50}
    assert facts["architecture"] == json.loads(json.dumps(avatar.describe()))
    assert not any(p.suffix in (".pt", ".pth", ".pkl", ".ckpt") for p in trained.rglob("*"))
    assert list((trained / "logs").glob("events.*"))


def test_another_run_or_setting_is_refused(trained, sample_run, tmp_path):
    with pytest.raises(UserError, match="settings.seed: holds 0, asked is 1"):
        make_avatar(request(sample_run, chosen(seed=1, **STEPS)), trained)
    with pytest.raises(UserError, match="(frames|holdout): .*asked are frames .* too: take another folder"):
        make_avatar(request(sample_run, chosen(**STEPS), holdout="1"), trained)


def test_a_run_elsewhere_is_taken_for_the_same_until_its_registration_is_another(trained, sample_run, tmp_path):
    import zarr

    folder, other = (Path(shutil.copytree(one, tmp_path / one.name)) for one in (trained, Path(sample_run)))
    make_avatar(request(other, chosen(**STEPS)), folder)
    assert read_facts(folder)["run"] == str(other.resolve())
    store = zarr.open_group(str(other / "registered.zarr"), mode="r+")
    store["garment/tshirt/vertices"][:] = store["garment/tshirt/vertices"][:] + 1e-3
    with pytest.raises(UserError, match="avatar.json: registration: it was trained with another one"):
        make_avatar(request(other, chosen(**STEPS)), folder)


def test_pictures_that_changed_since_a_training_began_are_told_until_it_is_begun_elsewhere(sample_run, tmp_path):
    capture = shutil.copytree(open_run(sample_run).capture.root, tmp_path / "capture")
    run = shutil.copytree(sample_run, tmp_path / "run")
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(config.replace(str(open_run(sample_run).capture.root), str(capture)))
    told = []
    few = request(run, chosen(body_steps=1, garment_steps=1, joint_steps=1), holdout="1-3", warn=told.append)
    make_avatar(few, tmp_path / "avatar")
    make_avatar(few, tmp_path / "avatar")
    assert not told
    picture = next((capture / "frames" / "000000" / "images").iterdir())
    os.utime(picture, ns=(0, 0))
    for _ in range(2):
        make_avatar(few, tmp_path / "avatar")
        assert told.pop().startswith(f"{capture}: pictures, masks or labels have other sizes or times than when ")
    make_avatar(few, tmp_path / "another")
    assert not told


def test_a_trained_avatar_takes_the_options_that_it_was_trained_with(
    trained, sample_run, tmp_path, monkeypatch, capsys
):
    """`--temporal` afterwards, without repeating quality, steps and hold-out."""
    folder = Path(shutil.copytree(trained, tmp_path / "avatar"))
    code, err = command(monkeypatch, capsys, "train", sample_run, folder, "--temporal", "--set", "temporal.steps=20")
    assert code in (0, None), err
    assert (folder / "temporal.safetensors").exists() and (folder / "cloth.tshirt.npz").exists()
    assert read_facts(folder)["settings"] == read_facts(trained)["settings"]


def test_baseline_under_the_same_conditions(sample_avatar):
    layered, baseline = read_facts(sample_avatar), read_facts(sample_avatar / "baseline")
    assert baseline["steps"]["surface"] == layered["steps"]["body"] + layered["steps"]["garment"]
    assert baseline["steps"]["joint"] == layered["steps"]["joint"]
    layers = read_assets(sample_avatar, read_facts(sample_avatar))["layers"]
    own = {"modes": len(layers[1].modes), "texture_size": 128}  # a shirt is an eighth of the body's chart
    assert baseline["settings"].data == layered["settings"].data.model_copy(update=own)
    for same in ("frames", "holdout", "run", "scene"):
        assert baseline[same] == layered[same]
    parameters = [facts["architecture"]["parameters"] for facts in (layered, baseline)]
    assert abs(parameters[1] / parameters[0] - 1) <= 0.1
    assert len(baseline["searched"]) == len(layered["settings"].baseline_lr)
    assert {"impute", "image", "mask"} <= losses(sample_avatar / "baseline")[-1].keys()


def command(monkeypatch, capsys, *arguments):
    """(exit code, stderr) of a toile command."""
    monkeypatch.setattr("sys.argv", ["toile", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code, capsys.readouterr().err


def test_bad_input_is_one_line_and_exit_code_1(sample_run, tmp_path, monkeypatch, capsys):
    for arguments, message in (
        ((tmp_path / "no", tmp_path / "a"), "no such folder"),
        ((sample_run, tmp_path / "a", "--quality", "rough"), "--quality rough"),
        ((sample_run, tmp_path / "a", "--holdout", "9-8"), "--holdout 9-8"),
        ((sample_run, tmp_path / "a", "--holdout", "0-3"), "leaves no pictured frame"),
        ((sample_run, tmp_path / "a", "--minutes", "-1"), "--minutes -1"),
    ):
        code, err = command(monkeypatch, capsys, "train", *arguments)
        assert code == 1 and message in err and err.strip().count("\n") == 0
