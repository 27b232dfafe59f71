"""What frames a training may see, and what the command refuses."""

import json
from types import SimpleNamespace

import pytest

from toile.avatar.command import own_options
from toile.avatar.settings import PRESETS, AvatarSettings, preset
from toile.avatar.train.make import held_out, left_out_frames, refuse_other
from toile.errors import UserError


def test_last_tenth_is_held_out():
    assert held_out(None, list(range(0, 240, 6))) == [216, 222, 228, 234]
    assert held_out(None, [3, 4, 5]) == [5]
    assert held_out(None, [3]) == []
    assert held_out("none", [3, 4]) == []


def test_holdout_takes_the_pictured_frames_of_a_range():
    assert held_out("6-13", [0, 6, 12, 18]) == [6, 12]
    assert held_out("18", [0, 6, 12, 18]) == [18]


def test_what_a_run_holds_out_is_held_out_of_the_avatar_and_nothing_else():
    frames = [0, 6, 12, 18]
    for text in (None, "5-12"):
        assert held_out(text, frames, (5, 12), "run") == [6, 12]
    for text in ("5-13", "none"):
        with pytest.raises(UserError, match=f"--holdout {text}: run was registered with --holdout 5-12"):
            held_out(text, frames, (5, 12), "run")


@pytest.mark.parametrize(
    "asked, run_holds, earlier, held",
    [(None, (), [6], [6]), (None, (), None, [18]), ("12", (), [6], [12]), (None, (0, 5), [6], [0]), (None, (), [], [])],
)
def test_what_an_avatar_was_asked_for_stays_unless_the_run_holds_out_its_own(tmp_path, asked, run_holds, earlier, held):
    if earlier is not None:
        (tmp_path / "avatar.json").write_text(json.dumps({"holdout": earlier}))
    run = SimpleNamespace(pictured=[0, 6, 12, 18], holdout=run_holds, path="run")
    assert left_out_frames(asked, tmp_path, run) == held


@pytest.mark.parametrize("own", [(), (0, 5)])
def test_a_run_without_pictures_is_refused(tmp_path, own):
    run = SimpleNamespace(pictured=[], holdout=own, path="run")
    with pytest.raises(UserError, match="run: no registered frame has pictures"):
        left_out_frames(None, tmp_path, run)


@pytest.mark.parametrize("text", ["x", "4-", "-4", "4-2", "1-5", "", "4,5"])
def test_bad_holdout_is_refused(text):
    with pytest.raises(UserError, match="--holdout"):
        held_out(text, [0, 6, 12, 18])


@pytest.mark.parametrize(
    "options, message",
    [
        (dict(minutes=0.0), "--minutes 0"),
        (dict(minutes=float("nan")), "--minutes nan"),
        (dict(minutes=float("inf")), "--minutes inf"),
        (dict(lr=0.0), "--lr 0"),
        (dict(lr=float("nan")), "--lr nan"),
        (dict(steps="3,4"), "--steps 3,4"),
        (dict(steps="3,4,x"), "--steps 3,4,x"),
        (dict(steps="3,4,-1"), "--steps 3,4,-1"),
        (dict(steps="0,0,0"), "--steps 0,0,0: nothing would be trained"),
        (dict(steps="3,4,5", minutes=2.0), "--minutes 2 is given too"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(UserError, match=message):
        own_options(**dict(minutes=None, steps=None, lr=None, seed=0) | options)


def test_options_change_the_settings():
    changed = own_options(None, "3,4,5", 0.01, 7)
    assert changed == {"seed": 7, "lr": 0.01, "body_steps": 3, "garment_steps": 4, "joint_steps": 5}
    assert {"seed", "lr", "body_steps"} <= AvatarSettings.model_fields.keys()


def test_unknown_quality_is_refused():
    with pytest.raises(UserError, match="--quality rough: expected one of draft, standard, fine"):
        preset("rough")


def test_presets_grow():
    sizes = [preset(quality) for quality in PRESETS]
    for name in ("texture_size", "geometry_size"):
        values = [getattr(settings.data, name) for settings in sizes]
        assert values == sorted(values)
    steps = [sum(phase.steps for phase in settings.phases()) for settings in sizes]
    assert steps == sorted(steps)


def test_a_folder_of_something_else_is_left_alone_and_one_that_was_begun_is_not(tmp_path):
    refuse_other(tmp_path / "new")
    for name in ("aligned", "cache", "evaluation", "baseline", ".lock"):
        (tmp_path / name).mkdir()
    refuse_other(tmp_path)
    (tmp_path / "registered.zarr").mkdir()
    with pytest.raises(UserError, match="holds registered.zarr and no avatar: take another folder"):
        refuse_other(tmp_path)
    (tmp_path / "avatar.json").write_text("{}")
    refuse_other(tmp_path)
