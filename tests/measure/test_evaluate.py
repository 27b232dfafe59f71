"""evaluate on a run whose errors are known, because it is made of the truth."""

import shutil

import numpy as np
import pytest
import zarr

from tests.support.synthetic_run import copy_capture, true_run
from toile.errors import UserError
from toile.measure.evaluate import evaluate


@pytest.fixture
def made(tmp_path):
    capture = copy_capture(tmp_path)
    return capture, true_run(capture, tmp_path)


def test_truth_as_a_run_has_no_error_where_the_measure_is_exact(made):
    all_ = evaluate(made[1])["all"]
    shirt = all_["garment"]["tshirt"]
    assert all_["joint_mm"] < 1e-6
    assert max(shirt["correspondence_mm"], shirt["jitter_mm"]) < 1e-6
    assert shirt["surface_mm"] < 1e-3
    assert len(shirt["boundary_mm"]) == 4 and max(shirt["boundary_mm"].values()) < 5
    assert max(all_["inner"].values()) < 1e-3
    assert all_["track_to_scan_mm"] < 5
    assert all_["label_iou"]["tshirt"] > 0.9


def test_garment_shifted_by_5_mm_is_5_mm_off_without_jitter(made):
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    store["garment/tshirt/vertices"][:] = store["garment/tshirt/vertices"][:] + np.array([0.005, 0, 0])
    shirt = evaluate(made[1])["all"]["garment"]["tshirt"]
    assert shirt["correspondence_mm"] == pytest.approx(5, abs=1e-6)
    assert 0.5 < shirt["surface_mm"] < 5
    assert shirt["jitter_mm"] < 1e-6


def test_measures_are_null_without_truth(made):
    shutil.rmtree(made[0] / "truth")
    all_ = evaluate(made[1])["all"]
    assert all_["joint_mm"] is None and all_["label_iou"] is None
    assert set(all_["garment"]["tshirt"].values()) == {None}
    assert all_["track_to_scan_mm"] is not None


def test_frames_beyond_the_truth_leave_the_means_of_the_others(made):
    whole = evaluate(made[1])
    frames = zarr.open_group(str(made[0] / "truth" / "truth.zarr"), mode="r+")["frames"]
    frames[-1] = 1000
    cut = evaluate(made[1])
    assert cut["per_frame"][-1]["label_iou"] is None
    for name in ("label_iou", "inner"):
        known = [f[name] for f in whole["per_frame"][:-1]]
        for key, value in cut["all"][name].items():
            numbers = [k[key] for k in known if k[key] is not None]
            assert value == (pytest.approx(np.mean(numbers)) if numbers else None)


def test_failed_frames_are_left_out(made):
    done = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")["done"]
    done[0] = 2
    result = evaluate(made[1])
    assert len(result["per_frame"]) == done.shape[0] - 1 and result["all"]["frames_failed"] == 1


def test_measures_are_null_where_every_frame_failed(made):
    whole = evaluate(made[1])["all"]
    zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")["done"][:] = 2
    empty = evaluate(made[1])["all"]
    assert empty.keys() == whole.keys() and empty["frames_ok"] == 0
    assert empty["joint_mm"] is None and empty["garment"]["tshirt"].keys() == whole["garment"]["tshirt"].keys()


def test_a_loop_on_another_loops_rim_is_not_on_its_own(made):
    store = zarr.open_group(str(made[1] / "registered.zarr"), mode="r+")
    loops = store.attrs["scene"]["garments"][0]["loops"]
    hem, other = list(loops.values())[:2]
    vertices = store["garment/tshirt/vertices"][:]
    vertices[:, hem] = vertices[:, np.resize(other, len(hem))]
    store["garment/tshirt/vertices"][:] = vertices
    boundary = evaluate(made[1])["all"]["garment"]["tshirt"]["boundary_mm"]
    assert boundary["loop0"] > 100 and boundary["loop1"] < 5


def test_a_garment_that_the_truth_lacks_is_named(made):
    shutil.rmtree(made[0] / "truth" / "truth.zarr" / "garment")
    with pytest.raises(UserError, match="garment/tshirt"):
        evaluate(made[1])
