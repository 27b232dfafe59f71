"""`--template-from-scan`: a garment without a template is registered with one cut from the capture itself."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.run import open_run
from toile.measure.evaluate import evaluate
from toile.pipeline.run import register

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
ASKED = dict(quality="draft", preparation_frames=2, frames=(0, 3))


class Stopped(Exception):
    pass


@pytest.fixture
def without(tmp_path):
    """The bundled capture, whose garment has no template."""
    capture = shutil.copytree(SAMPLE, tmp_path / "capture")
    shutil.rmtree(capture / "templates")
    scene = capture / "scene.toml"
    scene.write_text(scene.read_text().replace('template = "templates/tshirt.obj"\n', ""))
    return capture


def test_a_garment_without_a_template_is_cut_registered_and_goes_on_after_a_stop(without, tmp_path):
    def stop(stage, done, total):
        if stage.startswith("track"):
            raise Stopped

    asked = dict(ASKED, template_from_scan=["tshirt"])
    with pytest.raises(Stopped):
        register(without, tmp_path / "run", progress=stop, **asked)
    cut = (tmp_path / "run" / "prepared" / "template.tshirt.npz").read_bytes()
    outcome = register(without, tmp_path / "run", **asked)
    assert outcome.ok == (0, 3) and not outcome.failed
    assert (tmp_path / "run" / "prepared" / "template.tshirt.npz").read_bytes() == cut
    run, measured = open_run(tmp_path / "run"), evaluate(tmp_path / "run")["all"]
    assert sorted(run.garments["tshirt"].loops) == ["hem", "neck", "sleeve_left", "sleeve_right"]
    assert run.config["settings"]["template_from_scan"] == ["tshirt"]
    shirt = measured["garment"]["tshirt"]
    assert shirt["surface_mm"] < 1.5 and np.mean(list(shirt["boundary_mm"].values())) < 8
    assert measured["intersections_left"] == 0


def test_a_garment_with_neither_is_refused_with_what_helps(without, tmp_path):
    assert open_capture(without).templates == {}
    with pytest.raises(UserError, match=r"scene.toml: garment.0.template: missing: .*--template-from-scan tshirt"):
        register(without, tmp_path / "run", **ASKED)
    with pytest.raises(UserError, match="template_from_scan coat: the scene names tshirt"):
        register(without, tmp_path / "run", **ASKED, template_from_scan=["coat"])
    assert not (tmp_path / "run").exists()
