"""The whole chain on the bundled capture: what runs, what is stored, and the same bits whatever interrupts it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zarr
from PIL import Image

from tests.support.processes import wait_until
from toile.config import preset
from toile.io.capture import open_capture
from toile.measure.evaluate import evaluate
from toile.pipeline import run as pipeline
from toile.pipeline.plan import plan

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
CONFIG = preset("standard").model_copy(update={"preparation_frames": 2})
FRAMES = (0, 1, 2)


def arrays(run):
    """Every array of a store by its path."""
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    found = {}

    def visit(at, prefix):
        for name, item in at.members():
            if isinstance(item, zarr.Group):
                visit(item, f"{prefix}{name}/")
            else:
                found[f"{prefix}{name}"] = item[...]

    visit(group, "")
    return found


def assert_same_bits(once, twice):
    assert once.keys() == twice.keys()
    for name in (n for n in once if not n.startswith("diagnostics/seconds/")):
        assert np.array_equal(once[name], twice[name], equal_nan=once[name].dtype.kind == "f"), name


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("pipeline") / "run"
    outcome = pipeline.register(SAMPLE, out, CONFIG, FRAMES)
    assert outcome.ok == FRAMES and not outcome.failed
    return out


@pytest.fixture
def bare(tmp_path):
    """The bundled capture with the garment taken out of its scene."""
    capture = tmp_path / "bare"
    shutil.copytree(SAMPLE, capture)
    text = (capture / "scene.toml").read_text()
    start, end = text.index("[[garment]]"), text.index("[cameras]")
    (capture / "scene.toml").write_text(text[:start] + text[end:])
    return capture


def assert_figures(measured):
    shirt, inner, found = measured["garment"]["tshirt"], measured["inner"], measured["evidence"]
    assert (
        measured["joint_mm"] < 5 and measured["track_to_scan_mm"] < 1.2
    )  # a smooth surface, off the scan's flat faces
    assert found["surface_to_scan_mm"]["mean"] < 2.6 and found["scan_to_surface_mm"]["mean"] < 2
    assert measured["label_iou"]["tshirt"] > 0.97
    assert shirt["surface_mm"] < 1.2 and shirt["boundary_all_mm"] < 4
    assert inner["visible_mm"] < 2 and inner["hidden_mm"] < min(4, 0.6 * inner["hidden_model_mm"])
    assert measured["intersections_left"] == 0


def test_register_reaches_its_figures_on_the_bundled_capture(run):
    measured = evaluate(run)["all"]
    assert_figures(measured)
    json.dumps(measured, allow_nan=False)


@pytest.mark.slow
def test_each_loop_lies_within_4_mm_on_average_over_the_whole_capture(tmp_path):
    """Six frames: over the first three alone, which the fast test registers, the mean of the loops is 4.3 mm."""
    assert not pipeline.register(SAMPLE, tmp_path / "run", preset("standard")).failed
    measured = evaluate(tmp_path / "run")["all"]
    assert_figures(measured)
    shirt = measured["garment"]["tshirt"]
    assert np.mean(list(shirt["boundary_mm"].values())) < 4 and shirt["boundary_all_mm"] < 3.3


def test_store_holds_what_the_layout_names(run):
    found = arrays(run)
    n, g = len(found["track/vertices"][0]), len(found["garment/tshirt/vertices"][0])
    assert found["frames"].tolist() == list(FRAMES) and (found["done"] == 1).all()
    assert found["labels"].shape == (3, n) and found["confidence/tshirt"].shape == (3, g)
    assert found["inner/vertices"].shape == (3, n, 3)
    assert found["garment/tshirt/skin"].shape == (g, found["pose/rotations"].shape[1])
    assert np.allclose(found["garment/tshirt/skin"].sum(1), 1)
    for name in ("dress.tshirt/surface_mm", "track/skeleton_rms_m", "inner/intersections_left", "seconds/segment"):
        assert found[f"diagnostics/{name}"].shape == (3,) and np.isfinite(found[f"diagnostics/{name}"]).all(), name
    assert {path.name for path in (run / "work").iterdir()} == {"frames", "smoothed"}


def test_store_is_laid_out_to_the_letter(run):
    group = zarr.open_group(str(run / "registered.zarr"), mode="r")
    n, m, g = 13718, 27420, len(group["garment/tshirt/skin"][:])
    T, K, q = len(FRAMES), 104, group["face"].shape[1]
    layout = {
        "frames": ((T,), "int64"), "done": ((T,), "uint8"), "verdict": ((T,), "uint8"), "identity": ((T,), "uint64"),
        "shape": (group["shape"].shape, "float64"),
        "track/vertices": ((T, n, 3), "float64"), "track/faces": ((m, 3), "int32"),
        "pose/rotations": ((T, K, 3), "float64"), "pose/translation": ((T, 3), "float64"), "face": ((T, q, 3), "float64"),
        "labels": ((T, n), "uint8"), "confidence/track": ((T, n), "uint8"),
        "confidence/tshirt": ((T, g), "uint8"), "confidence/inner": ((T, n), "uint8"),
        "garment/tshirt/vertices": ((T, g, 3), "float64"), "garment/tshirt/skin": ((g, K), "float64"),
        "inner/vertices": ((T, n, 3), "float64"), "inner/faces": ((m, 3), "int32"),
    }  # fmt: skip
    for name, (shape, dtype) in layout.items():
        assert (group[name].shape, str(group[name].dtype)) == (shape, dtype), name
    free = {
        "garment/tshirt/faces",
        "garment/tshirt/uv",
        "garment/tshirt/face_uv",
    }  # as large as the template and its atlas are
    assert {name for name in arrays(run) if not name.startswith("diagnostics/")} == {*layout, *free}
    fixed = {"frames", "shape", "track/faces", "inner/faces", "garment/tshirt/skin"}
    for name in set(layout) - fixed:
        assert group[name].chunks == (1, *layout[name][0][1:]), name
    assert group.metadata.zarr_format == 3
    attributes = group.attrs.asdict()
    assert (
        set(attributes) == {"version", "scene", "joint_names", "body_model", "identity", "holdout"}
        and len(attributes["joint_names"]) == K
    )
    assert [x["name"] for x in attributes["scene"]["garments"]] == ["tshirt"]


def test_a_run_has_its_frames_rising_and_each_once_in_whatever_order_they_are_asked_for(run, tmp_path):
    capture = open_capture(SAMPLE)
    for asked in ([0, 1, 4], [4, 0, 1], [0, 0, 4, 1, 1]):
        assert pipeline._frames(tmp_path / "new", capture, asked) == (0, 1, 4)
        assert pipeline._frames(run, capture, asked) == (0, 1, 2, 4)
    assert pipeline._frames(run, capture, [2, 0, 0]) == FRAMES


def test_a_killed_run_goes_on_with_the_same_bits(run, tmp_path):
    out = tmp_path / "killed"
    code = (
        "import sys; from pathlib import Path; from toile import pipeline; from toile.config import preset;"
        f"pipeline.register(Path({str(SAMPLE)!r}), Path({str(out)!r}), preset('standard').model_copy(update={{'preparation_frames': 2}}), {FRAMES})"
    )
    child = subprocess.Popen([sys.executable, "-c", code])
    wait_until((out / "work" / "frames" / "000000" / "whole").exists, child)
    child.kill()
    child.wait()
    assert not (out / "registered.zarr").exists()
    assert pipeline.register(SAMPLE, out, CONFIG, FRAMES).ok == FRAMES
    assert_same_bits(arrays(run), arrays(out))


def test_a_scene_without_a_garment_runs_neither_segment_dress_nor_inner(bare, tmp_path, monkeypatch):
    steps = {step.stage: step for step in plan(open_capture(bare))}
    assert steps["track"].runs and not any(steps[s].runs for s in ("segment", "dress", "inner"))
    assert "no [[garment]]" in steps["dress"].why
    for module, name in (("segment", "segment"), ("segment", "prepare"), ("dress", "prepare"), ("inner", "Fusion")):
        monkeypatch.setattr(f"toile.stages.{module}.{name}", lambda *_: pytest.fail(f"{module}.{name} ran"))
    pipeline.register(bare, tmp_path / "run", CONFIG, (0,))
    found = arrays(tmp_path / "run")
    assert {name.split("/")[1] for name in found if name.startswith("diagnostics/")} == {"track", "evidence", "seconds"}
    assert {name for name in found if not name.startswith("diagnostics/")} == {
        "frames", "done", "verdict", "identity", "shape", "face", "track/vertices", "track/faces", "pose/rotations", "pose/translation",
        "confidence/track",
    }  # fmt: skip
    stages = {json.loads(line)["stage"] for line in (tmp_path / "run" / "status.jsonl").read_text().splitlines()}
    assert stages == {"reconstruct", "track", "flicker", "motion", "verdict", "store"}


def test_one_bad_frame_is_recorded_and_the_others_finish(bare, tmp_path):
    scan = bare / "frames" / "000003" / "scan.ply"
    scan.write_bytes(scan.read_bytes()[:300])
    outcome = pipeline.register(bare, tmp_path / "run", CONFIG, (0, 3))
    assert outcome.ok == (0,) and "scan.ply" in outcome.failed[3]
    found = arrays(tmp_path / "run")
    assert (
        found["done"].tolist() == [1, 2]
        and found["verdict"].tolist() == [0, 2]
        and np.isnan(found["track/vertices"][1]).all()
    )


def test_a_mask_that_is_empty_where_the_person_is_makes_no_right_frame_wrong_and_is_warned_of(bare, tmp_path):
    for number in (1, 2):
        path = bare / "frames" / f"{number:06d}" / "masks" / "cam02.png"
        Image.fromarray(np.zeros_like(np.asarray(Image.open(path)))).save(path)
    outcome = pipeline.register(bare, tmp_path / "run", preset("draft"), FRAMES)
    assert outcome.ok == FRAMES and not outcome.wrong and not outcome.doubtful
    assert any(text.startswith("masks that are empty") and text.endswith("frames 1-2") for text in outcome.warnings)
