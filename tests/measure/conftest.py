"""The capture without a mistake, for the files that plant one."""

import shutil

import pytest

from tests.support.inspected import write_sound_capture


@pytest.fixture(scope="session")
def sound(made_once):
    """See `write_sound_capture`; not to be changed."""
    return made_once("sound", write_sound_capture)


@pytest.fixture
def capture(sound, tmp_path):
    shutil.copytree(sound, tmp_path / "capture")
    return tmp_path / "capture"


@pytest.fixture
def walk(sound, tmp_path):
    """The keypoints of the sound capture alone."""
    shutil.copytree(sound, tmp_path / "capture", ignore=shutil.ignore_patterns("images", "masks", "labels"))
    (tmp_path / "capture" / "scene.toml").write_text('[scene]\nname = "x"\nup = "z"\n')
    return tmp_path / "capture"
