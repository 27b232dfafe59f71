"""The network of labels that comes with toile, on studio pictures of people that it was not trained on."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from toile.cli import app
from toile.errors import UserError
from toile.io.capture import open_capture
from toile.io.facts import facts_of
from toile.io.scene_file import SEGMENTERS
from toile.pipeline.plan import plan
from toile.vision.segmenters.asked import scene_segmenter
from toile.vision.segmenters.network import Segmenter

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-pictures"
LABELS = {"skin": 1, "hair": 2, "tshirt": 3, "trousers": 4, "shoes": 5}
CAMERAS = ("cam00", "cam03", "cam06", "cam09", "cam12", "cam15")


@pytest.fixture(scope="module")
def segmenter():
    return Segmenter(SEGMENTERS["clothes"], LABELS)


@pytest.fixture(scope="module")
def frame():
    return open_capture(SAMPLE).pictures(0)


@pytest.fixture
def capture(tmp_path):
    """The bundled pictures without label images, in a scene that names the packaged network."""
    root = tmp_path / "capture"
    shutil.copytree(SAMPLE, root, ignore=shutil.ignore_patterns("truth", "labels"))
    scene = (root / "scene.toml").read_text()
    (root / "scene.toml").write_text(scene.replace('up = "z"', 'up = "z"\nsegmenter = "clothes"'))
    return root


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


def test_the_packaged_network_is_small_and_knows_its_classes(segmenter):
    assert SEGMENTERS["clothes"].stat().st_size < 3e6
    assert segmenter.about.ids.tolist() == [0, 1, 2, 3, 4, -1, 5] and segmenter.about.person


def test_it_has_a_class_for_every_garment_of_the_studio_and_refuses_two_of_one_class():
    from toile.studio.cut import CUTS
    from toile.studio.segmenter.people import BOTTOMS

    tops = [name for name in CUTS if name not in (*BOTTOMS, "dress")]
    for name in CUTS:
        assert 7 in Segmenter(SEGMENTERS["clothes"], {"skin": 1, name: 7}).about.ids
    for name in set(tops) - {"tank"}:
        with pytest.raises(UserError, match="which of them is not told"):
            Segmenter(SEGMENTERS["clothes"], {"skin": 1, "tank": 2, name: 3})


def test_it_finds_the_clothes_of_a_path_traced_person(segmenter, frame):
    """Measured: 0.83 and 0.69 without masks, 0.81 and 0.83 with them. The label images are wrong on a tenth of the person."""
    alone, masked = [], []
    for name in CAMERAS:
        truth, mask = frame.labels[name], frame.masks[name]
        found, _ = segmenter.label(frame.images[name])
        alone.append([overlap(found > 0, mask), overlap(found == LABELS["tshirt"], truth == LABELS["tshirt"])])
        found, _ = segmenter.label(frame.images[name], mask)
        masked.append(
            [overlap(found == LABELS[garment], truth == LABELS[garment]) for garment in ("tshirt", "trousers")]
        )
    assert np.all(np.mean(alone, 0) > [0.79, 0.64]) and np.all(np.mean(masked, 0) > [0.77, 0.79])


def test_where_it_is_wrong_it_is_less_sure(segmenter, frame):
    right, wrong = [], []
    for name in CAMERAS:
        found, sure = segmenter.label(frame.images[name], frame.masks[name])
        on, truth = frame.masks[name], frame.labels[name]
        same = found == truth
        right.append(sure[on & same].mean() / 255)
        wrong.append(sure[on & ~same].mean() / 255)
    assert np.mean(wrong) < np.mean(right) - 0.07  # measured: 0.78 and 0.89


def test_of_noise_it_is_not_sure(segmenter):
    noise = np.random.default_rng(0).integers(0, 256, (200, 160, 3), np.uint8)
    found, sure = segmenter.label(noise, np.ones(noise.shape[:2], bool))
    assert (found > 0).all() and sure.mean() < 0.7 * 255


def test_a_scene_names_it_and_a_run_depends_on_it(capture):
    opened = open_capture(capture)
    assert scene_segmenter(opened).path == SEGMENTERS["clothes"]
    assert set(facts_of(opened)["segmenter"]) == {"clothes.onnx", "clothes.toml"}
    assert 'segmenter = "clothes"' in next(step for step in plan(opened) if step.stage == "segment").why


def test_detect_writes_its_labels(capture):
    done = CliRunner().invoke(app, ["detect", str(capture), "--labels", "clothes"])
    assert done.exit_code == 0 and "16 label images" in done.output and "are unsure" in done.output


def test_without_onnxruntime_it_is_said_what_to_install(capture, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(UserError, match=r"clothes.onnx: a network needs onnxruntime: pip install 'toile\[detect\]'"):
        Segmenter(SEGMENTERS["clothes"], LABELS)
