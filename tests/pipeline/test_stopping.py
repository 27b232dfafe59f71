"""A signal lets the frame in hand end, and nothing else begins; a second one does not wait."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.pipeline import test_blocks
from toile import cli
from toile.pipeline import stopping
from toile.pipeline.blocks import BlockJob
from toile.pipeline.stopping import Terminated, asked, stoppable

KINDS = {signal.SIGTERM: Terminated, signal.SIGINT: KeyboardInterrupt}


def make(start, number, previous, results):
    """Frame 48 is told to stop in the middle of its work."""
    if number == 48 and start["bad"] != ["once"]:
        os.kill(os.getpid(), start["bad"][0])
        assert asked()
    test_blocks.make({"bad": []}, number, previous, results)


def job_in(folder, bad):
    before = test_blocks.job_in(folder, bad)
    return BlockJob(before.folder, before.results, before.prepare, before.arguments, make, 1, "make")


@pytest.mark.parametrize("number", KINDS, ids=lambda number: number.name)
def test_the_frame_in_hand_ends_and_the_same_call_goes_on(tmp_path, threads, number):
    threads(1)
    handlers = [signal.getsignal(kind) for kind in KINDS]
    job = job_in(tmp_path, bad=[int(number)])
    with pytest.raises(KINDS[number]):
        test_blocks.run(job)
    assert [n for n in test_blocks.FRAMES if job.results.whole(n)] == [47, 48]
    assert not asked() and [signal.getsignal(kind) for kind in KINDS] == handlers
    assert test_blocks.run(job_in(tmp_path, bad=["once"])) == test_blocks.run(test_blocks.job_in(tmp_path / "whole"))


def test_a_command_that_is_terminated_clears_away_what_is_half_made(tmp_path):
    """`kill` of a process that writes a folder."""
    code = "import pathlib, time; from toile.io.files import whole_folder; from toile import cli\n"
    code += "def work():\n    with whole_folder('out'):\n        pathlib.Path('begun').touch(); time.sleep(60)\n"
    code += "cli.app = lambda **_: work()\ncli.main()"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "begun").exists():
        time.sleep(0.05)
        assert process.poll() is None
    process.terminate()
    assert process.communicate(timeout=30)[1].strip().endswith("stopped") and process.returncode == cli.STOPPED
    assert [path.name for path in tmp_path.iterdir()] == ["begun"]


def test_a_second_signal_and_the_end_of_patience_stop_at_once(monkeypatch):
    def twice():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second signal was not heard")

    with pytest.raises(KeyboardInterrupt), stoppable():
        twice()
    monkeypatch.setattr(stopping, "PATIENCE", 0.01)
    with pytest.raises(Terminated), stoppable():
        os.kill(os.getpid(), signal.SIGTERM)
        signal.sigtimedwait([], 5)
        pytest.fail("patience did not end")
