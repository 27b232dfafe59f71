"""Several garments on one body: which of them are simulated together, and that cloth so simulated does not cross."""

from types import SimpleNamespace

import numpy as np
import pytest

N = 14  # vertices along a side of a sheet


def sheet(height):
    """A square sheet (V, F) of 0.3 m at a height [m]."""
    x = np.linspace(-0.15, 0.15, N)
    V = np.stack([*np.meshgrid(x, x), np.full((N, N), height)], -1).reshape(-1, 3)
    corner = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    F = np.concatenate([[corner, corner + 1, corner + N + 1], [corner, corner + N + 1, corner + N]], 1).T
    return V, F.astype(np.int32)


@pytest.fixture
def two_sheets():
    """Two sheets over a ball, the upper one thrown at the lower, as `run(frames)` -> simulation, and their faces."""
    import trimesh

    from toile.studio.cloth import ClothSimulation

    ball = trimesh.creation.icosphere(3, 0.1)
    (low, F), (high, _) = sheet(0.12), sheet(0.13)
    faces = np.concatenate([F, F + N * N])
    thrown = np.repeat([0.0, -1.5], N * N)[:, None] * [0, 0, 1]

    def start(meets_itself):
        sim = ClothSimulation(
            np.concatenate([low, high]), faces, ball.vertices, [ball.faces], meets_itself=meets_itself
        )
        sim.go_on_from(np.concatenate([low, high]), thrown, ball.vertices)
        return sim

    return start, F


def crossings(V, F):
    from toile.studio.truth import pairs_between

    return pairs_between(V[: N * N], F, V[N * N :], F)


def test_cloth_that_meets_itself_does_not_go_through_itself(two_sheets):
    start, F = two_sheets
    alone, together = start(False), start(True)
    frames = [(alone.frame(alone.body), together.frame(together.body)) for _ in range(4)]
    assert max(crossings(V, F) for V, _ in frames) > 0
    assert all(crossings(V, F) == 0 for _, V in frames)


def test_cloth_that_meets_itself_goes_on_to_the_same_bits(two_sheets):
    start, _ = two_sheets
    whole, first, second = start(True), start(True), start(True)
    for _ in range(3):
        whole.frame(whole.body)
    first.frame(first.body)
    second.go_on_from(first.vertices, first.velocities, first.body)
    for _ in range(2):
        second.frame(second.body)
    assert np.array_equal(whole.vertices, second.vertices) and np.array_equal(whole.velocities, second.velocities)


def test_shirts_over_one_another_move_together_and_what_a_waistband_holds_alone():
    from toile.studio.outfit import runs_of_shirts

    garment = lambda name, held=0: SimpleNamespace(name=name, held=np.arange(held))
    names = lambda *garments: [[s.name for s in run] for run in runs_of_shirts(garments)]
    trousers, shorts = garment("trousers", 4), garment("shorts", 3)
    layer, shirt = garment("baselayer"), garment("tshirt")
    assert names(trousers, shirt) == [["trousers"], ["tshirt"]]
    assert names(trousers, layer, shirt) == [["trousers"], ["baselayer", "tshirt"]]
    assert names(layer, trousers, shirt) == [["baselayer"], ["trousers"], ["tshirt"]]
    assert names(shorts, trousers) == [["shorts"], ["trousers"]]


def test_joined_shirts_keep_each_ones_triangles():
    from toile.studio.outfit import Settled, joined, split

    def settled(name, height):
        V, F = sheet(height)
        v = np.full(V.shape, height, np.float32)
        return Settled(name, V, V + 1, F, V + 2, V - 1, V - 2, V.astype(np.float32), v, np.zeros(0, int))

    inner, outer = settled("baselayer", 0.1), settled("tshirt", 0.2)
    both = joined([inner, outer])
    assert joined([inner]) is inner
    assert np.array_equal(both.vertices[both.faces[-1]], outer.vertices[outer.faces[-1]])
    assert np.array_equal(both.first_body, inner.first_body) and np.array_equal(both.body, inner.body)
    for name in ("flat", "rest", "cloth_rest", "vertices", "velocities"):
        a, b = split(getattr(both, name), [inner, outer])
        assert np.array_equal(a, getattr(inner, name)) and np.array_equal(b, getattr(outer, name))
