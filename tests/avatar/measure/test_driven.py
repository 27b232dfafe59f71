"""`toile evaluate AVATAR --driven`: poses and faces alone show a frame, as an animation would."""

import json
import shutil

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from toile.avatar.drive.animate import DrivenAvatar
from toile.avatar.drive.teaching import train_temporal
from toile.avatar.measure import driving_codes
from toile.avatar.measure.driven import Driven
from toile.avatar.measure.driving_codes import DRAWS, UNIT, like
from toile.avatar.measure.evaluation import evaluate_avatar
from toile.avatar.measure.report import write_avatar_report
from toile.avatar.model.avatar import Avatar
from toile.avatar.settings import TemporalSettings
from toile.cli import app
from toile.errors import UserError
from toile.io.holdout import kept_apart


@pytest.fixture(scope="module")
def folder(sample_avatar):
    driven = sample_avatar.parent / "evaluated"
    shutil.copytree(sample_avatar, driven)
    for place in (driven, driven / "baseline"):
        train_temporal(place, TemporalSettings(window=2, channels=8, steps=20))
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
    for name, place in (("layered", folder), ("temporal model", folder / "baseline")):
        driven = DrivenAvatar(place, sample_run)
        i, camera = list(driven.motion.frames).index(3), driven.avatar.cameras[0]
        decoded, *_ = driven.decode(i, driven.batch(i, camera, 0))
        placed = held._placed(name, 3)
        for layer, one in decoded.items():
            assert np.abs(one.vertices[0].cpu().numpy() - placed[layer]).max() < 1e-5


def test_an_opening_that_slipped_for_all_frames_is_measured_and_named(held, monkeypatch):
    run, avatar = held.registered.run, held.avatars["layered"]
    shirt, skin = run.garments["tshirt"], avatar.model("tshirt").skin
    moved = {3: np.array([0.02, 0, 0.03]), 1: np.array([0.04, 0, -0.01])}  # [m] about their mean (0.03, 0, 0.01)

    def placed(_, n):
        transforms = avatar.transforms(held._steered(n))
        V = skin.unpose(torch.as_tensor(shirt.at(n)).float()[None], *transforms)
        V[:, shirt.loops["hem"]] += torch.as_tensor(moved[n]).float()
        return {"tshirt": skin.pose(V, *transforms)[0].numpy()}

    monkeypatch.setattr(held, "_placed", placed)
    monkeypatch.setattr(held, "warnings", [])
    aside = held._aside()["tshirt"]
    assert set(aside) == set(shirt.loops) and aside.pop("hem") == pytest.approx(31.6, abs=0.1)
    assert max(aside.values()) < 0.1
    (said,) = held.warnings
    assert said.startswith("tshirt: opening hem is driven 32 mm beside the registered one in the mean of all frames")


def test_every_code_but_the_temporal_model_s_holds_over_the_sequence(held):
    rows = [name for name, of in held.shown.items() if of == "baseline"]
    codes = {name: [held.latents[name][n]["surface"] for n in (1, 3)] for name in rows}
    assert len(rows) == 3 + 2 * DRAWS and len({tuple(z[0].tolist()) for z, _ in codes.values()}) == len(rows)
    assert [name for name, (a, b) in codes.items() if not torch.equal(a, b)] == ["temporal model"]


def test_a_code_of_its_own_gaussian_has_the_mean_and_covariance_of_its_codes():
    codes = (
        torch.randn(7, 4, generator=torch.Generator().manual_seed(1)) @ torch.diag(torch.tensor([1.0, 2, 0.1, 0])) + 3
    )
    found = torch.stack([like(codes, seed) for seed in range(4000)])
    assert torch.allclose(found.mean(0), codes.mean(0), atol=0.1)
    assert torch.allclose(found.T.cov(), codes.T.cov(), atol=0.15) and (found[:, 3] - 3).abs().max() < 1e-5


def test_what_is_stated_of_the_baseline_is_its_strongest_row(held):
    class Errors:
        mse = {"temporal model": 3.0, "mean code": 2.0, "code zero": 4.0}

        def measures(self, name):
            return {"mse": self.mse[name]}

    assert held.sources(Errors()) == {"layered": "layered", "baseline": "mean code"}
    assert held.shown_in(1).keys() == {"layered", "temporal model", "mean code", "code zero"}


def test_draws_are_shown_by_every_camera(held):
    for cameras in (4, 6, 8, 10, 12):  # samples run over the cameras first
        assert {i % cameras for i in range(16 * cameras) if held.shown_in(i) is held.shown} == set(range(cameras))


