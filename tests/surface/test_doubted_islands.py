"""Islands of a label that colours speak against, on a flat sheet."""

import numpy as np
import pytest

from toile.config import SegmentSettings
from toile.scene import Mesh
from toile.surface.label_field import dissolve_islands

N, STEP = 41, 0.01  # vertices a side, m between them


@pytest.fixture
def sheet():
    """Label 0 with a disc of label 1, of about 80 cm^2."""
    y, x = np.mgrid[:N, :N] * STEP
    V = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    i = np.arange(N * N).reshape(N, N)
    q = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]], -1).reshape(-1, 4)
    F = np.concatenate([q[:, :3], q[:, [0, 2, 3]]]).astype(np.int32)
    return Mesh(V, F), (np.linalg.norm(V[:, :2] - 0.2, axis=1) < 0.05).astype(int)


def likelihood(disc, own, around):
    values = np.zeros((len(disc), 2))
    values[disc == 1] = [around, own]
    return values


def test_an_island_goes_where_its_colours_are_those_around_it(sheet):
    mesh, labels = sheet
    every = np.ones(len(labels), bool)
    settings = SegmentSettings()
    kept = dissolve_islands(labels, mesh, settings, likelihood(labels, 2.0, 1.0), every)
    gone = dissolve_islands(labels, mesh, settings, likelihood(labels, 1.0, 2.0), every)
    assert (kept == labels).all() and (gone == 0).all()
    assert (dissolve_islands(labels, mesh, settings) == labels).all()  # nothing is known of its colours
    unseen = dissolve_islands(labels, mesh, settings, likelihood(labels, 1.0, 2.0), ~every)
    assert (unseen == labels).all()


def test_what_is_larger_stays_and_what_is_smaller_goes_whatever_its_colours(sheet):
    mesh, labels = sheet
    every = np.ones(len(labels), bool)
    against, for_it = (likelihood(labels, *values) for values in ((1.0, 2.0), (2.0, 1.0)))
    assert (dissolve_islands(labels, mesh, SegmentSettings(doubted_region=0.005), against, every) == labels).all()
    assert (dissolve_islands(labels, mesh, SegmentSettings(min_region=0.01), for_it, every) == 0).all()
