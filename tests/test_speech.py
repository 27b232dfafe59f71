"""How commands speak: in words or as JSON lines, quiet or verbose, in colours where a terminal reads them."""

import ast
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

from tests.support.command_line import run_cli
from toile import cli, speech
from toile.console import SHELLS, ProgressLines

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "data_samples" / "tshirt-talk"
SILENT = {"settings", "doctor", "completion"}  # commands that log nothing


def all_of_them():
    speech.result("a result", count=3)
    speech.warn("a warning")
    speech.note("a note")
    speech.frame_note(7, "wrong", "lost")
    speech.next_step("report", "a run")


def test_results_are_stdout_and_all_else_is_stderr(capsys):
    all_of_them()
    said = capsys.readouterr()
    assert said.out == "a result\n"
    assert said.err == "  warning: a warning\na note\n  frame 7: wrong: lost\nnext: toile report 'a run'\n"


def test_quiet_leaves_results_warnings_and_frames(capsys):
    speech.speak(quiet=True)
    all_of_them()
    ProgressLines(quiet=True)("track", 1, 2)
    said = capsys.readouterr()
    assert said.out == "a result\n" and said.err == "  warning: a warning\n  frame 7: wrong: lost\n"


def test_of_a_thousand_frames_a_reader_is_told_the_gravest_and_a_machine_all(capsys):
    told = {"failed": {7: "lost"}, "doubtful": {n: "cut off" for n in range(1000)}}
    speech.frame_notes(told)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "  frame 7: lost" and len(lines) == 21 and lines[-1] == "  and 981 more"
    speech.frame_notes({"failed": {7: "lost"}})
    assert capsys.readouterr().err == "  frame 7: lost\n"
    speech.speak(json=True)
    speech.frame_notes(told)
    assert len(capsys.readouterr().out.splitlines()) == 1001


def test_json_is_one_object_a_line_on_stdout_and_nothing_else(capsys):
    speech.speak(json=True)
    all_of_them()
    ProgressLines()("track", 1, 2)
    said = capsys.readouterr()
    lines = [json.loads(line) for line in said.out.splitlines()]
    assert said.err == ""
    assert [line["event"] for line in lines] == ["result", "warning", "note", "frame", "next", "progress"]
    assert lines[0] == {"event": "result", "text": "a result", "count": 3}
    assert lines[3]["frame"] == 7 and lines[3]["verdict"] == "wrong"
    assert (lines[5]["stage"], lines[5]["done"], lines[5]["total"]) == ("track", 1, 2)