def test_the_json_has_the_shape_of_the_reconstruction_s(folder, monkeypatch):
    monkeypatch.setattr(driving_codes, "DRAWS", 3)
    printed = CliRunner().invoke(app, ["evaluate", str(folder), "--frames", "1-3", "--driven", "--json"])
    assert printed.exit_code == 0, printed.output
    found, usual = json.loads(printed.stdout), evaluate_avatar(folder, [3], sheets=False)
    assert found["all"].keys() == usual["all"].keys() and usual["all"]["driven"] is None
    for name in ("layered", "baseline"):
        assert found["all"][name].keys() == usual["all"][name].keys() and found["all"][name]["silhouette_mse"] > 0
    driven = found["all"]["driven"]
    assert driven["temporal"]["window"] == 2
    for all_of in (found["all"], usual["all"]):  # nothing is shown that pierces
        assert all_of["intersections"]["left"] == 0
    assert found["all"]["intersections"]["frames"] == 3 and usual["all"]["intersections"]["frames"] == 1
    rows = driven["baseline_rows"]
    assert rows["unit Gaussian"]["draws"] == 3 and rows["own Gaussian"]["least_mse"] <= rows["own Gaussian"]["mse"]
    best = min(("temporal model", "mean code", "code zero"), key=lambda row: rows[row]["mse"])
    assert driven["baseline_by"] == best or len(found["per_frame"]) * 8 > rows["pictures"]
    change = found["all"]["change"]["mse"]
    assert change["change"] == pytest.approx(found["all"]["layered"]["mse"] / found["all"]["baseline"]["mse"] - 1)
    assert change["low"] <= change["change"] <= change["high"]
    mean = rows["mean code"]
    assert mean["change"]["mse"]["change"] == pytest.approx(rows["layered"]["mse"] / mean["mse"] - 1)
    assert list(driven["rivals"]) == ["draw", "mean_code", "zero", "own_gaussian", "driven"]
    assert driven["rivals"]["mean_code"] == {name: mean[name] for name in ("mse", "band_mse", "ssim")}
    drawn = rows["own Gaussian"]
    ends = [rows["layered"]["mse"] / drawn[end] - 1 for end in ("largest_mse", "least_mse")]
    assert ends[0] <= drawn["change"]["mse"]["change"] <= ends[1] and "change" not in rows["layered"]
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


def test_all_frames_between_held_out_pictures_are_held_out_and_those_of_the_run():
    assert kept_apart((), [60, 66, 72]) == list(range(60, 73)) and not kept_apart((), [])
    assert kept_apart((58, 74), [60, 66, 72]) == list(range(58, 75))


def test_of_rows_that_nothing_asks_for_again_one_frame_is_kept(folder):
    held = Driven(folder, [1, 3])
    for row in ("layered", "temporal model", f"{UNIT} 1"):
        for frame in (1, 3):
            held._placed(row, frame)
    assert held.decoded["layered"].keys() == held.decoded["temporal model"].keys() == {1, 3}  # the truth asks for them
    assert held.decoded[f"{UNIT} 1"].keys() == {3}


def test_the_frames_driven_are_the_same_in_whatever_order_they_are_asked_for(folder, held):
    turned = Driven(folder, [3, 1])
    assert turned.frames == held.frames == [1, 3] and turned.span == held.span == [1, 2, 3]


def test_physics_shows_what_an_animation_by_physics_shows(folder, sample_run):
    printed = CliRunner().invoke(app, ["evaluate", str(folder), "--frames", "3", "--driven", "--physics", "--json"])
    assert printed.exit_code == 0, printed.output
    everything = json.loads(printed.stdout)["all"]
    driven = everything["driven"]
    assert everything["intersections"]["left"] == 0
    assert driven["physics"]["strain"] > 0 and driven["physics"]["self_pairs"]["tshirt"] >= 0
    shown = Driven(folder, [3], physics=True)._placed("layered", 3)["tshirt"]
    hung = DrivenAvatar(folder, sample_run, physics=True)
    decoded, *_ = hung.decode(3, hung.unseen(3))
    assert np.abs(decoded["tshirt"].vertices[0].cpu().numpy() - shown).max() < 1e-5
    assert np.abs(Driven(folder, [3])._placed("layered", 3)["tshirt"] - shown).mean() > 1e-4


def test_physics_without_a_driver_is_refused(folder):
    refused = CliRunner().invoke(app, ["evaluate", str(folder), "--physics"])
    assert isinstance(refused.exception, UserError)
    assert str(refused.exception) == "--physics: it drives an avatar: give --driven too"
