"""Networks of labels in ONNX files: small graphs whose answers are known are made by onnx's own library."""

import json

import cv2
import numpy as np
import pytest

from tests.support.segmenters import CLASSES, MAP, SIZE, by_colour, constant, described, graph
from toile.errors import UserError
from toile.vision.segmenters.limbs import SeenLimbs
from toile.vision.segmenters.network import Segmenter

LABELS = {"skin": 1, "tshirt": 3, "trousers": 7}


def quarters(height, width):
    """A picture black, red, green and blue in its quarters, and the labels that are meant."""
    picture, labels = np.zeros((height, width, 3), np.uint8), np.zeros((height, width), np.uint8)
    h, w = height // 2, width // 2
    for box, channel, label in (
        ((slice(h), slice(w, None)), 0, 3),
        ((slice(h, None), slice(w)), 1, 7),
        ((slice(h, None), slice(w, None)), 2, 1),
    ):
        picture[(*box, channel)] = 255
        labels[box] = label
    return picture, labels


@pytest.mark.parametrize("size, stride", [(SIZE, 1), ((32, 32), 4), (("h", "w"), 1)])
def test_every_pixel_has_the_label_of_its_colour(tmp_path, size, stride):
    path = described(by_colour(tmp_path / "a.onnx", size, stride=stride), size=None if size[0] != "h" else [32, 32])
    picture, meant = quarters(96, 120)
    label, sure = Segmenter(path, LABELS).label(picture)
    inner = np.ones(meant.shape, bool)
    inner[48 - 12 : 48 + 12], inner[:, 60 - 15 : 60 + 15] = False, False  # one pixel of the coarsest network
    assert (label == meant)[inner].all() and label.dtype == sure.dtype == np.uint8
    assert (sure[inner] > 250).all()


def test_what_the_network_doubts_is_not_sure(tmp_path):
    picture = np.full((96, 64, 3), [255, 230, 0], np.uint8)
    sure = {}
    for sharp in (5.0, 60.0):
        label, certainty = Segmenter(described(by_colour(tmp_path / "a.onnx", sharp=sharp)), LABELS).label(picture)
        odds = np.exp(sharp * np.array([0.5, 1, 230 / 255, 0]))
        assert (label == 3).all() and np.abs(certainty / 255.0 - odds[1] / odds.sum()).max() < 0.01
        sure[sharp] = certainty.mean()
    assert sure[5.0] < 0.6 * sure[60.0]

    from onnx import TensorProto, helper

    nodes = [constant("w", 9 * np.concatenate([np.zeros((1, 3)), np.eye(3)])[..., None, None].astype(np.float32))]
    nodes.append(constant("b", np.array([4.0, 0, 0, 0], np.float32)))
    nodes.append(helper.make_node("Conv", ["image", "w", "b"], ["logits"]))
    nodes.append(helper.make_node("ArgMax", ["logits"], ["labels"], axis=1, keepdims=0))
    graph(tmp_path / "a.onnx", nodes, {"labels": ["n", "h", "w"]}, kind=TensorProto.INT64)
    picture, meant = quarters(*SIZE)
    label, sure = Segmenter(described(tmp_path / "a.onnx"), LABELS).label(picture)
    assert (label == meant).all() and (sure == 255).all()
    label, _ = Segmenter(described(tmp_path / "a.onnx", channels="bgr"), LABELS).label(picture)
    assert (label == np.where(meant == 7, 7, np.where(meant == 3, 1, np.where(meant == 1, 3, 0)))).all()


def test_a_mask_is_kept_to(tmp_path):
    picture, meant = quarters(96, 64)
    mask = np.zeros(meant.shape, bool)
    mask[20:80, 20:50] = True
    segmenter = Segmenter(described(by_colour(tmp_path / "a.onnx")), LABELS)
    label, sure = segmenter.label(picture, mask)
    assert ((label > 0) == mask).all() and (sure[~mask] == 255).all()
    inside = mask & (meant > 0)
    inside[46:50], inside[:, 30:34] = False, False
    assert (label == meant)[inside].all()


def test_what_is_off_a_mask_is_shown_as_the_mean_to_a_network_that_wants_that(tmp_path):
    picture, _ = quarters(96, 64)
    mask = np.zeros(picture.shape[:2], bool)
    mask[20:80, 20:50] = True
    grey = np.where(mask[..., None], picture, np.uint8(90))  # as the mean
    path = described(by_colour(tmp_path / "a.onnx"), mean=[90, 90, 90])
    plain, whole = Segmenter(path, LABELS), np.array([0.0, 0, 64, 96])
    seen = plain.shares(grey, whole)
    blanking = Segmenter(described(path, mean=[90, 90, 90], blank=True), LABELS)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((7, 7))) + cv2.erode((~mask).astype(np.uint8), np.ones((7, 7))) > 0
    assert np.abs(blanking.shares(picture, whole, mask) - seen)[inner].max() < 1e-3
    assert np.abs(plain.shares(picture, whole, mask) - seen)[inner & ~mask].max() > 0.3
    assert np.array_equal(blanking.shares(picture, whole), plain.shares(picture, whole))


