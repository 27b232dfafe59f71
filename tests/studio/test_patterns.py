"""Templates that were never the true garment, and the map from them to it."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def made(body, cut):
    from toile.studio.patterns import map_template, mean_body, other_template

    V, F = cut
    mesh = other_template("tshirt", "newton", V, F, V, body)
    mean = mean_body()
    return mesh, *map_template(mesh, V, F, body.rest, mean.rest), mean


def test_the_template_is_wider_and_shorter_than_the_garment_and_clear_of_the_mean_body(body, cut, made):
    from toile.studio.cut import cut_skin
    from toile.studio.garment import named_loops
    from toile.studio.patterns import SHORTER, WIDER, shirt_worn
    from toile.studio.truth import clearance, pairs_between
    from toile.surface.loops import loop_length

    (V, F), (mesh, *_, mean) = cut, made
    T, P = mesh.faces, mesh.vertices
    mine, theirs = named_loops(P, T), named_loops(V, F)
    assert pairs_between(mean.rest, mean.skin_faces, P, T) == 0 and clearance(P, mean.rest, mean.skin_faces) > 0.003
    skins = [cut_skin(b, shirt_worn(V, F, body, SHORTER), 0.012) for b in (body, mean)]
    bodies = [loop_length(S[named_loops(S, SF)["hem"]]) for S, SF in skins]
    assert abs(loop_length(P[mine["hem"]]) / bodies[1] - WIDER * loop_length(V[theirs["hem"]]) / bodies[0]) < 0.03
    length = lambda X, loops, b: (X[loops["neck"], 2].mean() - X[loops["hem"], 2].mean()) / np.ptp(b.rest[:, 2])
    assert abs(length(P, mine, mean) / length(V, theirs, body) - SHORTER) < 0.02


def test_a_sleeve_that_is_wide_about_a_thin_arm_has_the_same_ease_about_a_thick_one():
    from tests.support.shapes import tube
    from toile.studio.patterns import WIDER, wanted_girths
    from toile.surface.loops import loop_length

    (mean, T), (skin, S), (worn, F) = (tube(8, n, r, 0.3) for n, r in ((40, 0.05), (36, 0.02), (44, 0.04)))
    loops, lengths = wanted_girths(mean, T, skin, S, worn, worn, F)
    girth = [loop_length(V[: len(V) // 8]) for V in (mean, skin, worn)]
    assert len(loops) == 2
    np.testing.assert_allclose(lengths, WIDER * (girth[0] + girth[2] - girth[1]), rtol=1e-9)


def test_no_length_of_the_template_is_the_true_cloths(cut, made):
    from toile.studio.surface import unique_edges

    (V, F), (mesh, mapped, *_) = cut, made
    at = np.einsum("gc,gcd->gd", mapped.map_bary, V[F[mapped.map_face]])
    e = unique_edges(mesh.faces)
    length = lambda X: np.linalg.norm(X[e[:, 1]] - X[e[:, 0]], axis=1)
    ratio = length(at) / length(mesh.vertices)
    assert np.quantile(ratio, 0.9) - np.quantile(ratio, 0.1) > 0.1  # a scale alone would leave one ratio


def test_the_map_takes_openings_to_openings_and_turns_next_to_nothing_over(cut, made):
    from toile.studio.surface import border_edges, open_loops, vertex_normals

    (V, F), (mesh, mapped, fell, _) = cut, made
    at = np.einsum("gc,gcd->gd", mapped.map_bary, V[F[mapped.map_face]])
    rim, edges = np.concatenate(open_loops(mesh.faces)), border_edges(F)[0]
    a, b = V[edges[:, 0]], V[edges[:, 1]]
    s = np.clip(((at[rim, None] - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(1), 0, 1)
    assert np.linalg.norm(a + s[..., None] * (b - a) - at[rim, None], axis=2).min(1).max() < 1e-9
    assert fell.mean() < 0.002
    turned = (vertex_normals(at, mesh.faces) * vertex_normals(mesh.vertices, mesh.faces)).sum(1) < 0
    assert turned.mean() < 0.01
