"""The command line: units stand in every help, bad options are named, a stop says how to go on."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from tests.support.command_line import run_cli
from tests.support.processes import PATIENCE, hears_ctrl_c, wait_until
from toile import cli

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def commands(monkeypatch, capsys):
    run_cli(monkeypatch, "--help")  # registers all
    capsys.readouterr()
    return typer.main.get_command(cli.app).commands


def test_every_help_shows_its_units(monkeypatch, capsys):
    units = 0
    for name, command in commands(monkeypatch, capsys).items():
        assert run_cli(monkeypatch, name, "--help") == 0
        shown = " ".join(capsys.readouterr().out.split())
        for parameter in command.params:
            for unit in re.findall(r"\[[^\]]*\]", parameter.help or ""):
                assert unit in shown, f"toile {name} --help: {parameter.name} lost its {unit}"
                units += 1
    assert units >= 5


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--frames", "5-1"], "--frames 5-1: '5-1' runs backwards"),
        (["--frames", "1-"], "--frames 1-: '1-' is not a number or a range"),
        (["--frames", "-3"], "--frames -3"),
        (["--frames", ""], "--frames"),
        (["--frames", "²"], "--frames ²"),
        (["--frames", "9" * 5000], "six digits"),
        (["--frames", "100-200"], "--frames 100-200: none of them is there"),
        (["--workers", "0"], "--workers"),
        (["--workers", "-1"], "--workers"),
        (["--workers", "1000000"], "--workers"),
        (["--step", "0"], "--step"),
        (["--budget", "-1"], "--budget -1: expected a positive number"),
        (["--budget", "nan"], "--budget nan: expected a positive number"),
        (["--budget", "inf"], "--budget inf: expected a positive number"),
        (["--shard", "3/2"], "--shard 3/2"),
        (["--shard", "1/" + "9" * 5000], "--shard"),
        (["--quality", "best"], "best"),
        (["--retry", "all"], "--retry all: expected failed, wrong, worst:N or frame numbers"),
        (["--retry", "worst:0"], "--retry worst:0"),
        (["--retry", "1-x"], "--retry 1-x"),
        (["--frame-limit", "0"], "--frame-limit 0: expected a positive number"),
    ],
    ids=lambda value: " ".join(value)[:24] if isinstance(value, list) else "",
)
def test_a_bad_option_is_named(monkeypatch, capsys, tmp_path, options, said):
    assert run_cli(monkeypatch, "register", SAMPLE, tmp_path / "run", *options) == 1
    message = capsys.readouterr().err.strip()
    assert len(message.splitlines()) == 1 and said in message and len(message) < 1100
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["animate", "a", "b", "c", "--physics", "--no-physics"],
            "--physics/--no-physics: given 2 times, expected once",
        ),
        (["animate", "a", "b", "c", "--as-given", "--apart"], "--apart/--as-given: given 2 times"),
        (["evaluate", "a", "--driven", "--no-physics", "--physics"], "--physics/--no-physics: given 2 times"),
        (["train", "a", "b", "--align", "--no-align"], "--align/--no-align: given 2 times"),
        (["register", "a", "b", "--frames", "1", "--frames=2"], "--frames: given 2 times"),
        (["register", "a", "b", "--moved", "--check"], "--moved: --check is given too"),
        (["import", "colmap", "a", "b", "--cropped", "--scaled"], "--cropped: --scaled is given too"),
        (["studio", "a", "--no-garment", "--garment", "cut"], "--no-garment: --garment cut is given too"),
        (["studio", "a", "--no-garment", "--wear", "dress"], "--no-garment: --wear dress is given too"),
        (["studio", "a", "--trousers", "--wear", "dress"], "--trousers: --wear dress is given too"),
    ],
    ids=lambda value: " ".join(value[-2:]) if isinstance(value, list) else "",
)
def test_options_that_contradict_are_one_line_and_nothing_is_made(monkeypatch, capsys, tmp_path, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert run_cli(monkeypatch, *arguments) == 1
    message = capsys.readouterr().err.strip()
    assert len(message.splitlines()) == 1 and said in message and not list(tmp_path.iterdir())


def test_options_that_may_be_repeated_still_may_be(monkeypatch, capsys, tmp_path):
    twice = "--set", "frames=1", "--set", "cameras=0"
    assert run_cli(monkeypatch, "studio", tmp_path / "capture", *twice) == 1
    assert "given" not in capsys.readouterr().err


@pytest.mark.parametrize("fps", ["inf", "nan", "-1", "0", "1e300"])
def test_frames_a_second_that_are_none_name_their_field(monkeypatch, capsys, tmp_path, fps):
    (tmp_path / "scene.toml").write_text((SAMPLE / "scene.toml").read_text().replace("fps = 30", f"fps = {fps}"))
    assert run_cli(monkeypatch, "plan", tmp_path) == 1
    assert "scene.toml: scene.fps: " in capsys.readouterr().err


def test_ctrl_c_stops_with_one_line_that_says_how_to_go_on(tmp_path):
    arguments = ["register", str(SAMPLE), str(tmp_path / "run"), "--quality", "draft", "--workers", "2"]
    program = [sys.executable, "-m", "toile", *arguments]
    with open(tmp_path / "said", "w") as said:
        child = subprocess.Popen(program, stderr=said, stdout=said, start_new_session=True, preexec_fn=hears_ctrl_c)
        wait_until((tmp_path / "run" / "config.toml").exists, child)
        os.killpg(child.pid, signal.SIGINT)
        assert child.wait(PATIENCE) == 130
    last = (tmp_path / "said").read_text().strip().splitlines()[-1]
    assert last == f"toile: stopped; go on with: toile {' '.join(arguments)}"
    assert "Traceback" not in (tmp_path / "said").read_text()
