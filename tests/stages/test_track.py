"""The tracked surface: onto the scan, also where the pose is off."""

import numpy as np
import pytest

from tests.support.shapes import sphere
from toile.config import TrackSettings
from toile.errors import UserError
from toile.scene import OBSERVED, BodyModel, Mesh, Person
from toile.stages.track import Tracker


def pipe(rings=60, sectors=48):
    """One joint in the middle of a closed pipe 1 m long."""
    V, F = sphere(rings, sectors, 0.5)
    V = V * [0.2, 0.16, 1] + [0, 0, 0.5]
    bend = np.clip((V[:, 2] - 0.4) / 0.2, 0, 1)
    idx, val = np.tile([0, 1], (len(V), 1)), np.stack([1 - bend, bend], 1)
    J = np.array([[0, 0, 0.0], [0, 0, 0.5]])
    none = np.zeros((len(V), 3, 0))
    return BodyModel(V, F, J, np.array([-1, 0]), idx, val, none, np.zeros((2, 3, 0)), ("root", "elbow"))


def posed(model, angle):
    return model.skin(model.v_template, model.J, np.array([[0, 0, 0], [angle, 0, 0]]), np.zeros(3))


@pytest.fixture(scope="module")
def surface():
    model = pipe()
    return model, Tracker(model, Person(np.zeros(0), model.v_template, model.J), TrackSettings()).surface


@pytest.mark.parametrize("off", [0.03, 0.08, 0.12])
def test_the_surface_finds_its_scan_from_a_pose_whose_end_is_off(surface, off):
    model, surface = surface
    dense = pipe(90, 70)
    scan, true = Mesh(posed(dense, 0.4), dense.f), posed(model, 0.4)
    V, confidence = surface.fit(scan, posed(model, 0.4 + off / 0.5))
    assert np.linalg.norm(V - true, axis=1).max() < 0.01
    assert scan.index.closest(V)[3].max() < 0.001
    assert (confidence == OBSERVED).all()


def test_a_scan_elsewhere_is_refused(surface):
    model, surface = surface
    with pytest.raises(UserError, match="do not overlap"):
        surface.fit(Mesh(model.v_template + [5.0, 0, 0], model.f), model.v_template)
