"""A disk that takes no more: one line that names the file, exit code 1, and the same command goes on once there is room."""

import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.random_kills import differing
from tests.support.mounts import mounted, read_only, resized
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


SETTINGS = "--quality", "draft", "--set", "preparation_frames=1", "--frames", "0,3"  # no temporal state between them


def toile(*arguments):
    command = [sys.executable, "-m", "toile", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


def kib(folder):
    """What the files of a folder take of a tmpfs."""
    return sum(4 * -(-path.lstat().st_size // 4096) for path in folder.rglob("*") if path.is_file())


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    run = tmp_path_factory.mktemp("disk") / "run"
    assert toile("register", SAMPLE, run, *SETTINGS).returncode == 0
    return run


@pytest.mark.slow(seconds=60)
def test_a_file_system_that_is_full_again_and_again_loses_nothing(undisturbed, tmp_path):
    """A tmpfs that has room for a share of the run; more each time, then for all but half of the store."""
    needed, store = kib(undisturbed), kib(undisturbed / "registered.zarr")
    with mounted(tmp_path / "small", "-t", "tmpfs", "-o", "size=100k", "none") as folder:
        run, filler, found = folder / "run", folder / "filler", []
        for share in (0.05, 0.4, 0.8):
            resized(folder, int(share * needed))
            found.append(refused(run, "No space left on device"))
        resized(folder, 10 * needed)  # what the fusion gathers for a while is larger than the run
        whole(undisturbed, run)
        shutil.rmtree(run / "registered.zarr")
        filler.write_bytes(bytes(1024 * (9 * needed + store // 2)))
        found.append(refused(run, "No space left on device"))
        filler.unlink()
        whole(undisturbed, run)
    assert found[0].parts[0] == "prepared" and found[-1].parts[0] == "registered.zarr"


def refused(run, reason):
    """The file of the run that cannot be written for this reason, as one line says."""
    done = toile("register", SAMPLE, run, *SETTINGS)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 1 and "Traceback" not in done.stderr and f": {reason}" in last
    return Path(last.split(": ")[1]).relative_to(run)


def whole(undisturbed, run):
    """The same command goes on to the same bits."""
    done = toile("register", SAMPLE, run, *SETTINGS)
    assert done.returncode == 0, done.stderr
    assert differing(undisturbed, run) == []


@pytest.mark.slow(seconds=30)
def test_a_run_that_is_read_only_is_read_and_refuses_new_results_in_one_line(undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "bound" / "run")
    with mounted(tmp_path / "bound", "--bind", tmp_path / "bound") as folder:
        read_only(folder)
        run = folder / "run"
        for command in (["status", run], ["evaluate", run], ["export", run, tmp_path / "out.npz", "--format", "npz"]):
            assert toile(*command).returncode == 0, command
        for command, named in (
            (["register", SAMPLE, folder / "new"], folder / "new"),
            (["register", SAMPLE, run], run / ".lock"),
            (["report", run], run / "report.html"),
            (["align", run, folder / "aligned"], folder / "aligned"),
        ):
            done = toile(*command)
            assert done.returncode == 1 and "Traceback" not in done.stderr
            last = done.stderr.strip().splitlines()[-1]
            assert last.startswith(f"toile: {named}: ") and last.endswith("Read-only file system")
    assert differing(undisturbed, tmp_path / "bound" / "run") == []
