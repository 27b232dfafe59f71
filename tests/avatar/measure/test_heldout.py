"""`toile evaluate AVATAR` and its report on a tiny avatar of the bundled capture."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from tests.support.synthetic_run import copy_capture, true_run, with_another_template
from toile.avatar.drive.layering import GarmentLayering
from toile.avatar.measure.evaluation import evaluate_avatar
from toile.avatar.measure.heldout import HeldOut, RegisteredRun, _chosen
from toile.avatar.measure.report import write_avatar_report
from toile.avatar.model.checkpoint import read_facts
from toile.avatar.settings import AvatarSettings, DataSettings, NetworkSettings
from toile.cli import app
from toile.errors import UserError

TINY = AvatarSettings(
    data=DataSettings(geometry_size=64, texture_size=64, image=(120, 120), pixel_scale=3.0),
    network=NetworkSettings(latent=8, width=8, least_width=4, ao_rays=4, ao_size=32),
    body_steps=1,
    garment_steps=1,
    joint_steps=1,
    baseline_lr=(1.0,),
)


@pytest.fixture(scope="module")
def avatar(sample_run, tmp_path_factory):
    """Trained for a step a phase on frames 0 to 2, with its baseline."""
    from toile.avatar.train.make import Request, make_avatar

    folder = tmp_path_factory.mktemp("avatar") / "a&b"
    make_avatar(Request(sample_run, TINY, holdout="3-3"), folder, baseline=True)
    return folder


@pytest.fixture(scope="module")
def result(avatar):
    return evaluate_avatar(avatar)


def dented(decoded):
    """The body with a vertex moved by 4 mm."""
    moved = decoded["body"].vertices.clone()
    moved[0, 100, 2] += 0.004
    return decoded | {"body": replace(decoded["body"], vertices=moved)}


def test_pairs_that_are_left_and_joints_that_were_never_so_are_said_with_the_worst_frame(avatar, result, monkeypatch):
    said = (
        "5 pairs of triangles of garments and what lies under them still intersect, in 1 of 1 frames, most in frame 3"
    )
    assert result["all"]["intersections"]["left"] == 0 and said not in result["warnings"]
    monkeypatch.setattr(GarmentLayering, "__call__", lambda self, decoded, pose: (dented(decoded), 9, 5))
    monkeypatch.setattr("toile.avatar.model.poses.JOINT_FAR", 0.0)
    found = evaluate_avatar(avatar, sheets=False)
    warnings = found["warnings"]
    assert result["all"]["intersections"]["dent_mm"] == 0
    assert found["all"]["intersections"]["dent_mm"] == pytest.approx(4.0, rel=1e-4)
    assert said in warnings and any("have a joint more than 0 degrees" in w and "frame 3" in w for w in warnings)


def test_the_json_has_the_documented_shape(avatar, result):
    printed = CliRunner().invoke(app, ["evaluate", str(avatar), "--json"])
    assert printed.exit_code == 0, printed.output
    found = json.loads(printed.stdout)
    assert found.keys() == {"all", "per_frame", "warnings"} and [f["frame"] for f in found["per_frame"]] == [3]
    for part in (found["all"], found["per_frame"][0]):
        for name in ("layered", "baseline"):
            assert 0 < part[name]["band_mse"] and 0 < part[name]["mse"] < 255**2 and -1 <= part[name]["ssim"] <= 1
            assert len(part[name]["cameras"]) == 8
    sizes = found["all"]["parameters"]
    assert 0.9 < sizes["baseline"] / sizes["layered"] < 1.1
    assert found["all"]["layered"]["mse"] == pytest.approx(result["all"]["layered"]["mse"])


def test_decoded_layers_are_measured_against_the_truth(result):
    geometry = result["all"]["layered"]["geometry"]
    shirt = geometry["garment"]["tshirt"]
    # a step of training leaves the mean shape, and the frames are neighbours
    assert 0 < shirt["surface_mm"] < 5 and shirt["surface_mm"] < shirt["correspondence_mm"] < 40
    assert len(shirt["boundary_mm"]) == 4 and 0 < geometry["body"]["visible_mm"] < 5
    assert 0 < geometry["outer_mm"] < 5 and 0 < result["all"]["baseline"]["geometry"]["outer_mm"] < 10
    assert result["all"]["labels"] == "truth" and result["all"]["photometric"] is None


def test_without_a_map_a_decoded_loop_is_measured_against_the_opening_of_its_name(tmp_path):
    """Sleeves that lie on one another's rims, as `toile evaluate` of a run tells them: the nearest rim would call them right."""
    capture = copy_capture(tmp_path)
    run = true_run(capture, tmp_path)
    store = with_another_template(capture, run)
    scene = store.attrs["scene"]
    loops = scene["garments"][0]["loops"]
    loops["sleeve_left"], loops["sleeve_right"] = loops["sleeve_right"], loops["sleeve_left"]
    store.attrs["scene"] = scene
    registered = RegisteredRun(run)
    layers = {"tshirt": SimpleNamespace(kind="garment", faces=registered.run.garments["tshirt"].faces)}
    found = registered.errors(0, {"tshirt": registered.garment("tshirt", 0)}, layers)["garment"]["tshirt"][
        "boundary_mm"
    ]
    assert found["sleeve_left"] > 100 and found["sleeve_right"] > 100 and found["hem"] < 1e-3