def test_a_network_that_looks_at_the_mirrored_picture_too_gives_the_mean_of_both(tmp_path):
    """This one calls every left half a top, whatever it sees: with its mirrored answer it is of two minds."""
    from onnx import helper

    half = np.zeros((1, 4, *SIZE), np.float32)
    half[:, 1, :, : SIZE[1] // 2] = half[:, 2, :, SIZE[1] // 2 :] = 9.0
    nodes = [
        constant("w", np.zeros((4, 3, 1, 1), np.float32)),
        constant("half", half),
        helper.make_node("Conv", ["image", "w"], ["nothing"]),
        helper.make_node("Add", ["nothing", "half"], ["logits"]),
    ]
    path, picture = graph(tmp_path / "a.onnx", nodes, {"logits": ["n", 4, *SIZE]}), np.zeros((*SIZE, 3), np.uint8)
    _, once = Segmenter(described(path), LABELS).label(picture)
    _, twice = Segmenter(described(path, mirror=True), LABELS).label(picture)
    inner = np.abs(np.arange(SIZE[1]) - SIZE[1] / 2) > 2
    assert (once[:, inner] > 250).all() and np.abs(twice[:, inner] / 255.0 - 0.5).max() < 0.01


def test_a_person_in_a_corner_is_looked_at_closely(tmp_path):
    """What is thinner than the network's pixels in the whole picture is seen in the person's box."""
    picture = np.zeros((400, 400, 3), np.uint8)
    picture[40:88, 30:62] = [255, 0, 0]
    picture[62:64, 30:62] = [0, 255, 0]
    meant = np.where(picture[..., 0] > 0, 3, np.where(picture[..., 1] > 0, 7, 0))
    wrong = {}
    for person in (False, True):
        path = described(by_colour(tmp_path / "a.onnx", (48, 48)), person=person, fit="letterbox")
        wrong[person] = (Segmenter(path, LABELS).label(picture)[0] != meant).sum()
    assert wrong[True] < 100 < wrong[False]


def test_of_two_apart_the_larger_is_the_person(tmp_path):
    picture = np.zeros((96, 96, 3), np.uint8)
    picture[10:80, 10:50], picture[30:50, 60:80] = [255, 0, 0], [255, 0, 0]
    found = {}
    for person in (False, True):
        path = described(by_colour(tmp_path / "a.onnx", (96, 96)), person=person, fit="letterbox")
        found[person], sure = Segmenter(path, LABELS).label(picture)
    assert (found[False][35:45, 62:70] == 3).all() and (found[False][15:75, 15:45] == 3).all()
    assert (found[True][35:45, 62:70] == 0).all() and (found[True][15:75, 15:45] == 3).all()
    assert (sure[35:45, 62:70] < 10).all() and (sure[15:75, 15:45] > 250).all()
    mask = np.ones((96, 96), bool)
    assert (Segmenter(path, LABELS).label(picture, mask)[0][35:45, 62:70] == 3).all()  # a mask says who is meant


def test_without_a_mask_the_whole_picture_and_the_persons_box_are_averaged(tmp_path):
    picture = np.zeros((400, 400, 3), np.uint8)
    picture[40:88, 30:62] = [255, 0, 0]
    path = described(by_colour(tmp_path / "a.onnx", (48, 48)), person=True, fit="letterbox", padding=1.5)
    segmenter, inner = Segmenter(path, LABELS), np.s_[44:84, 34:58]
    label, sure = segmenter.label(picture)
    whole = segmenter.shares(picture, np.array([0.0, 0, 400, 400]))
    found = np.argwhere(whole[..., 0] < 0.5)[:, ::-1]
    left_top, right_bottom = found.min(0), found.max(0) + 1.0
    middle, half = (left_top + right_bottom) / 2, 1.5 * (right_bottom - left_top) / 2
    closely = segmenter.shares(picture, np.concatenate([middle - half, middle + half]))
    mean = (whole + closely)[..., 2] / 2  # of background, 1, 3 and 7
    assert (label[inner] == 3).all() and np.abs(sure[inner] / 255.0 - mean[inner]).max() < 0.003


def test_of_two_the_network_doubts_limbs_tell_who_is_the_person(tmp_path):
    """The larger stands where no limbs are; of a person that the network is sure of they change nothing."""
    picture = np.zeros((96, 96, 3), np.uint8)
    picture[10:80, 5:50], picture[20:70, 60:85] = [140, 0, 0], [140, 0, 0]
    limbs = SeenLimbs(np.zeros((0, 2, 2)), np.array([[62.0, 25], [83, 25], [83, 65], [62, 65]]), 40.0)
    for sharp, told in ((5.0, True), (500.0, False)):
        path = described(by_colour(tmp_path / "a.onnx", (96, 96), sharp=sharp), person=True, fit="letterbox")
        alone, _ = Segmenter(path, LABELS).label(picture)
        with_limbs, _ = Segmenter(path, LABELS).label(picture, None, limbs)
        assert (alone[20:70, 15:40] == 3).all() and (alone[30:60, 65:80] == 0).all()
        assert (with_limbs[20:70, 15:40] == 3).all() != told and (with_limbs[30:60, 65:80] == 3).all() == told
        mask = picture[..., 0] > 0
        assert np.array_equal(*(Segmenter(path, LABELS).label(picture, mask, at)[0] for at in (None, limbs)))


def test_the_person_without_a_label_votes_for_none(tmp_path):
    path = described(by_colour(tmp_path / "a.onnx"), labels=MAP | {"legs": ""})
    picture, meant = quarters(*SIZE)
    label, sure = Segmenter(path, {"skin": 1, "tshirt": 3}).label(picture)
    assert (sure[meant == 7] < 10).all() and (label[meant == 7] > 0).all() and (sure[meant == 3] > 250).all()


def test_of_a_list_the_label_that_the_scene_has_is_meant(tmp_path):
    path = described(by_colour(tmp_path / "a.onnx"), labels={"top": ["blouse", "tshirt"], "legs": ["skirt"]})
    assert Segmenter(path, {"skin": 1, "tshirt": 3}).about.ids.tolist() == [0, 3, -1, 1]
    with pytest.raises(UserError, match="a.toml: labels.top: .* has blouse and tshirt: which"):
        Segmenter(path, {"skin": 1, "tshirt": 3, "blouse": 4})


def test_what_hugging_face_writes_beside_it_is_read(tmp_path):
    by_colour(tmp_path / "model.onnx", ("h", "w"), stride=4)
    (tmp_path / "config.json").write_text(json.dumps({"id2label": dict(zip("0123", CLASSES))}))
    processor = {"size": {"height": 64, "width": 48}, "image_mean": [0, 0, 0], "image_std": [1, 1, 1]}
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(processor))
    (tmp_path / "model.toml").write_text('[labels]\ntop = "tshirt"\nlegs = "trousers"\n')
    about = Segmenter(tmp_path / "model.onnx", LABELS).about
    assert about.size == (64, 48) and about.std == (255, 255, 255) and about.ids.tolist() == [0, 3, 7, 1]


