"""What a network calls skin on limbs is cloth where it has other colours than head and hands, or where the scene says so."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.lasting_blobs import WrongPatches, iou_by_label
from toile.config import SegmentSettings
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.measure.inspection.doubts import doubted_on
from toile.measure.truth import open_truth
from toile.scene import Mesh
from toile.stages import segment
from toile.vision.limb_colours import limb_cloth, odd_parts, parts_of

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SKIN, TROUSERS = 1, 4


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def capture():
    return open_capture(SAMPLE)


def called_skin(capture):
    """The first frame as a network might label it that takes all trousers for skin, and its true body."""
    frame = capture.frame(capture.frames[0])
    labels = {name: np.where(of == TROUSERS, SKIN, of).astype(np.uint8) for name, of in frame.labels.items()}
    certainty = {name: np.full(of.shape, 255, np.uint8) for name, of in labels.items()}
    body = Mesh(open_truth(capture).body(frame.number)[0], load_body_model("anny").f)
    return replace(frame, labels=labels, certainty=certainty), body


def found_in(capture, model, frame, body, scene=None, **changes):
    """(SegmentModel, Segmented) of one frame."""
    settings, scene = SegmentSettings(**changes), scene or capture.scene
    made = segment.prepare(scene, capture.cameras, [(frame, body)], model.f, settings, parts_of(model))
    evidence = segment.evidence(frame, capture.cameras, made, body, model.f, settings)
    return made, segment.segment(scene, evidence, made, body, model.f, settings)


def grey(frame):
    mean = {name: of.mean(2, keepdims=True).astype(np.uint8) for name, of in frame.images.items()}
    return replace(frame, images={name: np.repeat(of, 3, 2) for name, of in mean.items()})


def test_trousers_that_a_network_calls_skin_are_found_as_if_it_had_known_them(capture, model):
    frame, body = called_skin(capture)
    made, found = found_in(capture, model, frame, body)
    iou = iou_by_label(capture, open_truth(capture), frame, found)
    assert iou["trousers"] > 0.95 and iou["skin"] > 0.9 and iou["tshirt"] > 0.96, iou
    assert "of the legs 'skin', which is taken for 'trousers': they have other colours" in made.cloth.words(
        capture.scene
    )


def test_label_images_that_somebody_gave_are_never_told_again(capture, model):
    frame, body = called_skin(capture)
    made, _ = found_in(capture, model, replace(frame, certainty={}), body)
    assert made.cloth is None


def test_a_limit_of_nothing_takes_the_networks_word(capture, model):
    frame, body = called_skin(capture)
    made, _ = found_in(capture, model, frame, body, skin_colour=0)
    assert made.cloth is None
    texts = [doubt.text for doubt in doubted_on(capture.scene, model, capture.cameras, [(frame, body.vertices)])]
    assert any("'skin' on the upper legs" in text and text.endswith("is it cloth?") for text in texts)


def test_right_labels_of_a_network_stay(capture, model):
    frame, body = called_skin(capture)
    frame = replace(frame, labels=WrongPatches(capture, 0.0).images(frame.number, list(frame.labels))[0])
    made, _ = found_in(capture, model, frame, body)
    assert made.cloth is None or made.cloth.words(capture.scene) is None
    views = segment.depth_views(frame.labels, capture.cameras, body.vertices, model.f)
    again = segment.believed(frame, views, capture.cameras, made.cloth, body, model.f)
    person = sum(int((of > 0).sum()) for of in frame.labels.values())
    assert sum(int((again.labels[name] != of).sum()) for name, of in frame.labels.items()) < 0.002 * person


def test_bare_legs_of_a_scene_with_shorts_stay_skin_where_colours_are_alike(capture, model):
    frame, body = called_skin(capture)
    scene = replace(capture.scene, labels=capture.scene.labels | {"shorts": 9})
    made, _ = found_in(capture, model, grey(frame), body, scene)
    assert made.cloth is None


def test_the_scenes_trousers_cover_legs_of_the_colours_of_skin(capture, model):
    frame, body = called_skin(capture)
    made, found = found_in(capture, model, grey(frame), body)
    assert made.cloth.colours is None and "but the scene has them worn" in made.cloth.words(capture.scene)
    assert iou_by_label(capture, open_truth(capture), frame, found)["trousers"] > 0.9


def test_a_scene_that_names_nothing_for_the_legs_has_bare_ones(capture, model):
    frame, body = called_skin(capture)
    labels = {name: label for name, label in capture.scene.labels.items() if name != "trousers"}
    views = segment.depth_views(frame.labels, capture.cameras, body.vertices, model.f)
    scene = replace(capture.scene, labels=labels)
    assert limb_cloth(scene, parts_of(model), model.f, [(frame, views)]) is None


def test_colours_are_odd_only_beside_head_or_hands_that_show_enough():
    skin, cloth = (np.tile(np.array(rgb, np.uint8), (100, 1)) for rgb in ([180, 130, 105], [100, 90, 70]))
    shaded = skin // 2
    assert odd_parts({"head": skin, "hands": skin + 4, "upper legs": cloth, "lower legs": shaded}) == ["upper legs"]
    assert odd_parts({"head": skin // 3, "upper legs": cloth // 3}) == ["upper legs"]  # in the dark too
    assert odd_parts({"head": skin[:50], "upper legs": cloth}) == []
    assert odd_parts({"head": skin, "upper legs": cloth[:50]}) == []
    assert odd_parts({"head": cloth, "hands": skin, "upper legs": cloth}) == []
