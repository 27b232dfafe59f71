"""The types of the compiled module are those that it has."""

import importlib.resources
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_stub_is_what_would_be_generated_now(tmp_path):
    subprocess.run([sys.executable, ROOT / "tools" / "make-stubs", tmp_path / "_core.pyi"], check=True, timeout=120)
    stub = ROOT / "python" / "toile" / "_core.pyi"
    assert stub.read_text() == (tmp_path / "_core.pyi").read_text(), "stale: run `make stubs`"


def test_type_checkers_find_the_types():
    assert importlib.resources.files("toile").joinpath("py.typed").is_file()
