"""What the table of the pipeline's extremes calls right, said and silently wrong."""

import numpy as np

from bench import pipeline_captures as make
from bench.pipeline_extremes import row
from toile.io.capture import open_capture

CLEAN = {"ok": 2, "doubtful": {}, "wrong": {}, "failed": {}, "warnings": ["garment tshirt: a"]}
CLEAN |= {"errors": {"surface": 1.0, "cloth": 1.0, "loops": 4.0}}


def found(loops=4.0, **more):
    return CLEAN | {"errors": {"surface": 1.0, "cloth": None, "loops": loops}} | more


def test_an_error_that_nothing_tells_is_silently_wrong_and_one_that_is_told_is_said():
    name = "5 mm noise"
    assert "| right |" in row(name, found(7.0), CLEAN) and "1.0, -, 7.0" in row(name, found(7.0), CLEAN)
    assert "| degraded |" in row(name, found(12.0), CLEAN) and "silently wrong" in row(name, found(30.0), CLEAN)
    told = row(name, found(30.0, doubtful={"1": "why"}), CLEAN)
    assert "| wrong, said | 1 doubtful |" in told
    assert "right, said" in row(name, found(warnings=["garment tshirt: a", "garment tshirt: b"]), CLEAN)
    assert "silently degraded" in row("hands in pockets", found(12.0), CLEAN)  # must be said
    assert "| refused | why |" in row(name, {"refused": "why"}, CLEAN) and "crashed" in row(
        name, {"crashed": ["x"]}, CLEAN
    )


def test_a_world_that_is_turned_keeps_what_its_cameras_see(tmp_path):
    known, capture = open_capture(make.SAMPLE), make.bundled(tmp_path / "capture")
    make.turned("x", 90)(capture)
    turned = open_capture(capture)
    for name, camera in known.cameras.items():
        pixels = [
            c.project(o.frame(0).scan.vertices[:50])[0] for c, o in ((camera, known), (turned.cameras[name], turned))
        ]
        np.testing.assert_allclose(*pixels, atol=1e-2)  # scans are kept in single precision
