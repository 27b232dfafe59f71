"""The temporal model of a trained avatar: its tracks, files and refusals."""

import json
import shutil
import sys

import numpy as np
import pytest
import torch

from tests.support import small_avatar
from tests.support.tracks import track, wake
from toile.avatar.command import temporal_options, temporal_words
from toile.avatar.drive.animate import DrivenAvatar
from toile.avatar.drive.driver import (  # fmt: skip
    Driver,
    Track,
    hardly_foretold,
    load_driver,
    make_track,
    run_track,
    smoothed,
    taught_before,
    without,
)
from toile.avatar.drive.teaching import relative_error, train_temporal
from toile.avatar.model.checkpoint import load_avatar, read_tensors, write_tensors
from toile.avatar.model.temporal import DampedModel
from toile.avatar.settings import TemporalSettings
from toile.cli import main
from toile.errors import UserError
from toile.io.run import open_run
from toile.io.run_folder import capture_folder


def test_rows_of_neighbours_begin_after_each_gap():
    assert track([0, 1, 2, 5, 6, 9]).first.tolist() == [0, 0, 0, 3, 3, 5]
    assert track([0, 6, 12, 30, 36]).first.tolist() == [0, 0, 0, 3, 3]


def test_held_out_frames_part_those_on_either_side():
    left = without(track(range(10)), [4, 5])
    assert left.frames.tolist() == [0, 1, 2, 3, 6, 7, 8, 9]
    assert left.first.tolist() == [0, 0, 0, 0, 4, 4, 4, 4]
    assert without(track([0, 1, 2, 5, 6]), [1]).first.tolist() == [0, 1, 2, 2]


@pytest.mark.parametrize("model, kriged", [("window", 0), ("window", 6), ("damped", 0)])
def test_a_finer_motion_drives_as_its_every_nth_frame_does(model, kriged):
    torch.manual_seed(0)
    driver = Driver(TemporalSettings(model=model, window=4, channels=8), 3, {"shirt": 5}, kriged=kriged).eval()
    fine = track(range(24), stride=6)
    wake(driver, fine)
    coarse = Track(fine.frames[::6], fine.features[::6], fine.first[::6] * 0, 1, 1.0)
    with torch.no_grad():
        assert torch.allclose(driver.latents(fine)["shirt"][::6], driver.latents(coarse)["shirt"], atol=1e-6)


def test_smoothing_takes_noise_and_leaves_a_line_and_does_not_cross_a_gap():
    frames = np.r_[np.arange(40), 60 + np.arange(40)]
    fine = track(frames, rate=30.0)
    line = torch.as_tensor(frames, dtype=torch.float32)[:, None]
    found = smoothed(line, fine)
    assert torch.allclose(found[5:35], line[5:35], atol=1e-4) and torch.allclose(found[45:75], line[45:75], atol=1e-4)
    assert found[:40].max() <= 39 and found[40:].min() >= 60
    noise = torch.randn(80, 3)
    assert smoothed(noise, fine).diff(n=2, dim=0).std() < 0.2 * noise.diff(n=2, dim=0).std()
    weights = smoothed(torch.eye(80), fine)[20]  # a Gaussian of 50 ms, over its sum
    expected = np.exp(-0.5 * ((np.arange(40) - 20) / 1.5) ** 2) * (np.abs(np.arange(40) - 20) <= 4)
    assert np.allclose(weights[:40], expected / expected.sum(), atol=1e-6) and not weights[40:].any()


def test_frames_a_fifth_of_a_second_apart_and_a_single_one_are_not_smoothed():
    noise = torch.randn(20, 3)
    assert torch.equal(smoothed(noise, track(range(20), rate=5.0)), noise)
    one = Track(np.array([0]), torch.zeros(1, 3), torch.zeros(1, dtype=torch.int64), 1, 30.0)
    assert torch.equal(smoothed(noise[:1], one), noise[:1])


def test_a_motion_of_another_step_is_refused():
    avatar = small_avatar.avatar()
    poses = np.zeros((4, 3, 3))
    with pytest.raises(
        UserError, match="its frames are 4 apart, the temporal model was trained on poses 6 apart: `toile export`"
    ):
        make_track(avatar, [0, 4, 8, 12], poses, None, 6, 30.0)
    assert make_track(avatar, [0, 3, 6, 9], poses, None, 6, 30.0).step == 2