def test_the_pose_is_some_way_from_the_nearest_trained_one(avatar, result):
    assert 0 < result["all"]["pose_distance_deg"] < 30
    assert HeldOut(avatar, [2]).from_training()[0] == 0


def test_frames_of_the_hold_out_share_a_cache(avatar):
    whole, one = HeldOut(avatar), HeldOut(avatar, [3])
    assert all(whole.data[name].folder == one.data[name].folder for name in whole.data)


def test_an_avatar_that_shows_the_captured_picture_has_no_error(avatar, monkeypatch):
    show = HeldOut._show

    def captured(self, name, sample):
        return replace(show(self, name, sample), image=sample["image"], mask=torch.ones(sample["mask"].shape))

    monkeypatch.setattr(HeldOut, "_show", captured)
    found = evaluate_avatar(avatar, sheets=False)["all"]
    for name in ("layered", "baseline"):
        assert found[name]["mse"] == 0 and found[name]["ssim"] == pytest.approx(1)


def test_sheets_and_page_are_drawn_and_names_are_escaped(avatar, tmp_path):
    page = write_avatar_report(avatar, tmp_path / "report.html").read_text(encoding="utf-8")
    names = sorted(p.name for p in (avatar / "sheets").iterdir())
    assert len(names) == 2 and names[0].startswith("000003_cam") and names[1] == "000003_unseen.png"
    assert page.count("<img") == 2 and "a&amp;b" in page and "a&b" not in page
    assert "single layer" in page and "tshirt correspondence" in page


def test_frames_that_were_trained_on_are_evaluated_with_a_warning(avatar):
    printed = CliRunner().invoke(app, ["evaluate", str(avatar), "--frames", "2-3,77"])
    assert printed.exit_code == 0, printed.output
    assert "frames 2: the avatar was trained on them" in printed.stderr
    assert "frames 77: not registered or without pictures, left out" in printed.stderr
    assert "mse" in printed.stdout and "warning" not in printed.stdout


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--frames", "50-60"], "none of them is registered"),
        (["--frames", "x"], "not a number or a range"),
        (["--frames", "3-1"], "runs backwards"),
        (["--frames", "1000000"], "six digits"),
        (["--run", "/nowhere"], "/nowhere: no such folder"),
    ],
)
def test_bad_input_is_one_message(avatar, arguments, message):
    printed = CliRunner().invoke(app, ["evaluate", str(avatar), "--json", *arguments])
    assert isinstance(printed.exception, UserError) and message in str(printed.exception)
    assert printed.stdout == "" and "\n" not in str(printed.exception)


def test_where_the_run_has_gone_it_is_asked_for(avatar, tmp_path):
    folder = shutil.copytree(avatar, tmp_path / "avatar")
    facts = json.loads((folder / "avatar.json").read_text())
    (folder / "avatar.json").write_text(json.dumps(facts | {"run": "/nowhere"}))
    with pytest.raises(UserError, match="avatar: its run /nowhere is not there: give its place by --run"):
        HeldOut(folder)


