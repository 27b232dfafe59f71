"""A button follows the cloth about it, as a rigid body."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.shapes import box, sphere, tube
from toile import kernels
from toile.surface.attachments import Attachments
from toile.surface.layering import Layering


@pytest.fixture(scope="module")
def buttoned():
    """A tube with a box before it, 1 mm off: the box's vertices stand between those of the tube."""
    V, F = tube(30, 40, 0.15, 0.6)
    B, G = box([0.004, 0.012, 0.012], [0.154, 0.0, 0.3])
    half = len(V) // 2
    order = np.r_[:half, len(V) : len(V) + 8, half : len(V)]
    place = np.argsort(order)
    return (
        np.concatenate([V, B])[order],
        place[np.concatenate([F, G + len(V)])].astype(np.int32),
        place[-8:],
        place[: len(V)],
    )


def lengths(V):
    return np.linalg.norm(V[:, None] - V[None], axis=2)


def bent(V):
    """The tube bent about y and stretched along its axis."""
    a = 1.5 * V[:, 2]
    r = 1 / 1.5 + V[:, 0]
    return np.stack([r * np.cos(a), 1.2 * V[:, 1], r * np.sin(a)], 1)


def test_cloth_and_parts_are_told_apart_by_their_loops(buttoned):
    V, F, button, cloth = buttoned
    a = Attachments(F, len(V))
    assert np.array_equal(a.cloth, np.sort(cloth)) and [p.tolist() for p in a.parts] == [sorted(button)]
    np.testing.assert_array_equal(V[a.cloth][a.faces], V[F[a.of_cloth]])
    assert len(kernels.boundary_loops(a.faces)) == 2


def test_a_button_stays_rigid_and_at_its_place_on_bent_cloth(buttoned):
    V, F, button, cloth = buttoned
    a = Attachments(F, len(V))
    after = a.follow(V, bent(V[a.cloth]))
    np.testing.assert_array_equal(after[a.cloth], bent(V[a.cloth]))
    np.testing.assert_allclose(lengths(after[button]), lengths(V[button]), rtol=1e-6, atol=1e-12)
    off = kernels.SurfaceIndex(after[a.cloth], a.faces).closest(after[button])[3]
    rest = kernels.SurfaceIndex(V[a.cloth], a.faces).closest(V[button])[3]
    assert np.abs(off - rest).max() < 1e-3


def test_a_button_follows_a_rigid_motion_exactly(buttoned):
    V, F, button, _ = buttoned
    a = Attachments(F, len(V))
    R, t = Rotation.from_rotvec([0.4, -1.2, 2.0]).as_matrix(), np.array([1.0, 2, -3])
    np.testing.assert_allclose(a.follow(V, V[a.cloth] @ R.T + t), V @ R.T + t, atol=1e-12)


def test_a_garment_of_one_piece_is_left_as_it_is():
    V, F = tube(6, 9)
    a = Attachments(F, len(V))
    moved = V + 1
    assert a.parts == [] and a.follow(V, moved) is moved and a.extend(V, moved) is moved
    np.testing.assert_array_equal(a.faces, F)


def test_layering_moves_a_button_with_the_cloth_it_pushes(buttoned):
    V, F, button, cloth = buttoned
    S, G = sphere(60, 90, 0.3)
    S = S * [0.52, 0.52, 1.5] + [0, 0, 0.3]  # stands 6 mm out of the tube's middle
    layered = Layering(G, len(S), [("shirt", F, len(V))], margin=0.002).solve(S, {"shirt": V})
    after = layered.vertices["shirt"]
    assert layered.intersections_left == 0 and after[button, 0].mean() > V[button, 0].mean() + 0.005
    np.testing.assert_allclose(lengths(after[button]), lengths(V[button]), rtol=1e-6, atol=1e-12)