def test_the_known_tables_have_as_many_classes_as_their_names_say():
    from toile.vision.segmenters.classes import TABLES

    for name, classes in TABLES.items():
        assert len(set(classes)) == len(classes) == int(name[-2:])


@pytest.mark.parametrize(
    "more, says",
    [
        ({"classes": CLASSES[:3], "labels": {"top": "tshirt", "legs": "trousers"}}, "gives 4 classes, 3 are named"),
        ({"classes": None}, "which classes it gives is not said"),
        ({"classes": "atr17"}, "a.toml: classes: 'atr17', expected one of atr18, lip20, sapiens28"),
        ({"labels": {"top": "tshirt"}}, "a.toml: labels: no line for class legs"),
        ({"labels": MAP | {"top": "shirt"}}, "a.toml: labels.top: 'shirt' is not in scene.toml's"),
        ({"labels": MAP | {"hat": "skin"}}, "a.toml: labels.hat: the network has no such class"),
        ({"colour": "rgb"}, "a.toml: colour: Extra inputs are not permitted"),
        ({"size": [32, 32]}, "a.toml: size: .32, 32., the network takes .48, 32."),
        ({"output": "labels"}, "a.toml: output: 'labels', expected one of logits"),
        ({"padding": 9.0}, "a.toml: padding: Input should be less than"),
    ],
)
def test_what_does_not_go_together_is_refused_by_file_and_field(tmp_path, more, says):
    with pytest.raises(UserError, match=says):
        Segmenter(described(by_colour(tmp_path / "a.onnx"), **more), LABELS)


def test_files_that_are_no_network_of_labels_are_refused(tmp_path):
    from onnx import helper

    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(UserError, match="text.onnx: cannot be read as an ONNX network"):
        Segmenter(tmp_path / "text.onnx", LABELS)
    with pytest.raises(UserError, match="size of its input is not fixed"):
        Segmenter(described(by_colour(tmp_path / "open.onnx", ("h", "w"))), LABELS)
    flat = [helper.make_node("GlobalAveragePool", ["image"], ["p"]), helper.make_node("Flatten", ["p"], ["flat"])]
    with pytest.raises(UserError, match="output flat has shape .*, no number for each class and pixel"):
        Segmenter(described(graph(tmp_path / "flat.onnx", flat, {"flat": ["n", 3]})), LABELS)
    named = by_colour(tmp_path / "huge.onnx", ("h", "w"))
    with pytest.raises(UserError, match="huge.toml: size: .9000, 32., expected sides of 1 to 4096"):
        Segmenter(described(named, size=[9000, 32]), LABELS)
