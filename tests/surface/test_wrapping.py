"""The room of garments over one another: half of the outermost one's distance, where two cover the skin in front of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.cloths import ball
from toile.surface.wrapping import MOST, wrapping

SKIN, FACES = ball(0.10)
EVERYWHERE = lambda V: V[:, 2] < np.inf
BELOW = lambda V: V[:, 2] < 0


def shell(radius, where=EVERYWHERE, at=(0, 0, 0)):
    V, F = ball(radius, at=at)
    return SimpleNamespace(rest=V, faces=np.ascontiguousarray(F[where(V)[F].all(1)]))


@pytest.mark.parametrize("faces", [FACES, FACES[:, ::-1]], ids=["outwards", "inwards"])
def test_where_two_garments_cover_the_skin_it_is_half_of_the_distance_of_the_outer_one(faces):
    found = wrapping(SKIN, faces, [shell(0.11), shell(0.13)])
    assert np.allclose(found.thick, 0.5 * 0.03, atol=1e-3) and found.under.all()


def test_one_garment_alone_asks_for_no_room():
    for garments in ([shell(0.13)], []):
        found = wrapping(SKIN, FACES, garments)
        assert not found.thick.any() and not found.under.any()


def test_under_others_is_where_an_inner_garment_lies_and_not_the_outermost():
    found = wrapping(SKIN, FACES, [shell(0.11, BELOW), shell(0.13)])
    assert found.under[SKIN[:, 2] < -0.03].all() and not found.under[SKIN[:, 2] > 0.03].any()
    assert (found.thick > 0).tolist() == found.under.tolist()


def test_what_lies_beyond_a_border_is_not_covered():
    thick = wrapping(SKIN, FACES, [shell(0.11), shell(0.13, BELOW)]).thick
    assert (thick[SKIN[:, 2] < -0.03] > 0.014).all() and not thick[SKIN[:, 2] > 0.03].any()


def test_what_lies_far_off_or_beside_covers_something_else():
    assert not wrapping(SKIN, FACES, [shell(0.11), shell(0.10 + 1.1 * MOST)]).thick.any()
    other = shell(0.13, at=(0.26, 0, 0))  # about a ball beside this one: in front of the skin that faces it alone
    thick = wrapping(SKIN, FACES, [shell(0.11), other]).thick
    assert thick[SKIN[:, 0].argmax()] > 0 and not thick[SKIN[:, 0] < 0.02].any()
