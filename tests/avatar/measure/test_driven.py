"""`toile evaluate AVATAR --driven`: poses and faces alone show a frame, as an animation would."""

import json
import shutil

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from toile.avatar.drive.animate import DrivenAvatar
from toile.avatar.drive.driver import held_out_span
from toile.avatar.drive.teaching import train_temporal
from toile.avatar.measure.driven import Driven
from toile.avatar.measure.evaluation import evaluate_avatar
from toile.avatar.measure.report import write_avatar_report
from toile.avatar.model.avatar import Avatar
from toile.avatar.settings import TemporalSettings
from toile.cli import app
from toile.errors import UserError


@pytest.fixture(scope="module")
def folder(sample_avatar):
    driven = sample_avatar.parent / "evaluated"
    shutil.copytree(sample_avatar, driven)
    train_temporal(driven, TemporalSettings(window=2, channels=8, steps=20))
    return driven


@pytest.fixture(scope="module")
def held(folder):
    return Driven(folder, [1, 3])


def test_no_frame_is_encoded_and_none_of_its_pixels_read(held, monkeypatch):
    def encode(*_):
        raise AssertionError("a frame's own code")

    monkeypatch.setattr(Avatar, "encode", encode)
    sample = held.data["layered"][0]
    told = {"frame", "camera", "K", "T_camera_world"}
    blind = {key: value if key in told else torch.full_like(value, 7) for key, value in sample.items()}
    for name in held.shown:
        assert torch.equal(held._show(name, sample).image, held._show(name, blind).image)


def test_it_shows_what_an_animation_of_the_run_shows(held, folder, sample_run):
    for name, place in (("layered", folder), ("baseline", folder / "baseline")):
        driven = DrivenAvatar(place, sample_run)
        i, camera = list(driven.motion.frames).index(3), driven.avatar.cameras[0]
        decoded, _, _ = driven.decode(i, driven.batch(i, camera, 0))
        placed = held._placed(name, 3)
        for layer, one in decoded.items():
            assert np.abs(one.vertices[0].cpu().numpy() - placed[layer]).max() < 1e-5


def test_the_baseline_s_draws_differ_and_hold_over_the_sequence(held):
    names = [name for name in held.shown if name.startswith("baseline")]
    codes = [held.latents[name][n]["surface"] for name in names for n in (1, 3)]
    assert len(names) == 5 and all(torch.equal(a, b) for a, b in zip(codes[::2], codes[1::2]))
    assert len({tuple(z[0].tolist()) for z in codes}) == 5


def test_the_json_has_the_shape_of_the_reconstruction_s(folder):
    printed = CliRunner().invoke(app, ["evaluate", str(folder), "--frames", "1-3", "--driven", "--json"])
    assert printed.exit_code == 0, printed.output
    found, usual = json.loads(printed.stdout), evaluate_avatar(folder, [3], sheets=False)
    assert found["all"].keys() == usual["all"].keys() and usual["all"]["driven"] is None
    for name in ("layered", "baseline"):
        assert found["all"][name].keys() == usual["all"][name].keys() and found["all"][name]["silhouette_mse"] > 0
    driven = found["all"]["driven"]
    assert (
        driven["temporal"]["window"] == 2
        and driven["intersections"]["left"] == 0
        and driven["intersections"]["frames"] == 3
    )
    drawn = driven["baseline_draws"]["mse"]
    assert len(drawn) == 4 and drawn[0] == pytest.approx(found["all"]["baseline"]["mse"], rel=0.2)
    assert all(value > 0 for value in driven["motion"]["tshirt"].values())
    assert found["all"]["layered"]["geometry"]["garment"]["tshirt"]["surface_mm"] > 0
    page = write_avatar_report(folder, driven=True).read_text(encoding="utf-8")
    assert "driven by poses and face" in page and list((folder / "driven").glob("*.png"))


def test_an_avatar_that_nothing_drives_is_refused(sample_avatar):
    with pytest.raises(UserError, match="temporal.safetensors: the file is missing"):
        Driven(sample_avatar)


def test_a_run_is_not_driven(sample_run):
    printed = CliRunner().invoke(app, ["evaluate", str(sample_run), "--driven"])
    assert isinstance(printed.exception, UserError) and "--driven" in str(printed.exception)


def test_all_frames_between_held_out_pictures_are_held_out():
    assert list(held_out_span([60, 66, 72])) == list(range(60, 73)) and not held_out_span([])


def test_physics_shows_what_an_animation_by_physics_shows(folder, sample_run):
    printed = CliRunner().invoke(app, ["evaluate", str(folder), "--frames", "3", "--driven", "--physics", "--json"])
    assert printed.exit_code == 0, printed.output
    driven = json.loads(printed.stdout)["all"]["driven"]
    assert driven["intersections"]["left"] == 0
    assert driven["physics"]["strain"] > 0 and driven["physics"]["self_pairs"]["tshirt"] >= 0
    shown = Driven(folder, [3], physics=True)._placed("layered", 3)["tshirt"]
    hung = DrivenAvatar(folder, sample_run, physics=True)
    decoded, _, _ = hung.decode(3, hung.unseen(3))
    assert np.abs(decoded["tshirt"].vertices[0].cpu().numpy() - shown).max() < 1e-5
    assert np.abs(Driven(folder, [3])._placed("layered", 3)["tshirt"] - shown).mean() > 1e-4


def test_physics_without_a_driver_is_refused(folder):
    refused = CliRunner().invoke(app, ["evaluate", str(folder), "--physics"])
    assert isinstance(refused.exception, UserError)
    assert str(refused.exception) == "--physics: it drives an avatar: give --driven too"
