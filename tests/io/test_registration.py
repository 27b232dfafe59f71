"""What tells one registration of a capture from another."""

import shutil

import pytest
import zarr

from toile.io.registration import registration
from toile.io.run import open_run


def digest(folder, frames=(0, 1, 2, 3)):
    run = open_run(folder)
    return registration(run, frames, [run.track, *run.garments.values()])


def test_a_copy_elsewhere_is_the_same_registration(sample_run, tmp_path):
    assert digest(shutil.copytree(sample_run, tmp_path / "run")) == digest(sample_run)


@pytest.mark.parametrize("array", ["pose/rotations", "pose/translation", "track/vertices", "garment/tshirt/vertices"])
@pytest.mark.parametrize("row", range(4))
def test_one_number_of_one_frame_makes_it_another(sample_run, tmp_path, array, row):
    run = shutil.copytree(sample_run, tmp_path / "run")
    store = zarr.open_group(str(run / "registered.zarr"), mode="r+")
    values = store[array][row]
    values.flat[5 % values.size] += 1e-6
    store[array][row] = values
    assert digest(run) != digest(sample_run)
    others = [frame for frame in range(4) if frame != row]
    assert digest(run, others) == digest(sample_run, others)
