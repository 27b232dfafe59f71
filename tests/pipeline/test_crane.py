"""A real performance: frame 0 as the body model, the next frames as scans of another connectivity with holes."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from toile.config import preset
from toile.io.capture import open_capture
from toile.io.mesh import read_mesh
from toile.pipeline.plan import plan
from toile.pipeline.run import register

APP = Path(__file__).parents[2] / "apps" / "crane.py"


@pytest.mark.slow(seconds=300)
def test_a_clothed_man_keeps_his_correspondences_over_four_frames(shared_data, tmp_path):
    meshes = sorted((shared_data / "ama_crane").glob("mesh_*.obj"))[:5]
    if not meshes:
        pytest.skip("ama_crane is not there")
    spec = importlib.util.spec_from_file_location("crane", APP)
    crane = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(crane)
    truth = [read_mesh(path) for path in meshes]
    crane.write_capture(tmp_path / "capture", truth, np.random.default_rng(0))
    runs = {step.stage: step.runs for step in plan(open_capture(tmp_path / "capture"))}
    assert runs == {
        "reconstruct": False,
        "track": True,
        "segment": False,
        "dress": False,
        "inner": False,
        "face": False,
    }
    outcome = register(tmp_path / "capture", tmp_path / "run", preset("draft"))
    assert outcome.ok == (1, 2, 3, 4) and not outcome.failed
    assert crane.compare(tmp_path / "run", truth)["correspondence_mm"] < 8
