"""A cone's girth near its ends, and that what is cut off leaves it."""

import numpy as np
import pytest

from tests.support.shapes import tube
from toile import kernels
from toile.surface.girth import Girths


@pytest.fixture
def cone():
    """Of radius 0.1 at z = 0 and 0.2 at z = 0.5; its loops, the lower first."""
    V, F = tube(51, 200, 1.0, 0.5)
    V[:, :2] *= 0.1 + 0.2 * V[:, 2:]
    return V, F, sorted(kernels.boundary_loops(F), key=lambda loop: V[loop, 2].mean())


def test_a_cone_is_as_wide_as_it_is_so_far_from_its_ends(cone):
    V, F, loops = cone
    slant = np.hypot(1, 0.2)  # of a metre along the axis
    z = np.array([0.08, 0.5 * slant - 0.08]) / slant
    assert Girths(V, F, loops, 0.08)(V) == pytest.approx(2 * np.pi * (0.1 + 0.2 * z), rel=2e-3)


def test_what_narrows_an_end_leaves_the_girth(cone):
    V, F, loops = cone
    girths = Girths(V, F, loops, 0.08)
    end = np.clip(1 - V[:, 2:] / 0.05, 0, 1)
    cut_off = V * np.where([True, True, False], 1 - 0.4 * end, 1)
    assert girths(cut_off) == pytest.approx(girths(V), rel=1e-12)


def test_cloth_that_ends_before_has_no_girth(cone):
    V, F, loops = cone
    assert np.isnan(Girths(V, F, loops, 0.6)(V)).all()
    assert np.isnan(Girths(V, F, loops[:1], 0.3)(V)).sum() == 0
