import pytest
from PIL import Image

from tests.support.bending_clip import bending_clip
from toile.io.export.source import with_textures


@pytest.fixture
def clip():
    return bending_clip(loose=0.003)


@pytest.fixture
def textured(clip, tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    Image.new("RGB", (8, 8), (200, 10, 10)).save(folder / "t-shirt.png")
    return with_textures(clip, folder)