def test_an_untaught_model_gives_the_mean_codes_of_each_garment():
    torch.manual_seed(0)
    driver = Driver(TemporalSettings(window=2, channels=8), 3, {"shirt": 2, "jacket": 3})
    codes = 5 + 3 * torch.randn(50, 5)
    driver.scale(torch.randn(50, 3), codes)
    found = driver.latents(track(range(7)))
    assert found["shirt"].shape == (7, 2) and found["jacket"].shape == (7, 3)
    assert torch.allclose(torch.cat(list(found.values()), 1), codes.mean(0).expand(7, 5), atol=1e-5)


def test_poses_far_from_training_give_codes_within_its_range():
    torch.manual_seed(0)
    driver = Driver(TemporalSettings(window=2, channels=8), 3, {"shirt": 4})
    codes = torch.randn(50, 4)
    far = track(range(9))
    wake(driver, far)
    driver.scale(far.features, codes)
    far.features.mul_(1e6)
    found = driver.latents(far)["shirt"]
    assert (found >= codes.amin(0) - 1e-5).all() and (found <= codes.amax(0) + 1e-5).all()
    assert (found == found[0]).all(0).sum() < 4  # it still follows the pose


def test_several_models_say_the_mean_of_what_each_says():
    torch.manual_seed(0)
    settings, motion = TemporalSettings(window=2, channels=8), track(range(9))
    driver = Driver(settings, 3, {"shirt": 4}, models=3)
    wake(driver, motion)
    together, alone = driver.read(motion), []
    for model in list(driver.models):
        driver.models = torch.nn.ModuleList([model])
        alone.append(driver.read(motion))
    assert torch.allclose(together, torch.stack(alone).mean(0), atol=1e-6) and not torch.equal(alone[0], alone[1])


def test_a_kriged_model_has_its_share_of_what_is_said():
    torch.manual_seed(0)
    driver, motion = Driver(TemporalSettings(window=2, channels=8), 3, {"shirt": 4}, kriged=5), track(range(9))
    wake(driver, motion)
    windows = driver.windows_of(motion, torch.arange(9))
    driver.kriged.share.fill_(0.25)
    expected = 0.75 * driver.models[0](windows) + 0.25 * driver.kriged(windows)
    assert torch.allclose(driver.told(windows), expected, atol=1e-6)


@pytest.fixture(scope="module")
def driven(sample_avatar):
    folder = sample_avatar.parent / "driven"
    shutil.copytree(sample_avatar, folder)
    return folder, train_temporal(folder, TemporalSettings(window=3, channels=16, steps=200, lr=5e-3))


def test_training_learns_the_codes_of_its_frames_and_saves_them(driven):
    folder, measured = driven
    assert measured["code_error"] < 0.05  # of their variance
    assert measured["held_out"] > 0
    driver, stride, known = load_driver(folder)
    assert known == driven[1] and stride == 1 and driver.settings.window == 3 and set(driver.sizes) == {"tshirt"}


def test_a_model_of_before_several_drove_together_drives_as_it_did(driven, tmp_path):
    folder, motion = (
        shutil.copytree(driven[0], tmp_path / "avatar"),
        track(range(9), features=load_driver(driven[0])[0].projection.mean.numel()),
    )
    tensors, facts = read_tensors(folder / "temporal.safetensors")
    now = load_driver(folder)[0].latents(motion)["tshirt"]
    kept = {name: value for name, value in tensors.items() if not name.startswith("model.kriged.")}
    older = {name.replace("model.models.0.", "model.model."): value for name, value in kept.items()}
    del facts["models"], facts["kriged"], facts["settings"]["kriged"]
    write_tensors(folder / "temporal.safetensors", older, facts)
    assert older.keys() != tensors.keys() and torch.equal(load_driver(folder)[0].latents(motion)["tshirt"], now)


def test_a_window_that_nobody_chose_holds_half_a_second_of_poses(sample_avatar, tmp_path):
    folder = shutil.copytree(sample_avatar, tmp_path / "avatar")
    train_temporal(folder, TemporalSettings(channels=8, steps=5))
    driver, stride, _ = load_driver(folder)
    assert stride == 1 and driver.settings.window == round(load_avatar(folder).scene.fps / 2) > 1


