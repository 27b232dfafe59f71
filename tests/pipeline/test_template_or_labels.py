"""Where a template does not fit the capture, what speaks against the labels is said beside it."""

from pathlib import Path

import numpy as np
import pytest

from toile.config import PlacementSettings
from toile.errors import UserError
from toile.io.body import load_body_model
from toile.io.capture import open_capture
from toile.pipeline.template import Worn, template_on_body
from toile.scene import Mesh, Person

SAMPLE = Path(__file__).parents[2] / "data_samples" / "tshirt-talk"
SKIN, SHIRT, TROUSERS = 1, 3, 4
NAMES = {SKIN: "skin", SHIRT: "tshirt", TROUSERS: "trousers"}


@pytest.fixture(scope="module")
def model():
    return load_body_model("anny")


@pytest.fixture(scope="module")
def capture():
    return open_capture(SAMPLE)


def worn(model, hem=0.16, by=""):
    """The body at rest in a shirt down to the height `hem` [m], trousers below it, bare arms and head."""
    x, z = np.abs(model.v_template[:, 0]), model.v_template[:, 2]
    labels = np.full(len(z), SKIN)
    labels[(x < 0.32) & (z < 0.735)] = SHIRT
    labels[(z < hem) & (x < 0.32)] = TROUSERS
    return Worn(Person(np.zeros(0), model.v_template, model.J), labels[None], NAMES, by)


def laid(model, capture, worn, mesh=None):
    (garment,) = capture.scene.garments
    mesh = mesh or capture.templates["tshirt"]
    return template_on_body(model, worn, garment, SHIRT, mesh, PlacementSettings())


def test_a_template_where_labels_are_its_own_is_laid_without_a_word(model, capture):
    assert laid(model, capture, worn(model))[1] == []


@pytest.mark.parametrize("axes", [[0, 2, 1], [2, 1, 0]])
def test_right_labels_are_not_doubted_where_a_template_came_in_other_axes(model, capture, axes):
    shirt = capture.templates["tshirt"]
    turned = Mesh(shirt.vertices[:, axes] * [1, 1, -1], shirt.faces)
    (said,) = laid(model, capture, worn(model), turned)[1]
    assert "does not lie on the body as it is" in said


def test_a_template_over_much_of_another_label_is_laid_with_a_word_on_both(model, capture):
    *_, said = laid(model, capture, worn(model, hem=0.3))[1]
    assert said.startswith("garment tshirt: where the template lies the body is labelled ") and "% 'trousers'" in said
    assert said.endswith("the labels are wrong, or it is of another cut: see toile inspect")


def test_a_refused_template_names_the_network_both_areas_and_the_label_in_its_place(model, capture):
    shirt = capture.templates["tshirt"]
    long = Mesh(shirt.vertices * [1, 1, 3.0], shirt.faces)
    with pytest.raises(UserError) as refused:
        laid(model, capture, worn(model, hem=0.3, by="clothes"), long)
    text = str(refused.value)
    assert "\n" not in text and "or the labels by the network 'clothes' are wrong: they give the garment 0." in text
    assert "m2 of the body, its template has " in text and text.endswith("see toile inspect")
