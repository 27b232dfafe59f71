"""Captures whose labels lie on the scans: with pictures, and without any camera."""

import numpy as np
import pytest

from tests.support.labelled_scans import labelled_capture
from toile.config import preset
from toile.io.capture import open_capture
from toile.measure.evaluate import evaluate
from toile.pipeline.plan import plan
from toile.pipeline.run import register


def measured(capture, run, frames):
    outcome = register(capture, run, preset("draft"), frames)
    assert outcome.ok == frames and not outcome.failed
    return evaluate(run)["all"]


def assert_registered(figures, boundary):
    shirt = figures["garment"]["tshirt"]
    assert figures["label_iou"]["tshirt"] > 0.95
    assert np.mean(list(shirt["boundary_mm"].values())) < boundary and shirt["surface_mm"] < 2
    assert figures["intersections_left"] == 0


def test_labelled_scans_alone_are_registered_without_camera_picture_or_keypoint(tmp_path):
    capture = labelled_capture(tmp_path / "capture")
    steps = {step.stage: step for step in plan(open_capture(capture))}
    assert steps["segment"].runs and "label of scan.ply" in steps["segment"].why and "*.png" not in steps["segment"].why
    assert not open_capture(capture).cameras and not steps["reconstruct"].runs
    # faces of 17 mm: their exact labels change 7 to 8 mm beside the true border
    assert_registered(measured(capture, tmp_path / "run", (0, 3)), boundary=9)


@pytest.mark.slow
def test_labelled_scans_with_keypoints_are_registered_over_the_whole_capture(tmp_path):
    capture = labelled_capture(tmp_path / "capture", cameras=True)
    figures = measured(capture, tmp_path / "run", (0, 1, 2, 3, 4, 5))
    assert_registered(figures, boundary=9)
    assert figures["joint_mm"] < 5


@pytest.mark.slow
def test_labels_of_scans_and_of_pictures_are_used_together(tmp_path):
    capture = labelled_capture(tmp_path / "capture", pictures=True)
    steps = {step.stage: step.why for step in plan(open_capture(capture))}
    assert "labels/*.png and label of scan.ply" in steps["segment"]
    figures = measured(capture, tmp_path / "run", (0, 1, 2))
    assert_registered(figures, boundary=6)
    assert figures["label_iou"]["tshirt"] > 0.985