def test_numbers_of_arrays_are_numbers_and_what_is_none_is_null(capsys):
    speech.event("result", frame=np.int64(3), error=float("nan"), share=np.float64(0.5), path=Path("run"))
    said = json.loads(capsys.readouterr().out)
    assert said == {"event": "result", "frame": 3, "error": None, "share": 0.5, "path": "run"}
    deep = {"draft": {"p95": np.float32("inf"), "runs": [Path("a"), (float("nan"), True)]}, np.int64(7): np.arange(2)}
    speech.event("result", qualities=deep)
    said = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)["qualities"]
    assert said == {"draft": {"p95": None, "runs": ["a", [None, True]]}, "7": [0, 1]}


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("stream", "environment", "colours"),
    [
        (Terminal, {"TERM": "xterm"}, True),
        (Terminal, {"TERM": "xterm", "NO_COLOR": "1"}, False),
        (Terminal, {"TERM": "dumb"}, False),
        (io.StringIO, {"TERM": "xterm"}, False),
    ],
)
def test_only_a_terminal_gets_colours_and_none_that_asks_for_none(monkeypatch, stream, environment, colours):
    monkeypatch.delenv("NO_COLOR", raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", stream())
    speech.error("no such folder", 1)
    assert sys.stderr.getvalue() == ("\x1b[31mtoile\x1b[0m" if colours else "toile") + ": no such folder\n"


@pytest.mark.parametrize("name", sorted(typer.main.get_command(cli.app).commands))
def test_every_command_has_a_short_help_and_the_manners_of_speech(monkeypatch, capsys, name):
    assert run_cli(monkeypatch, name, "-h") == 0
    said = capsys.readouterr().out
    assert f"Usage: toile {name}" in said
    assert name in SILENT or all(option in said for option in ("--quiet", "--verbose", "--json"))


def test_a_command_speaks_as_it_is_asked_to(monkeypatch, capsys):
    assert run_cli(monkeypatch, "plan", SAMPLE) == 0
    words = capsys.readouterr()
    assert words.err == f"next: toile register {SAMPLE} run\n"
    assert run_cli(monkeypatch, "plan", SAMPLE, "--quiet") == 0
    assert capsys.readouterr() == (words.out, "")
    assert run_cli(monkeypatch, "plan", SAMPLE, "--json") == 0
    said = capsys.readouterr()
    lines = [json.loads(line) for line in said.out.splitlines()]
    assert said.err == "" and "\n".join(line["text"] for line in lines[:-1]) == words.out.strip()
    assert lines[0]["frames"] == [0, 1, 2, 3, 4, 5] and lines[-1]["event"] == "next"


def test_an_error_is_told_to_machines_too_and_verbose_says_where_it_stems_from(monkeypatch, capsys, tmp_path):
    missing = tmp_path / "none"
    assert run_cli(monkeypatch, "plan", missing, "--json") == 1
    said = capsys.readouterr()
    assert json.loads(said.out) == {"event": "error", "text": said.err[len("toile: ") : -1], "exit": 1}
    assert run_cli(monkeypatch, "plan", missing, "--verbose") == 1
    verbose = capsys.readouterr().err
    assert "open_capture" in verbose and verbose.endswith(said.err)


@pytest.mark.parametrize(
    "arguments",
    [
        ("plan", SAMPLE, "--nosuch"),
        ("register", SAMPLE),
        ("evaluate", "none"),
        ("evaluate", "none", "--nosuch"),
        ("status", "none"),
        ("settings", "none"),
        ("nosuch",),
    ],
    ids=lambda arguments: " ".join(map(str, arguments[::2])),
)
def test_with_json_stdout_says_the_error_of_every_command_whichever_part_of_it_raised(monkeypatch, capsys, arguments):
    assert run_cli(monkeypatch, *arguments, "--json") == 1
    said = capsys.readouterr()
    assert json.loads(said.out) == {"event": "error", "text": said.err[len("toile: ") : -1], "exit": 1}


def test_every_next_step_is_a_command():
    named = set()
    for path in (ROOT / "python" / "toile").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "next_step":
                named |= {one.value for one in ast.walk(node.args[0]) if isinstance(one, ast.Constant)}
    assert len(named) > 5 and named <= set(typer.main.get_command(cli.app).commands)


# What a newcomer gets wrong: the argument is named, and what to do next ----------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("registr a b", "No such command 'registr'. Did you mean 'register'? (see toile -h)"),
        ("register", "Missing argument 'capture' (see toile register -h)"),
        ("register a b --qualty x", "No such option: --qualty (Possible options: --quality, --quiet) (see toile register -h)"),
        ("register none run", "none: no such folder; a capture is a folder with scene.toml, cameras.json and frames/"),
        ("register empty run", "empty/scene.toml: the file is missing: the folder is no capture; `toile import` makes one"),
        ("register bare run", "bare/frames: no frames (folders named 000000, 000001, ...)"),
        ("plan file.txt", "file.txt: no such folder; a capture is a folder with scene.toml, cameras.json and frames/"),
        ("inspect none", "none: no such folder"),
        ("evaluate none", "none: no such folder"),
        ("evaluate empty", "empty: no registered.zarr; is it a run of `toile register`?"),
        ("status none", "none: no such folder"),
        ("status empty", "empty/config.toml: the file is missing: the folder holds no run of `toile register` or `toile align`"),
        ("train none avatar", "none: no such folder"),
        ("view file.txt", "file.txt: no such folder; a capture is a folder with scene.toml, cameras.json and frames/"),
        ("import kolmap a b", "toile import kolmap: expected one of opencv, colmap,"),
        ("completion tcsh", "toile completion tcsh: expected bash or zsh or fish"),
    ],
)  # fmt: skip
def test_what_a_newcomer_gets_wrong_is_one_line_that_says_what_to_do(monkeypatch, capsys, tmp_path, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "file.txt").write_text("no capture\n")
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "scene.toml").write_text('[scene]\nname = "bare"\n')
    before = sorted(tmp_path.rglob("*"))
    assert run_cli(monkeypatch, *arguments.split()) == 1
    message = capsys.readouterr()
    assert message.err.startswith(f"toile: {said}") and message.err.count("\n") == 1 and message.out == ""
    assert sorted(tmp_path.rglob("*")) == before


