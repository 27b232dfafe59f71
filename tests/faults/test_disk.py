"""A disk that takes no more: one line that names the file, exit code 1, and the same command goes on once there is room."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

from toile.errors import UserError
from toile.io.files import output_file, replace_file, write_text

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


def limited(size, *arguments):
    """`toile ARGUMENTS` in a process that may write no file larger than `size` bytes."""
    return subprocess.run(
        [sys.executable, "-m", "toile", *map(str, arguments)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_a_full_disk_is_told_in_one_line_and_leaves_nothing(tmp_path):
    done = limited(20_000, "register", SAMPLE, tmp_path / "run", "--quality", "draft", "--frames", "0")
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert last.startswith(f"toile: {tmp_path / 'run'}") and last.endswith(": File too large")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_written_whole_is_not_there(tmp_path):
    def cut(path):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    write_text(tmp_path / "kept", "whole")
    for name in ("new", "kept"):
        with pytest.raises(OSError, match=f"No space left on device: .*{name}"):
            replace_file(tmp_path / name, cut)
    assert [p.name for p in tmp_path.iterdir()] == ["kept"] and (tmp_path / "kept").read_text() == "whole"


def test_folders_of_an_output_are_made_before_the_work(tmp_path):
    assert output_file(tmp_path / "a" / "b" / "page.html").parent.is_dir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "a", tmp_path / "file" / "page.html", Path("/proc/page.html")):
        with pytest.raises(UserError, match=f"{path}: cannot be written"):
            output_file(path)