def test_a_training_that_was_stopped_is_no_avatar_yet(tmp_path):
    (tmp_path / "checkpoints").mkdir()
    printed = CliRunner().invoke(app, ["evaluate", str(tmp_path)])
    assert "holds no avatar" in str(printed.exception)


def test_the_baseline_s_own_folder_can_be_evaluated(avatar):
    found = evaluate_avatar(avatar / "baseline", sheets=False)["all"]
    assert found["layered"] is None and found["baseline"]["mse"] > 0


def test_a_run_of_another_topology_is_refused(avatar, sample_run, tmp_path):
    import zarr

    run = shutil.copytree(sample_run, tmp_path / "run")
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    store["garment/tshirt/uv"][:] = store["garment/tshirt/uv"][:] * 0.5
    with pytest.raises(UserError, match="tshirt"):
        HeldOut(avatar, run=run)


def test_another_registration_of_the_same_capture_is_refused(avatar, sample_run, tmp_path):
    """A garment a millimetre off in one of the frames that taught, all else the same."""
    import zarr

    HeldOut(avatar, run=shutil.copytree(sample_run, tmp_path / "moved"))
    run = shutil.copytree(sample_run, tmp_path / "run")
    store, first = zarr.open_group(str(run / "registered.zarr"), mode="r+"), read_facts(avatar)["frames"][0]
    row = int(np.flatnonzero(store["frames"][:] == first)[0])
    store["garment/tshirt/vertices"][row] = store["garment/tshirt/vertices"][row] + 1e-3
    with pytest.raises(UserError, match="run: its registration is not the one that .* was trained on"):
        HeldOut(avatar, run=run)


def test_a_frame_without_hold_out_must_be_named():
    facts = {"holdout": [], "frames": [0, 1]}
    with pytest.raises(UserError, match="name frames by --frames"):
        _chosen("avatar", facts, None, [0, 1])
    assert _chosen("avatar", facts, [1], [0, 1])[0] == [1]


def test_frames_to_evaluate_rise_and_each_comes_once_in_whatever_order_they_are_asked_for():
    for asked in ([1, 2, 5], [5, 1, 2], [5, 5, 2, 1, 2]):
        assert _chosen("avatar", {"holdout": [], "frames": []}, asked, range(9)) == ([1, 2, 5], [])


def test_without_truth_the_registration_is_checked_by_its_pictures(avatar, sample_run, tmp_path):
    import tomllib

    import tomli_w

    run = shutil.copytree(sample_run, tmp_path / "run")
    config = tomllib.loads((run / "config.toml").read_text())
    capture = shutil.copytree(config["capture"], tmp_path / "capture", ignore=shutil.ignore_patterns("truth"))
    (run / "config.toml").write_text(tomli_w.dumps(config | {"capture": str(capture)}))
    found = evaluate_avatar(avatar, run=run, sheets=False)["all"]
    assert found["labels"] == "captured" and found["layered"]["geometry"] is None
    for name in ("layered", "baseline"):
        check = found["photometric"][name]
        assert check["mse"] < 1500 and check["ssim"] > 0.5 and check["pixels"] > 1000


def test_unseen_views_show_a_person_and_are_no_camera_s(avatar):
    held = HeldOut(avatar)
    views = held.unseen_views(3, 2)
    assert len(views) == 2 and all(v.shape == (120, 120, 3) and np.isfinite(v).all() for v in views)
    assert all((v.max(-1) > 0.05).mean() > 0.05 for v in views)


def test_background_is_the_nearest_colour_that_is_surely_beside_the_person():
    from toile.avatar.measure.heldout import MIXED, background

    mask = np.zeros((20, 30), bool)
    mask[5:15, 8:20] = True
    wall = np.where(np.arange(30)[:, None] < 14, 0.2, 0.7)[None].repeat(20, 0).astype(np.float32).repeat(3, 2)
    captured = np.where(mask[..., None], 1.0, wall).astype(np.float32)
    edge = np.roll(mask, MIXED, 1) & ~mask  # silhouettes bleed
    captured[edge] = 1.0
    found = background(captured, mask).numpy().transpose(1, 2, 0)
    assert (
        found.max() == np.float32(0.7)
        and (found[8:12, 8] == np.float32(0.2)).all()
        and (found[8:12, 19] == np.float32(0.7)).all()
    )
    assert background(captured, np.ones_like(mask)).abs().max() == 0
