"""The names that users import: where they are, without torch, and the old places of some of them."""

import subprocess
import sys

import pytest

import toile


def test_every_public_name_is_there_without_torch():
    names = ["open_capture", "open_run", "register", "load_body_model", "read_mesh", "write_mesh", "kernels"]
    code = f"import sys; sys.modules['torch'] = None; import toile; [getattr(toile, n) for n in {names}]"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert set(names) <= set(toile.__all__)


@pytest.mark.parametrize(("module", "name"), [("toile.capture", "open_capture"), ("toile.pipeline", "register")])
def test_the_old_place_of_a_name_gives_the_same_and_warns(module, name):
    code = f"import toile; from {module} import {name}; assert {name} is toile.{name}"
    quiet = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert quiet.returncode == 0, quiet.stderr
    strict = [sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", code]
    refused = subprocess.run(strict, capture_output=True, text=True, timeout=120)
    assert f"use toile.{name}" in refused.stderr


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="toile.*nothing"):
        toile.nothing  # noqa: B018
