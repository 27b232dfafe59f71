"""Label images by the scene's network: in memory for `register`, as files by `toile detect --labels`."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from tests.support.segmenters import MAP, by_colour, described
from toile.cli import app
from toile.config import SegmentSettings
from toile.errors import UserError
from toile.io.capture import check_capture, open_capture
from toile.io.image import read_image
from toile.pipeline.plan import plan
from toile.vision.evidence import soft_labels
from toile.vision.segmenters.asked import labelled, scene_segmenter
from toile.vision.segmenters.limbs import limbs_of

SKIN, TROUSERS = 1, 4
SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"


@pytest.fixture
def capture(tmp_path):
    """The bundled capture's first frame without label images but one, and with a network that goes by colour."""
    root = tmp_path / "capture"
    shutil.copytree(SAMPLE, root, ignore=shutil.ignore_patterns("truth", "00*"))
    shutil.copytree(SAMPLE / "frames/000000", root / "frames/000000")
    for path in (root / "frames/000000/labels").glob("*.png"):
        if path.stem != "cam02":
            path.unlink()
    described(by_colour(root / "parts.onnx"), labels=MAP)
    scene = (root / "scene.toml").read_text()
    (root / "scene.toml").write_text(scene.replace('up = "z"', 'up = "z"\nsegmenter = "parts.onnx"'))
    return root


def test_pictures_without_labels_have_the_networks(capture):
    opened = open_capture(capture)
    check_capture(opened, opened.frames)
    given = opened.frame(0)
    frame = labelled(opened, given)
    assert set(frame.labels) == set(frame.images) and set(frame.certainty) == set(frame.images) - {"cam02"}
    assert frame.labels["cam02"] is given.labels["cam02"]
    for name, certainty in frame.certainty.items():
        assert certainty.shape == frame.labels[name].shape and set(np.unique(frame.labels[name])) <= {0, 1, 3, 4}
        assert ((frame.labels[name] > 0) == frame.masks[name]).all()
    again = labelled(opened, given)
    assert all((frame.labels[name] == again.labels[name]).all() for name in frame.labels)
    step = next(step for step in plan(opened) if step.stage == "segment")
    assert step.runs and 'segmenter = "parts.onnx"' in step.why


def test_label_images_are_written_where_there_are_none(capture):
    opened = open_capture(capture)
    meant = labelled(opened, opened.frame(0)).labels
    folder = capture / "frames/000000/labels"
    there = (folder / "cam02.png").read_bytes()
    done = CliRunner().invoke(app, ["detect", str(capture), "--labels", str(capture / "parts.onnx")])
    assert done.exit_code == 0 and f"{len(meant) - 1} label images, 1 were there" in done.output
    assert "are unsure" in done.output and (folder / "cam02.png").read_bytes() == there
    again = CliRunner().invoke(app, ["detect", str(capture), "--labels", str(capture / "parts.onnx")])
    assert again.exit_code == 0 and " 0 label images" in again.output and "unsure" not in again.output
    for name, label in meant.items():
        written = read_image(folder / f"{name}.png", label.shape, "L")
        again = written != label  # legs that were called skin
        assert (label[again] == SKIN).all() and (written[again] == TROUSERS).all() and again.mean() < 0.05


def test_legs_that_a_network_calls_skin_are_written_as_what_covers_them_where_keypoints_pose_the_body(capture):
    described(capture / "parts.onnx", labels={"top": "tshirt", "legs": "skin"})
    shutil.rmtree(capture / "frames/000000/labels")

    def written(*options):
        done = CliRunner().invoke(app, ["detect", str(capture), "--labels", str(capture / "parts.onnx"), *options])
        assert done.exit_code == 0
        shares = []
        for path in sorted((capture / "frames/000000/labels").glob("*.png")):
            given = np.array(Image.open(SAMPLE / "frames/000000/labels" / path.name))
            shares.append((np.array(Image.open(path))[given == TROUSERS] == TROUSERS).mean())
        return done.output, np.mean(shares)

    output, share = written()
    assert "% of the legs 'skin', which is taken for 'trousers'" in output and share > 0.8
    (capture / "frames/000000/keypoints.json").unlink()
    output, share = written("--again")
    assert "taken for" not in output and share == 0


def test_keypoints_tell_where_the_person_is_where_no_mask_does(capture):
    described(capture / "parts.onnx", labels=MAP, person=True)
    shutil.rmtree(capture / "frames/000000/masks")
    opened = open_capture(capture)
    frame, segmenter = opened.frame(0), scene_segmenter(opened)
    limbs = {name: limbs_of(frame.keypoints.names, rows) for name, rows in frame.keypoints.points.items()}
    name = next(name for name in frame.images if limbs[name] is not None and name not in frame.labels)
    meant, _ = segmenter.label(frame.images[name], None, limbs[name])
    assert not np.array_equal(segmenter.label(frame.images[name])[0], meant)
    assert np.array_equal(labelled(opened, frame).labels[name], meant)
    CliRunner().invoke(app, ["detect", str(capture), "--labels", str(capture / "parts.onnx")])
    assert np.array_equal(read_image(capture / f"frames/000000/labels/{name}.png", meant.shape, "L"), meant)


def test_a_capture_whose_network_cannot_serve_is_refused_by_file_and_field(capture):
    described(capture / "parts.onnx", labels={"top": "skin", "legs": "trousers"})
    with pytest.raises(UserError, match="parts.toml: labels: no class is called 'tshirt', the label of garment tshirt"):
        scene_segmenter(open_capture(capture))
    scene = (capture / "scene.toml").read_text()
    for name, says in {
        "parts.exe": "scene.segmenter: 'parts.exe' is neither a packaged network .clothes. nor a .onnx file",
        "other.onnx": "scene.segmenter: no file 'other.onnx' in the capture",
        "../x.onnx": "scene.segmenter: '../x.onnx' leaves the capture",
    }.items():
        (capture / "scene.toml").write_text(scene.replace("parts.onnx", name))
        with pytest.raises(UserError, match=f"scene.toml: {says}"):
            open_capture(capture)
    (capture / "scene.toml").write_text(scene)
    (capture / "parts.toml").unlink()
    (capture / "parts.toml").symlink_to("/etc/hostname")
    with pytest.raises(UserError, match="scene.segmenter: 'parts.toml' leaves the capture"):
        open_capture(capture)


def test_without_a_network_label_images_are_asked_for(capture):
    scene = (capture / "scene.toml").read_text()
    (capture / "scene.toml").write_text(scene.replace('segmenter = "parts.onnx"', ""))
    (capture / "frames/000000/labels/cam02.png").unlink()
    opened = open_capture(capture)
    with pytest.raises(UserError, match=r"needs labels/\*.png, .* segmenter = \"clothes\" under .scene."):
        check_capture(opened, opened.frames)


def test_an_unsure_pixel_votes_less():
    ids, settings = np.array([1, 3, 4], np.uint8), SegmentSettings()
    image = np.full((40, 40), 3, np.uint8)
    votes = [soft_labels(image, ids, settings, np.full((40, 40), sure, np.uint8))[20, 20] for sure in (0, 128, 255)]
    assert np.allclose(votes[0], 1 / 3) and np.allclose(votes[2], [0, 1, 0], atol=1e-6)
    assert np.allclose(votes[2], soft_labels(image, ids, settings)[20, 20])
    assert votes[0][1] < votes[1][1] < votes[2][1] and np.allclose([v.sum() for v in votes], 1, atol=1e-5)
