"""What `cmake --install` leaves serves a program that knows nothing of this tree: apps/register_mesh is built and run."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from toile.kernels import SurfaceIndex

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """A tree of its own with what is installed of the build."""
    if not (ROOT / "build" / "CMakeCache.txt").exists():
        pytest.skip("there is no build/ here to install from")
    prefix = tmp_path_factory.mktemp("install") / "prefix"
    run("cmake", "--install", ROOT / "build", "--prefix", prefix)
    return prefix


def run(*command):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_library_its_headers_and_its_package_are_installed_and_nothing_else(prefix):
    files = [path for path in prefix.rglob("*") if path.is_file()]
    kinds = {path.name if path.suffix == ".cmake" else path.suffix for path in files}
    package = {"toileConfig.cmake", "toileConfigVersion.cmake", "toileTargets.cmake", "toileTargets-release.cmake"}
    assert kinds == {".a", ".h", "FindCHOLMOD.cmake"} | package


def test_installed_headers_include_only_what_is_installed_beside_them(prefix):
    headers = sorted((prefix / "include").rglob("*.h"))
    public = {path.name for path in (ROOT / "cpp" / "kernels").glob("*.h") if "_" not in path.stem}
    assert public <= {path.name for path in headers if path.parent.name == "kernels"}
    for header in headers:
        for name in re.findall(r'^#include "(.*)"', header.read_text(), re.M):
            assert (header.parent / name).is_file(), f"{header.name} includes {name}"


def test_a_wheel_takes_the_compiled_module_and_no_header(tmp_path):
    if not (ROOT / "build" / "CMakeCache.txt").exists():
        pytest.skip("there is no build/ here to install from")
    run("cmake", "--install", ROOT / "build", "--prefix", tmp_path, "--component", "python")
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [(path.parent.name, path.name.split(".")[0]) for path in files] == [("toile", "_core")]


@pytest.mark.slow
def test_the_program_of_another_project_registers_a_mesh_to_a_scan(prefix, tmp_path):
    shutil.copytree(ROOT / "apps" / "register_mesh", tmp_path / "source")  # nothing of this tree is in reach
    run("cmake", "-S", tmp_path / "source", "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", tmp_path / "build")
    program = tmp_path / "build" / "register_mesh"

    template, scan = trimesh.creation.icosphere(subdivisions=3), trimesh.creation.icosphere(subdivisions=4)
    scan.vertices = bent(np.array(scan.vertices))
    template.export(tmp_path / "template.obj")
    scan.export(tmp_path / "scan.ply")
    run(program, tmp_path / "template.obj", tmp_path / "scan.ply", tmp_path / "out.obj")
    fitted = trimesh.load(tmp_path / "out.obj", process=False, maintain_order=True)
    assert np.array_equal(fitted.faces, template.faces)
    index = SurfaceIndex(scan.vertices, scan.faces)
    before, after = (index.closest(mesh.vertices)[3].mean() for mesh in (template, fitted))
    assert after < 2e-3 < 3e-2 < before  # of a radius of 1

    (tmp_path / "bad.ply").write_text("ply\n")
    scan.copy().apply_translation([1e3, 0, 0]).export(tmp_path / "far.ply")
    for arguments, message in {
        ("missing.obj", "scan.ply"): "missing.obj: no such file",
        ("template.obj", "bad.ply"): "bad.ply: not a mesh",
        ("template.obj", "far.ply"): "far.ply: the template lies nowhere near the scan",
    }.items():
        files = [str(tmp_path / name) for name in arguments]
        refused = subprocess.run([program, *files, tmp_path / "none.obj"], capture_output=True, text=True, timeout=300)
        assert refused.returncode == 1 and message in refused.stderr and refused.stderr.count("\n") == 1
        assert not (tmp_path / "none.obj").exists()


def bent(V):
    """A smooth bend of a ball of radius 1."""
    x, y, z = V.T
    return np.stack([x + 0.25 * z**2, y + 0.12 * np.sin(2 * z), z - 0.25 * x * z], axis=1)
