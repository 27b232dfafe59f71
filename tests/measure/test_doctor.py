"""`toile doctor` and `toile --version`."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

from toile import __version__, kernels
from toile.measure.doctor import checks
from toile.measure.doctor.machine import machine, packages, programs

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", checks.CHECKS)
def test_every_kernel_agrees_with_its_reference(name, monkeypatch):
    monkeypatch.setattr(checks, "CHECKS", {name: checks.CHECKS[name]})
    (found,) = checks.check_kernels()
    assert found.sound, found


def test_every_kernel_that_the_readme_names_is_tried():
    named = re.search(r"^The kernels: (.*?)\.\s+Their solvers", (ROOT / "README.md").read_text(), re.M | re.S)[1]
    names = set(re.findall(r"`(\w+)`", named))
    assert len(names) >= 10 and names <= set(checks.CHECKS)


def test_a_kernel_that_is_off_or_breaks_is_told(monkeypatch):
    right = kernels.cheapest_path
    monkeypatch.setattr(checks, "CHECKS", {n: checks.CHECKS[n] for n in ("cheapest_path", "bilinear")})
    monkeypatch.setattr(kernels, "cheapest_path", lambda cost, step: right(step[:1].repeat(6, 0), step))
    monkeypatch.setattr(kernels, "bilinear", lambda *_: 1 / 0)
    off, broken = checks.check_kernels()
    assert not off.sound and off.error > 0.01
    assert not broken.sound and broken.said == "ZeroDivisionError: division by zero"


def test_the_machine_and_the_packages_are_named():
    found = machine()
    assert "threads" in found["cores"] and "GiB" in found["memory"] and "GiB free" in found["disk"] and found["GPU"]
    assert found["python"] == ".".join(map(str, sys.version_info[:3]))
    assert set(programs()) == {"chromium", "blender", "node"}
    versions = {name: version for name, version, extra in packages() if not extra}
    assert versions["numpy"] and versions["zarr"]


def test_a_source_tree_that_is_not_installed_has_no_packages(monkeypatch):
    def unknown(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", unknown)
    assert list(packages()) == []


def test_the_version_is_said():
    said = subprocess.run([sys.executable, "-m", "toile", "--version"], capture_output=True, text=True)
    assert (said.returncode, said.stdout.strip()) == (0, f"toile {__version__}")


def test_what_another_system_needs_is_not_asked_for_here(monkeypatch):
    asked = [
        "numpy>=2",
        "here; sys_platform != 'nowhere' and extra == 'studio'",
        "there; sys_platform == 'nowhere' and extra == 'studio'",
    ]
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: asked)
    assert [(name, extra) for name, _, extra in packages()] == [("numpy", ""), ("here", "studio")]
