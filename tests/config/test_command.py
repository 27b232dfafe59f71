"""`toile settings`, and the commands that take settings."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import toile
from tests.support.command_line import run_cli
from toile.config import Config, listed, preset
from toile.config.command import every, page
from toile.errors import UserError

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data_samples" / "tshirt-talk"


def test_the_page_of_the_documentation_is_the_settings_own():
    written = (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")
    assert written == page(dict(every())) + "\n", "toile settings --markdown > docs/reference/settings.md"


def test_every_command_lists_all_its_settings(monkeypatch, capsys):
    assert run_cli(monkeypatch, "settings", "--json") == 0
    tables = json.loads(capsys.readouterr().out)
    assert list(tables) == ["register", "reconstruct", "align", "train", "animate", "studio"]
    assert [row["name"] for row in tables["register"]] == [one.name for one in listed(Config())]
    spacing = next(row for row in tables["register"] if row["name"] == "track.scan_spacing")
    assert spacing["default"] == 0 and spacing["presets"] == {"draft": preset("draft").track.scan_spacing}


def test_a_stage_is_listed_alone(monkeypatch, capsys):
    assert run_cli(monkeypatch, "settings", "dress.loop") == 0
    out = capsys.readouterr().out
    assert "dress.loop.bending " in out and "dress.contact" not in out and "[m] " in out
    assert run_cli(monkeypatch, "settings", "dres") == 1
    assert capsys.readouterr().err.strip() == "toile: dres: no such stage or setting; nearest: dress"


@pytest.mark.parametrize("command", ["register", "reconstruct", "align", "train", "studio"])
def test_every_command_refuses_an_unknown_setting_and_leaves_nothing(command, monkeypatch, capsys, tmp_path):
    places = [tmp_path / "out"] if command == "studio" else [SAMPLE, tmp_path / "out"]
    assert run_cli(monkeypatch, command, *places, "--set", "qualitee=3") == 1
    said = capsys.readouterr().err
    assert said.startswith("toile: --set qualitee: no such setting") and said.count("\n") == 1
    (tmp_path / "mine.toml").write_text("[nowhere]\nx = 1\n")
    assert run_cli(monkeypatch, command, *places, "--config", tmp_path / "mine.toml") == 1
    assert f"--config {tmp_path / 'mine.toml'}: nowhere: no such setting" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["mine.toml"]


def test_register_takes_settings_as_keywords(tmp_path):
    for keywords, message in (
        ({"dress": {"contat": 0.01}}, "dress.contat: no such setting; nearest: dress.contact"),
        ({"wokers": 2}, "wokers: no such setting; nearest: workers"),
        ({"dress.contact": "wide"}, "dress.contact = 'wide': should be a valid number"),
        ({"quality": "best"}, "--quality best: expected one of draft, standard"),
        ({"config": Config(), "quality": "draft"}, "quality draft: a config is given too"),
    ):
        with pytest.raises(UserError) as caught:
            toile.register(SAMPLE, tmp_path / "run", **keywords)
        assert str(caught.value) == message
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"frames": 3}, "frames: expected whole numbers of frames, came int"),
        ({"frames": "0-1"}, "frames: expected whole numbers of frames, came str"),
        ({"frames": [0.0]}, "frames: expected whole numbers of frames, came list"),
        ({"workers": "2"}, "workers '2': expected a whole number from 1 on"),
        ({"workers": 0}, "workers 0: expected a whole number from 1 on"),
        ({"shard": "1/2"}, "shard 1/2: expected (i, n) with 1 <= i <= n"),
        ({"shard": (0, 1)}, "shard (0, 1): expected (i, n) with 1 <= i <= n"),
        ({"frame_limit": -1.0}, "frame_limit -1: expected a positive number"),
        ({"frame_limit": float("nan")}, "frame_limit nan: expected a positive number"),
        ({"config": "run/config.toml"}, "config: expected a Config as toile.config.preset gives, came str"),
    ],
)
def test_register_refuses_by_name_an_argument_that_is_none(tmp_path, keywords, message):
    with pytest.raises(UserError) as caught:
        toile.register(SAMPLE, tmp_path / "run", **keywords)
    assert str(caught.value) == message and not (tmp_path / "run").exists()


def test_what_was_asked_for_stands_in_the_run_and_gives_the_same_run_again(monkeypatch, tmp_path):
    asked = {"quality": "draft", "preparation_frames": 1, "dress": {"contact": 0.5}, "segment.views": 3}
    toile.register(SAMPLE, tmp_path / "run", frames=np.zeros(1, np.uint8), **asked)
    saved = tomllib.loads((tmp_path / "run" / "config.toml").read_text())["settings"]
    assert saved["quality"] == "draft" and saved["preparation_frames"] == 1
    assert saved["dress"]["contact"] == 0.5 and saved["segment"]["views"] == 3
    taken = ["--config", tmp_path / "run" / "config.toml", "--frames", "0"]
    assert run_cli(monkeypatch, "register", SAMPLE, tmp_path / "run", *taken) == 0
    assert run_cli(monkeypatch, "register", SAMPLE, tmp_path / "run", *taken, "--set", "dress.contact=0.4") == 0
    saved = tomllib.loads((tmp_path / "run" / "config.toml").read_text())["settings"]
    assert saved["dress"]["contact"] == 0.4 and saved["segment"]["views"] == 3
