"""Of a garment that another covers only what shows is asked for on the scan."""

from dataclasses import replace

import numpy as np

from tests.support.shapes import tube
from toile.measure.judged import JudgedLayer, covered_shares, uncovered
from toile.pipeline.outcome import said_of_covered


def layer(name, low, high, radius, rings=80):
    V, F = tube(rings, 64, radius, high - low)
    V = V + [0, 0, low]
    return JudgedLayer(name, 2, V, F, np.zeros(len(V)), np.arange(len(V)))


def test_what_a_garment_farther_out_covers_is_not_looked_for():
    sleeve, shirt = layer("sleeve", 0, 1, 0.10), layer("shirt", 0.3, 0.7, 0.12)
    inner, outer = uncovered([sleeve, shirt])
    z = inner.vertices[inner.looks, 2]
    bare = (sleeve.vertices[:, 2] < 0.3) | (sleeve.vertices[:, 2] > 0.7)
    assert len(z) == bare.sum() and ((z < 0.3) | (z > 0.7)).all()
    assert len(outer.looks) == len(shirt.vertices)
    assert covered_shares([inner, outer]) == {"sleeve": 1 - bare.mean()}


def test_how_much_of_a_garment_is_not_judged_is_said():
    (said,) = said_of_covered({"trousers": [0.2, 0.31, 0.9], "vest": [0.0, 0.01]})
    assert said.startswith("trousers: other garments cover 31 % of it")


def test_what_lies_inside_or_far_off_covers_nothing():
    shirt, vest = layer("shirt", 0, 1, 0.10), layer("vest", 0.3, 0.7, 0.08)
    tent = layer("tent", 0.2, 0.8, 0.35)
    for outer in (vest, tent):
        assert len(uncovered([shirt, outer])[0].looks) == len(shirt.vertices)


def test_a_garment_that_is_covered_all_over_is_looked_for_whole():
    vest, shirt = layer("vest", 0.3, 0.7, 0.10), layer("shirt", 0, 1, 0.12)
    assert len(uncovered([vest, shirt])[0].looks) == len(vest.vertices)


def test_what_faces_a_garment_across_a_gap_is_not_looked_for():
    """Two tubes side by side, 1 cm apart where they are nearest."""
    sleeve, trunk = layer("sleeve", 0, 1, 0.10), layer("trunk", 0, 1, 0.10)
    beside = replace(trunk, vertices=trunk.vertices + [0.21, 0, 0])
    inner, _ = uncovered([sleeve, beside])
    hidden = np.setdiff1d(np.arange(len(sleeve.vertices)), inner.looks)
    assert len(hidden) and (sleeve.vertices[hidden, 0] > 0.09).all()
    apart = replace(trunk, vertices=trunk.vertices + [0.23, 0, 0])
    assert len(uncovered([sleeve, apart])[0].looks) == len(sleeve.vertices)
