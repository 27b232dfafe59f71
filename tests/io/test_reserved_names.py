"""A garment may not take the name of a layer or of an array of the store."""

import shutil
from pathlib import Path

import pytest

from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.scene_file import RESERVED

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    skipped = shutil.ignore_patterns("truth", "00000[1-5]")
    return shutil.copytree(SAMPLE, tmp_path_factory.mktemp("reserved") / "capture", ignore=skipped)


@pytest.mark.parametrize("name", ["track", "inner", "body", "surface", "frames"])
def test_a_reserved_name_is_refused_by_its_field(capture, name):
    text = (SAMPLE / "scene.toml").read_text()
    (capture / "scene.toml").write_text(text.replace('name = "tshirt"', f'name = "{name}"'))
    with pytest.raises(UserError, match=f"scene.toml: garment.0.name: '{name}' is reserved"):
        open_capture(capture)


def test_every_layer_of_a_store_is_reserved(sample_run):
    import zarr

    group = zarr.open_group(str(sample_run / "registered.zarr"), mode="r")
    names = {name for name, _ in group.members()} | {name for name, _ in group["confidence"].members()}
    assert names - {"tshirt"} <= set(RESERVED)
