"""Several garments on one body: nested tubes, whose order is known."""

import numpy as np
import pytest

from toile import kernels
from toile.surface.layering import Layering


def tube(radius, low, high, around=48, rows=24):
    """An open tube about z, faces outwards."""
    t, z = np.meshgrid(np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(low, high, rows))
    V = np.stack([radius * np.cos(t), radius * np.sin(t), z], 2).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(rows - 1))
    a, b = (j * around + i).ravel(), (j * around + (i + 1) % around).ravel()
    F = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])
    return V, F.astype(np.int32)


def capped(radius, low, high):
    V, F = tube(radius, low, high)
    n, around = len(V), 48
    ends = np.array([[0, 0, low], [0, 0, high]])
    i = np.arange(around)
    bottom = np.stack([i, np.full(around, n), (i + 1) % around], 1)
    top = np.stack([n - around + i, n - around + (i + 1) % around, np.full(around, n + 1)], 1)
    return np.concatenate([V, ends]), np.concatenate([F, bottom, top]).astype(np.int32)


@pytest.fixture(scope="module")
def layers():
    return {"skin": capped(0.10, -0.5, 0.5), "trousers": tube(0.11, -0.45, 0.05), "shirt": tube(0.12, -0.1, 0.4)}


def layering(layers):
    garments = [(name, layers[name][1], len(layers[name][0])) for name in ("trousers", "shirt")]
    return Layering(layers["skin"][1], len(layers["skin"][0]), garments, margin=0.002)


def radii(V):
    return np.linalg.norm(V[:, :2], axis=1)


def test_layers_in_their_order_stay_as_they_are(layers):
    cloth = {name: layers[name][0] for name in ("trousers", "shirt")}
    found = layering(layers).solve(layers["skin"][0], cloth)
    assert found.intersections_before == found.intersections_left == 0
    assert all(np.array_equal(found.vertices[name], V) for name, V in cloth.items())


def test_a_shirt_through_trousers_and_skin_ends_outside_of_both_and_moves_alone(layers):
    T, S = layers["trousers"][0], layers["shirt"][0] + [0.03, 0, 0]  # leaves the skin on one side by nothing
    found = layering(layers).solve(layers["skin"][0], {"trousers": T, "shirt": S})
    assert found.intersections_before > 0 and found.intersections_left == 0
    assert np.array_equal(found.vertices["trousers"], T)
    V, F = found.vertices["shirt"], layers["shirt"][1]
    for under in ("skin", "trousers"):
        assert len(kernels.intersecting_pairs(V, F, *layers[under])) == 0
    waist = V[V[:, 2] < 0.03]
    assert radii(waist).min() > 0.1115 and radii(V).min() > 0.1015
    assert found.depth_before["shirt"] > 0.009 and found.depth_before["trousers"] == 0


def test_only_what_is_hidden_of_a_waist_is_tucked_inside_the_shirt(layers):
    T, S = layers["trousers"][0].copy(), layers["shirt"][0]
    waist = T[:, 2] > -0.08
    T[waist, :2] *= 0.13 / 0.11  # bulges through the shirt
    inside = layering(layers).move_inside(
        {"trousers": T, "shirt": S}, {"trousers": waist, "shirt": np.zeros(len(S), bool)}
    )
    assert np.array_equal(inside["shirt"], S) and np.array_equal(inside["trousers"][~waist], T[~waist])
    deep = T[:, 2] > -0.05
    assert radii(inside["trousers"][deep]).max() < 0.1195
    none = layering(layers).move_inside(
        {"trousers": T, "shirt": S}, {"trousers": ~waist & False, "shirt": np.zeros(len(S), bool)}
    )
    assert np.array_equal(none["trousers"], T)


SKIN, SHIRT, TROUSERS = 1, 3, 4


def labelled_scan():
    """A tube that carries trousers between z = -0.3 and 0, a shirt above, skin below."""
    from toile.scene import Segmented

    V, F = tube(0.1, -0.5, 0.5, rows=60)
    z = V[:, 2]
    ids = np.array([SKIN, SHIRT, TROUSERS], np.uint8)
    column = np.where(z > 0, 1, np.where(z > -0.3, 2, 0))
    probability = np.eye(3, dtype=np.float32)[column]
    faces = ids[probability[F].sum(1).argmax(1)]
    return V, F, Segmented(ids[column], faces, probability, ids, {})


def test_an_opening_under_another_garment_is_none_of_its_own():
    from toile.stages.dress import _openings_of
    from toile.vision.openings import Rivals

    V, F, segmented = labelled_scan()
    heights = {}
    for over in ((), (SHIRT,)):
        openings = _openings_of(segmented, TROUSERS, V, F, Rivals(V, F, segmented, TROUSERS, over))
        heights[over] = sorted(round(float(opening.points[:, 2].mean()), 1) for opening in openings)
    assert heights == {(): [-0.3, 0.0], (SHIRT,): [-0.3]}
    hem = _openings_of(segmented, SHIRT, V, F, Rivals(V, F, segmented, SHIRT))
    assert [round(float(opening.points[:, 2].mean()), 1) for opening in hem] == [
        0.0
    ]  # the outer garment's opening is its own


def test_a_covered_garment_is_carried_to_the_body_not_to_what_covers_it():
    from types import SimpleNamespace

    from toile.scene import Person
    from toile.stages.dress import _surface_under

    V, F, segmented = labelled_scan()
    bulge = V * np.where(V[:, 2:] > 0, [[1.3, 1.3, 1]], 1)  # the shirt stands off
    model = SimpleNamespace(f=F, rest=lambda shape: (V, None))
    person, sample = Person(np.zeros(0), bulge, np.zeros((1, 3))), (None, None, segmented, None)
    assert _surface_under(model, person, [sample], []) is bulge
    under = radii(_surface_under(model, person, [sample], [SHIRT]))
    assert np.allclose(under[np.abs(V[:, 2]) > 0.05], 0.1)


def test_the_true_outer_surface_leaves_out_what_a_garment_covers_of_another(tmp_path, layers):
    import zarr

    from toile.measure.truth import Truth

    group = zarr.open_group(str(tmp_path / "truth.zarr"), mode="w")
    for path, data in {
        "frames": np.array([7]), "labels": np.full(len(layers["skin"][0]), SKIN, np.uint8),
        "body/vertices": layers["skin"][0][None], "body/faces": layers["skin"][1],
        **{f"garment/{n}/vertices": layers[n][0][None] for n in ("trousers", "shirt")},
        **{f"garment/{n}/faces": layers[n][1] for n in ("trousers", "shirt")},
    }.items():  # fmt: skip
        group.create_array(path, data=data)
    V, F, label = Truth(tmp_path / "truth.zarr").outer(7, {"trousers": TROUSERS, "shirt": SHIRT}, bare=True)
    z = V[F][:, :, 2].mean(1)
    assert set(label[z > 0.1]) <= {SHIRT, SKIN} and (label[(z > 0) & (z < 0.35)] == SHIRT).all()
    assert z[label == TROUSERS].max() < 0 and z[label == TROUSERS].min() < -0.4
    whole = Truth(tmp_path / "truth.zarr").outer(7, {"trousers": TROUSERS, "shirt": SHIRT})[2]
    assert (whole == TROUSERS).sum() == len(layers["trousers"][1])
