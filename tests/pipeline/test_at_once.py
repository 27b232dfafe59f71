"""Two processes that begin a run at the same moment, and what is left of one that was removed meanwhile."""

import time
import tomllib
from pathlib import Path
from threading import Thread, current_thread

import pytest

from toile.errors import UserError
from toile.pipeline import run as pipeline

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


class Worked(Exception):
    """In place of the work."""


def test_of_two_that_ask_for_different_things_one_is_refused_and_clears_nothing_away(tmp_path, monkeypatch):
    run, real, ends, kept = tmp_path / "run", pipeline.request_of, {}, []

    def ask(quality):
        try:
            pipeline.register(SAMPLE, run, frames=[0], quality=quality)
        except Exception as error:
            ends[quality] = error

    other = Thread(target=ask, args=("draft",))

    def request_of(*given):
        request = real(*given)
        if other.ident is None:
            other.start()
            time.sleep(2.0)  # by then it waits for the lock
        return request

    def run_job(*_):
        if current_thread() is not other:
            other.join()
            kept.append(tomllib.loads((run / "config.toml").read_text())["settings"]["quality"])
        raise Worked

    monkeypatch.setattr(pipeline, "request_of", request_of)
    monkeypatch.setattr(pipeline, "run_job", run_job)
    ask("standard")
    assert isinstance(ends["standard"], Worked) and kept == ["standard"]
    assert isinstance(ends["draft"], UserError) and "another process works at it, and something else is" in str(
        ends["draft"]
    )


def test_what_a_run_made_after_it_was_removed_is_named_as_what_to_remove(tmp_path):
    run = tmp_path / "run"
    (run / "work" / "frames").mkdir(parents=True)
    (run / "status.jsonl").write_text("")
    with pytest.raises(UserError, match=r"run: holds no run, but what one left .*: remove status\.jsonl, work there"):
        pipeline.register(SAMPLE, run)
    (run / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match=r"run: the folder is not empty and holds no run"):
        pipeline.register(SAMPLE, run)
