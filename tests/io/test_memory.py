"""Free memory is the machine's, or what is left of what a container is held to, whichever is less."""

import pytest

from toile.io import memory


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """Says 3 GiB free of 8; files of its group are written by the tests."""
    (tmp_path / "meminfo").write_text("MemTotal:  8388608 kB\nMemAvailable:  3145728 kB\n")
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "GROUP", tmp_path)
    return tmp_path


def test_a_machine_without_limits_gives_what_it_has(machine):
    assert memory.free_memory() == 3 * 2**30 and memory.memory_limit() is None
    (machine / "memory.max").write_text("max\n")
    (machine / "memory.current").write_text("12345\n")
    assert memory.free_memory() == 3 * 2**30


@pytest.mark.parametrize(("held", "taken", "free"), [(4, 3, 1), (4, 5, 0), (8, 1, 3)])
def test_a_container_gives_what_is_left_of_its_limit(machine, held, taken, free):
    (machine / "memory.max").write_text(f"{held * 2**30}\n")
    (machine / "memory.current").write_text(f"{taken * 2**30}\n")
    assert memory.free_memory() == free * 2**30


def test_files_that_a_container_has_read_are_no_memory_that_is_taken(machine):
    (machine / "memory.max").write_text(f"{2 * 2**30}\n")
    (machine / "memory.current").write_text(f"{2 * 2**30}\n")
    (machine / "memory.stat").write_text(f"anon 7\ninactive_file {2**29}\nactive_file {2**29}\nslab 9\n")
    assert memory.free_memory() == 2**30


def test_where_nothing_tells_nothing_is_said(machine):
    (machine / "meminfo").unlink()
    assert memory.free_memory() is None and memory.machine_memory() == {}


def test_what_a_solver_needs_grows_with_pictures_and_masks():
    import numpy as np

    from toile.kernels.stereo import memory_of

    camera = lambda h, w: type("Camera", (), {"height": h, "width": w})()
    empty, full = np.zeros((10, 20), bool), np.ones((10, 20), bool)
    assert memory_of([camera(10, 20)] * 2, [empty, full]) == 2 * 200 * 26 + 400 * 17 + 200 * 44
    assert memory_of([camera(10, 20), camera(20, 10)], [empty, empty.T]) == 2 * 400 * 26 + 400 * 17
