"""A real performance: frame 0 as the body model, the next frames as scans of another connectivity with holes."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from toile.config import preset
from toile.io.capture import open_capture
from toile.io.layout import GOOD
from toile.io.mesh import read_mesh, write_mesh
from toile.io.run import open_run
from toile.pipeline.plan import plan
from toile.pipeline.run import register
from toile.scene import Mesh

APP = Path(__file__).parents[2] / "apps" / "crane.py"


MEAN_MM, MEDIAN_MM = 12, 7  # over 29 frames, asked; 7.3 and 4.0 as the README says


def crane_capture(folder, shared_data, frames):
    """(the app, the meshes of the performance, the capture made of them): frame 0 is the body, the others are scans."""
    paths = sorted((shared_data / "ama_crane").glob("mesh_*.obj"))[:frames]
    if not paths:
        pytest.skip("ama_crane is not there")
    spec = importlib.util.spec_from_file_location("crane", APP)
    crane = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(crane)
    truth = [read_mesh(path) for path in paths]
    crane.write_capture(folder, truth, np.random.default_rng(0))
    return crane, truth


@pytest.mark.slow(seconds=300)
def test_a_clothed_man_keeps_his_correspondences_over_four_frames(shared_data, tmp_path):
    crane, truth = crane_capture(tmp_path / "capture", shared_data, 5)
    runs = {step.stage: step.runs for step in plan(open_capture(tmp_path / "capture"))}
    assert runs == {
        "stereo": False,
        "reconstruct": False,
        "track": True,
        "segment": False,
        "dress": False,
        "prints": False,
        "motion": True,
        "inner": False,
        "face": False,
        "view": False,
    }
    outcome = register(tmp_path / "capture", tmp_path / "run", preset("draft"))
    assert outcome.ok == (1, 2, 3, 4) and not outcome.failed
    assert crane.compare(tmp_path / "run", truth)["correspondence_mm"] < 8


@pytest.mark.slow(seconds=400)
def test_a_clothed_man_keeps_his_correspondences_over_the_whole_performance(shared_data, tmp_path):
    """At `standard` on all frames: hands and a leg go 20 to 30 cm in a frame, and are not lost."""
    crane, truth = crane_capture(tmp_path / "capture", shared_data, None)
    outcome = register(tmp_path / "capture", tmp_path / "run", preset("standard"))
    assert outcome.ok == tuple(range(1, len(truth))) and not outcome.failed and not outcome.wrong
    found = crane.compare(tmp_path / "run", truth)
    assert found["correspondence_mm"] < MEAN_MM and found["median_mm"] < MEDIAN_MM
    assert max(found["per_frame_mm"].values()) < 2 * MEAN_MM
    verdicts = open_run(tmp_path / "run").verdict
    assert np.mean([verdicts[n - 1] == GOOD for n, error in found["per_frame_mm"].items() if error < 10]) >= 0.7


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("degrees", [45, 180])
def test_a_clothed_man_who_faces_elsewhere_keeps_his_correspondences(shared_data, tmp_path, degrees):
    crane, truth = crane_capture(tmp_path / "capture", shared_data, 5)
    turn = Rotation.from_rotvec([0, np.radians(degrees), 0])
    for path in (tmp_path / "capture" / "frames").glob("*/scan.ply"):
        scan = read_mesh(path)
        write_mesh(path, Mesh(scan.vertices @ turn.as_matrix().T + [1, 0, 2], scan.faces))
    turned = [Mesh(mesh.vertices @ turn.as_matrix().T + [1, 0, 2], mesh.faces) for mesh in truth]
    outcome = register(tmp_path / "capture", tmp_path / "run", preset("draft"))
    assert outcome.ok == (1, 2, 3, 4) and not outcome.wrong
    assert crane.compare(tmp_path / "run", turned)["correspondence_mm"] < 8
