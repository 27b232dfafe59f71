"""How thick what is worn over something else is: half of the outermost garment's distance, where two garments cover the skin."""

from types import SimpleNamespace

import numpy as np

from tests.support.cloths import ball
from toile.surface.wrapping import MOST, wrapping

SKIN = ball(0.10)[0]


def shell(radius, keep=lambda V: V[:, 2] < np.inf):
    V, F = ball(radius)
    return SimpleNamespace(rest=V, faces=np.ascontiguousarray(F[keep(V)[F].all(1)]))


def test_where_two_garments_cover_the_skin_it_is_half_of_the_distance_of_the_outer_one():
    inner, outer = shell(0.11), shell(0.13)
    for garments in ([inner, outer], [outer, inner]):
        assert np.allclose(wrapping(SKIN, garments), 0.5 * 0.03, atol=1e-3)


def test_one_garment_alone_asks_for_no_room():
    assert not wrapping(SKIN, [shell(0.13)]).any() and not wrapping(SKIN, []).any()


def test_what_lies_beyond_a_border_is_not_covered():
    half = shell(0.13, lambda V: V[:, 2] < 0)
    thick = wrapping(SKIN, [shell(0.11), half])
    assert (thick[SKIN[:, 2] < -0.03] > 0.014).all() and not thick[SKIN[:, 2] > 0.03].any()


def test_what_lies_far_off_covers_something_else():
    assert not wrapping(SKIN, [shell(0.11), shell(0.10 + 1.1 * MOST)]).any()
