"""A garment laid on another body keeps its lengths where that body lets it, and lies outside of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.shapes import box, sphere, tube
from toile import kernels
from toile.surface.refit import CLEARANCE, Wearer, refit, strain_of

BODY, SKIN = sphere(24, 32)
JOINTS = np.array([[0.0, 0, -0.3], [0, 0, 0], [0, 0, 0.3]])


def wearer(wide=0.12, tall=0.5, at=(0, 0, 0), joints=1.0):
    """An egg, its joints `joints` times as far apart as usual."""
    return Wearer(BODY * [wide, wide, tall] + at, JOINTS * joints + at)


def garment(V, F):
    """A layer skinned by height to the two joints about each vertex."""
    place = np.clip((V[:, 2] + 0.3) / 0.3, 0, 1.999)
    low = place.astype(np.int32)
    return SimpleNamespace(
        rest=V, faces=F, skin_idx=np.stack([low, low + 1], 1), skin_val=np.stack([low + 1 - place, place - low], 1)
    )


@pytest.fixture(scope="module")
def shirt():
    V, F = tube(16, 32, 0.14, 0.4)
    return garment(V - [0, 0, 0.2], F)


def test_on_its_owner_a_garment_is_its_own_rest_to_the_bit(shirt):
    assert np.array_equal(refit(shirt, wearer(), wearer(), SKIN), shirt.rest)


def test_a_body_that_stands_elsewhere_takes_the_garment_along(shirt):
    at = np.array([0.3, -0.2, 0.1])
    assert np.allclose(refit(shirt, wearer(), wearer(at=at), SKIN), shirt.rest + at, atol=1e-6)


def test_on_a_slimmer_body_it_stays_as_it_is(shirt):
    assert np.allclose(refit(shirt, wearer(), wearer(wide=0.1), SKIN), shirt.rest, atol=1e-6)


def test_a_longer_body_does_not_stretch_it(shirt):
    """Carried by the joints alone it would be a tenth longer."""
    laid = refit(shirt, wearer(), wearer(tall=0.55, joints=1.1), SKIN)
    assert np.percentile(np.abs(strain_of(shirt.faces, shirt.rest, laid)), 95) < 0.02
    assert np.ptp(laid[:, 2]) < 1.02 * np.ptp(shirt.rest[:, 2])


def test_a_wider_body_widens_it_alone_and_is_covered(shirt):
    wide = wearer(wide=0.16)
    laid = refit(shirt, wearer(), wide, SKIN)
    assert len(kernels.intersecting_pairs(laid, shirt.faces, wide.vertices, SKIN)) == 0
    assert kernels.signed_distance(laid, wide.vertices, SKIN).min() > 0.8 * CLEARANCE
    i, j = kernels.unique_edges(shirt.faces).T
    upright = np.abs(shirt.rest[i] - shirt.rest[j])[:, :2].max(1) < 1e-9
    strain = strain_of(shirt.faces, shirt.rest, laid)
    assert np.abs(strain[upright]).max() < 0.03 < 0.08 < strain[~upright].max() < 0.25


def test_a_button_keeps_its_shape_and_its_place_on_the_cloth(shirt):
    B, G = box([0.004, 0.012, 0.012], [0.145, 0.0, 0.0])
    buttoned = garment(np.concatenate([shirt.rest, B]), np.concatenate([shirt.faces, G + len(shirt.rest)]))
    laid = refit(buttoned, wearer(), wearer(wide=0.16), SKIN)
    button, cloth = laid[-8:], laid[:-8]
    lengths = [np.linalg.norm(V[:, None] - V[None], axis=2) for V in (B, button)]
    assert np.allclose(*lengths, atol=1e-9)
    gap = kernels.SurfaceIndex(cloth, shirt.faces).closest(button.mean(0)[None])[3]
    assert abs(gap[0] - 0.005) < 0.002 and button[:, 0].mean() > 0.16
