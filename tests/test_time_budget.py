"""Slow tests that do not fit into their time are not begun, and said to be left out."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def slow(seconds):
    """The summary of one file's slow tests, given so much time."""
    command = [sys.executable, "-m", "pytest", "-m", "slow", "-rs", "--time-budget", str(seconds), "--setup-plan"]
    return subprocess.run([*command, "tests/extremes/test_mrf.py"], cwd=ROOT, capture_output=True, text=True)


def test_what_does_not_fit_is_left_out_and_said():
    done = slow(1)
    assert done.returncode == 0
    assert "2 skipped" in done.stdout and "of --time-budget, it takes about 60 s" in done.stdout
    assert "skipped" not in slow(10_000).stdout
