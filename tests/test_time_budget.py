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


TESTS = """
import time, pytest
@pytest.mark.slow(seconds=0.2)
def test_a(): time.sleep(2)
@pytest.mark.slow(seconds=0.3)
def test_b(): pass
def test_c(): pass
"""


def test_a_machine_slower_than_the_marks_say_begins_no_test_that_would_end_too_late(tmp_path):
    (tmp_path / "conftest.py").write_text((ROOT / "tests" / "conftest.py").read_text())
    (tmp_path / "test_slow.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = slow\n")
    command = [sys.executable, "-m", "pytest", "-rs", "--time-budget", "4", "-p", "no:cacheprovider"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True).stdout
    assert "2 passed, 1 skipped" in said and "it takes about 3 s" in said  # ten times as long as it says