def test_the_damped_model_is_asked_for_trained_saved_and_drives(
    sample_avatar, sample_run, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "damped"
    shutil.copytree(sample_avatar, folder)
    monkeypatch.setattr("toile.avatar.train.make.make_avatar", lambda *_: None)  # trained already, by other settings

    def shorter(folder, settings, progress):
        return train_temporal(folder, settings.model_copy(update=dict(channels=8, steps=5, stretch=3)), progress)

    monkeypatch.setattr("toile.avatar.drive.teaching.train_temporal", shorter)
    monkeypatch.setattr(sys, "argv", ["toile", "train", str(sample_run), str(folder), "--temporal-model", "damped"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 0 and "temporal model (damped): 5 steps, code error" in capsys.readouterr().out
    driver, *_ = load_driver(folder)
    assert isinstance(driver.models[0], DampedModel) and taught_before(folder).model == "damped"
    monkeypatch.setattr(sys, "argv", ["toile", "train", str(sample_run), str(folder), "--temporal", "--no-physics"])
    with pytest.raises(SystemExit):  # what is not given stays as it was asked
        main()
    assert "temporal model (damped): 5 steps" in capsys.readouterr().out
    driven = DrivenAvatar(folder, sample_run)
    motion = driven.motion
    with torch.no_grad():
        expected = driver.latents(
            make_track(driven.avatar, motion.frames, motion.rotations, motion.face, 1, motion.fps)
        )
    assert torch.equal(driven.latents["tshirt"], expected["tshirt"])


def test_a_damaged_temporal_model_is_taught_anew_and_that_is_said(
    sample_avatar, sample_run, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "damaged"
    shutil.copytree(sample_avatar, folder)
    monkeypatch.setattr("toile.avatar.train.make.make_avatar", lambda *_: None)
    monkeypatch.setattr("toile.avatar.drive.teaching.train_temporal", lambda *_: {"steps": 0, "code_error": 0.0})
    monkeypatch.setattr(sys, "argv", ["toile", "train", str(sample_run), str(folder), "--temporal", "--no-physics"])
    said = []
    for damage in (False, True):
        if damage:
            (folder / "temporal.safetensors").write_bytes(b"cut off")
        with pytest.raises(SystemExit) as stopped:
            main()
        assert stopped.value.code == 0
        said.append("temporal.safetensors: does not say how it was taught" in capsys.readouterr().err)
    assert said == [False, True]


@pytest.mark.parametrize("sizes", [{"kriged": -1}, {"kriged": 10**13}, {"features": -1}])
def test_a_temporal_model_of_sizes_that_no_tensor_has_is_refused_in_a_line(driven, tmp_path, sizes):
    folder = shutil.copytree(driven[0], tmp_path / "avatar")
    tensors, facts = read_tensors(folder / "temporal.safetensors")
    write_tensors(folder / "temporal.safetensors", tensors, facts | sizes)
    with pytest.raises(UserError, match="temporal.safetensors: not a temporal model's facts: .*") as refused:
        load_driver(folder)
    assert "\n" not in str(refused.value)


def test_what_a_training_measured_is_said_with_kriging_s_share_where_it_has_one():
    measured = {"steps": 5, "code_error": 0.1234, "held_out": 0.5}
    assert (
        temporal_words("window", measured)
        == "temporal model (window): 5 steps, code error 0.123, held out 0.500, of the codes' variance"
    )
    assert temporal_words("window", measured | {"kriged_share": 0.48}).startswith(
        "temporal model (window, 0.48 kriged): 5 steps"
    )


def test_of_a_single_frame_no_error_is_said_but_that_it_teaches_no_driving(sample_run, sample_avatar, tmp_path):
    folder = shutil.copytree(sample_avatar, tmp_path / "avatar")
    facts = json.loads((folder / "avatar.json").read_text())
    single = facts | {"frames": [0], "holdout": [1, 2, 3]}
    (folder / "avatar.json").write_text(json.dumps(single))
    measured = train_temporal(folder, TemporalSettings(window=2, channels=8, steps=20))
    assert measured == {"steps": 20, "frames": 1}
    assert temporal_words("window", measured) == "temporal model (window): 20 steps"
    (told,) = hardly_foretold(measured)
    assert told.startswith("one training frame teaches no driving")


def test_the_command_line_names_the_temporal_model():
    assert temporal_options(None, None, None) == {}
    assert TemporalSettings(**temporal_options(None, 7, 3)) == TemporalSettings(window=7, seed=3)
    assert TemporalSettings(**temporal_options("damped", 15, 0)) == TemporalSettings(model="damped", window=15)
    with pytest.raises(UserError, match="--temporal-model springs: expected window or damped"):
        temporal_options("springs", 15, 0)
    with pytest.raises(UserError, match="--window 0: expected at least one pose"):
        temporal_options("window", 0, 0)


@pytest.mark.parametrize("given", [["--window", "3"], ["--no-physics"]])
def test_what_is_of_driving_alone_is_refused_without_it(tmp_path, monkeypatch, capsys, given):
    monkeypatch.setattr(sys, "argv", ["toile", "train", str(tmp_path / "run"), str(tmp_path / "avatar"), *given])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 1
    assert f"{' '.join(given)}: it is of what drives garments: give --temporal too" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_bits_for_any_number_of_threads(driven, tmp_path):
    folder, _ = driven
    again = tmp_path / "again"
    shutil.copytree(folder, again)
    before = torch.get_num_threads()
    torch.set_num_threads(before + 2)
    try:
        train_temporal(again, TemporalSettings(window=3, channels=16, steps=200, lr=5e-3))
        assert torch.get_num_threads() == before + 2
    finally:
        torch.set_num_threads(before)
    assert (again / "temporal.safetensors").read_bytes() == (folder / "temporal.safetensors").read_bytes()


def test_an_untaught_model_errs_by_the_codes_variance():
    torch.manual_seed(0)
    driver = Driver(TemporalSettings(window=2, channels=8), 3, {"shirt": 4})
    codes = 5 + 3 * torch.randn(50, 4)
    driver.scale(torch.randn(50, 3), codes)
    assert relative_error(driver, track(range(50)), range(50), codes) == pytest.approx(1.0, abs=1e-4)


def test_what_cannot_be_driven_is_refused(sample_avatar, tmp_path):
    with pytest.raises(UserError, match="temporal.safetensors: the file is missing"):
        load_driver(sample_avatar)
    alone = shutil.copytree(sample_avatar / "baseline", tmp_path / "alone")  # of the avatar whose garments read poses
    with pytest.raises(UserError, match="holds no avatar"):
        train_temporal(alone, TemporalSettings(steps=1))
    (tmp_path / "temporal.safetensors").write_bytes(b"rubbish")
    with pytest.raises(UserError, match="temporal.safetensors: not a file of toile's tensors"):
        load_driver(tmp_path)


def test_a_model_of_other_settings_is_refused_and_said_how_to_make_anew(driven, tmp_path):
    folder, _ = driven
    tensors, facts = read_tensors(folder / "temporal.safetensors")
    facts["settings"]["pose_noise"] = 0.5
    write_tensors(tmp_path / "temporal.safetensors", tensors, facts)
    with pytest.raises(
        UserError, match=r"temporal.safetensors: pose_noise: .*; `toile train RUN .* --temporal` makes the model anew"
    ):
        load_driver(tmp_path)


def test_windows_hold_the_poses_of_frames_without_pictures(sample_avatar, sample_run, tmp_path):
    capture = shutil.copytree(capture_folder(sample_run), tmp_path / "capture")
    run = shutil.copytree(sample_run, tmp_path / "run")
    config = (run / "config.toml").read_text().replace(str(capture_folder(sample_run)), str(capture))
    (run / "config.toml").write_text(config)
    shutil.rmtree(capture / "frames" / "000001" / "images")
    found = run_track(load_avatar(sample_avatar), open_run(run))
    assert open_run(run).pictured == [0, 2, 3] and found.frames.tolist() == [0, 1, 2, 3] and found.step == 1
    driver = Driver(TemporalSettings(window=2, channels=8), found.features.shape[1], {"tshirt": 4})
    wake(driver, found)
    found.features.requires_grad_()
    driver.errors(driver.windows_of(found, torch.tensor(found.rows({2}))), torch.randn(1, 4)).sum().backward()
    assert found.features.grad.abs().sum(1).nonzero().ravel().tolist() == [1, 2]


def test_a_model_that_hardly_knows_the_motion_held_out_is_said():
    assert hardly_foretold({}) == hardly_foretold({"held_out": 0.49}) == []
    (told,) = hardly_foretold({"held_out": 1.386, "steps": 540})
    assert "in the frames held out codes err by 1.39 of their variance" in told and "a longer motion" in told
