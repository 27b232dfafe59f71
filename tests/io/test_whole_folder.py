"""A folder of results is there whole or not at all."""

import os
import signal
import subprocess
import sys

import pytest

from tests.support.small_disk import largest_file
from toile.errors import UserError, first_line
from toile.io import files
from toile.io.export.writing import whole_file
from toile.io.files import copy_folder, whole_folder
from toile.io.inputs import files_under
from toile.io.locks import BUSY, at_work


def test_a_folder_is_there_whole_or_not_at_all(tmp_path):
    with pytest.raises(KeyError), whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("half")
        raise KeyError
    assert not list(tmp_path.iterdir())
    with whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("all")
        assert not (tmp_path / "out").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"] and (tmp_path / "out" / "a").read_text() == "all"


def test_a_message_about_the_folder_calls_it_by_its_name(tmp_path):
    with pytest.raises(UserError, match=f"^{tmp_path}/out/a: bad$"), whole_folder(tmp_path / "out") as folder:
        raise UserError(f"{folder / 'a'}: bad")


def test_an_error_of_the_system_calls_the_folder_by_its_name_and_other_files_by_theirs(tmp_path):
    for file, named in (("a", tmp_path / "out" / "a"), (None, tmp_path / "out"), (tmp_path / "b", tmp_path / "b")):
        with pytest.raises(OSError) as raised, whole_folder(tmp_path / "out") as folder:
            raise OSError(28, "No space left on device", file and str(folder / file))
        assert first_line(raised.value) == f"{named}: No space left on device" and raised.value.errno == 28


def test_a_copied_folder_has_the_same_files_and_an_error_names_the_copy(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    for name in ("large", "b/small"):
        (tmp_path / "a" / name).write_bytes(name.encode() * 1000)
    copy_folder(tmp_path / "a", tmp_path / "copy")
    assert {p.relative_to(tmp_path / "copy"): p.read_bytes() for p in files_under(tmp_path / "copy")} == {
        p.relative_to(tmp_path / "a"): p.read_bytes() for p in files_under(tmp_path / "a")
    }
    with largest_file(100), pytest.raises(OSError) as raised:
        copy_folder(tmp_path / "a", tmp_path / "other")
    assert first_line(raised.value) == f"{tmp_path}/other/b/small: File too large"
    assert files_under(tmp_path / "other") == []


def test_of_two_writers_of_one_place_the_first_to_end_wins_and_the_other_is_refused(tmp_path):
    with pytest.raises(UserError, match="out: exists already and is not empty"), whole_folder(tmp_path / "out") as late:
        (late / "a").write_text("late")
        with whole_folder(tmp_path / "out") as first:
            (first / "a").write_text("first")
        assert (late / "a").read_text() == "late"
    assert [p.name for p in tmp_path.iterdir()] == ["out"] and (tmp_path / "out" / "a").read_text() == "first"


def test_a_writer_that_has_just_begun_is_not_taken_for_one_that_was_killed(tmp_path, monkeypatch):
    """Another one begins while the first has made its folder and does not hold it yet."""

    def late(folder, alone, refusal):
        (folder / BUSY).touch()
        files._remove_abandoned(tmp_path / "out")
        return at_work(folder, alone, refusal)

    monkeypatch.setattr(files, "at_work", late)
    with whole_folder(tmp_path / "out") as folder:
        (folder / "a").write_text("all")
    assert (tmp_path / "out" / "a").read_text() == "all" and len(os.listdir(tmp_path)) == 1


@pytest.mark.parametrize("kind", ["whole_folder", "whole_file"])
def test_what_a_killed_writer_leaves_goes_when_the_place_is_written_again_and_what_a_living_one_writes_stays(
    tmp_path, kind
):
    """Also a folder of somebody else's that is only called alike."""
    code = "import os, sys, time; from toile.io.files import whole_folder; from toile.io.export.writing import whole_file\n"
    code += (
        f"from pathlib import Path\nwith {kind}(Path('out')) as part:\n    print('begun', flush=True); time.sleep(60)"
    )
    start = lambda: subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    (tmp_path / ".out.mine.part").mkdir()
    killed, living = start(), start()
    for process in (killed, living):
        assert process.stdout.readline() == "begun\n"
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert len(os.listdir(tmp_path)) == 3
    writer = whole_folder if kind == "whole_folder" else whole_file
    with writer(tmp_path / "out") as part:
        (part / "a" if kind == "whole_folder" else part).write_text("whole")
    try:
        assert len(os.listdir(tmp_path)) == 3 and {".out.mine.part", "out"} < set(os.listdir(tmp_path))
        assert kind == "whole_file" or os.listdir(tmp_path / "out") == ["a"]
    finally:
        living.kill()
        living.communicate()