def test_toile_alone_shows_its_help_as_it_stands(monkeypatch, capsys):
    assert run_cli(monkeypatch) == 1
    said = capsys.readouterr()
    assert said.err == "" and "\nCommands:\n" in said.out


# Completion ----------------------------------------------------------------------------------------------------------


def complete(tmp_path, **environment):
    """What `toile` prints when a shell asks what could stand there."""
    program = tmp_path / "toile"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m toile "$@"\n')
    program.chmod(0o755)
    return os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"} | environment


def test_bash_completes_commands_and_options(tmp_path):
    script = """eval "$(toile completion bash)"
    COMP_WORDS=(toile regi); COMP_CWORD=1; _toile_completion toile; echo "${COMPREPLY[@]}"
    COMP_WORDS=(toile register --qua); COMP_CWORD=2; _toile_completion toile; echo "${COMPREPLY[@]}" """
    said = subprocess.run(["bash", "-c", script], capture_output=True, text=True, env=complete(tmp_path), timeout=300)
    assert said.stdout.splitlines() == ["register", "--quality"] and said.stderr == ""


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_completes_commands_and_options(tmp_path):
    script = """toile completion fish | source
    complete -C "toile regi"; complete -C "toile register --qua" """
    said = subprocess.run(["fish", "-c", script], capture_output=True, text=True, env=complete(tmp_path), timeout=300)
    assert [line.split("\t")[0] for line in said.stdout.split("\n") if line] == ["register", "--quality"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh_reads_its_completion_without_a_word(tmp_path):
    script = (
        """autoload -Uz compinit; compinit -u -d "$PWD/dump"; eval "$(toile completion zsh)"; print $_comps[toile]"""
    )
    said = subprocess.run(
        ["zsh", "-f", "-c", script], capture_output=True, text=True, env=complete(tmp_path), cwd=tmp_path, timeout=300
    )
    assert said.stdout.split() == ["_toile_completion"] and said.stderr == ""


@pytest.mark.parametrize(
    ("shell", "asked"),
    [
        ("zsh", {"_TOILE_COMPLETE": "complete_zsh", "_TYPER_COMPLETE_ARGS": "toile regi"}),
        (
            "fish",
            {
                "_TOILE_COMPLETE": "complete_fish",
                "_TYPER_COMPLETE_ARGS": "toile regi",
                "_TYPER_COMPLETE_FISH_ACTION": "get-args",
            },
        ),
    ],
)
def test_what_the_other_shells_ask_is_answered(monkeypatch, capsys, tmp_path, shell, asked):
    assert run_cli(monkeypatch, "completion", shell) == 0
    script = capsys.readouterr().out
    assert shell in SHELLS and all(name in script for name in asked)  # the script asks so
    found = subprocess.run(["toile"], capture_output=True, text=True, env=complete(tmp_path, **asked), timeout=300)
    assert "register" in found.stdout and "report" not in found.stdout and found.returncode == 0
