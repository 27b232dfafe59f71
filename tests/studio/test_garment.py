import numpy as np
import pytest

from toile.scene import CaptureError


def test_newton_shirt_has_four_named_loops(shirt):
    from toile.studio.garment import named_loops

    V, F = shirt
    loops = named_loops(V, F)
    z = {k: V[c, 2].mean() for k, c in loops.items()}
    assert z["hem"] < z["sleeve_left"] < z["neck"]
    assert V[loops["sleeve_left"], 0].mean() > 0 > V[loops["sleeve_right"], 0].mean()


def test_cut_shirt_has_four_loops_and_touches_nothing(body, cut):
    from toile.studio.garment import named_loops
    from toile.studio.truth import clearance, pairs_between, pairs_within

    V, F = cut
    assert set(named_loops(V, F)) == {"neck", "hem", "sleeve_left", "sleeve_right"}
    assert 5000 < len(V) < 7000
    assert pairs_between(body.rest, body.skin_faces, V, F) == 0
    assert pairs_within(V, F) == 0
    assert 0.006 < clearance(V, body.rest, body.skin_faces) < 0.02


def test_template_maps_onto_the_truth_and_its_rim_onto_the_rim(body, shirt):
    from toile.studio.surface import open_loops, rim_edges
    from toile.studio.template import SIZE_OFF, make_template

    V, F = shirt
    t = make_template(V, F, V, body.rest, body.rest)
    at = np.einsum("gc,gcd->gd", t.map_bary, V[F[t.map_face]])
    middle = 0.5 * (at.min(0) + at.max(0))
    assert np.allclose(t.mesh.vertices, middle + SIZE_OFF * (at - middle), atol=1e-9)
    assert 5000 < len(at) < 7500 and len(at) != len(V)
    assert len(open_loops(t.mesh.faces)) == 4
    rim, edges = np.concatenate(open_loops(t.mesh.faces)), rim_edges(F)[0]
    a, b = V[edges[:, 0]], V[edges[:, 1]]
    s = np.clip(((at[rim, None] - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(1), 0, 1)
    assert np.linalg.norm(a + s[..., None] * (b - a) - at[rim, None], axis=2).min(1).max() < 1e-9
    assert t.mesh.uv.min() >= 0 and t.mesh.uv.max() <= 1 and t.mesh.face_uv.shape == t.mesh.faces.shape


def test_checks_find_what_breaks_a_bound(body, cut):
    from toile.studio import truth

    V, F = cut
    edges, hands = truth.unique_edges(F), np.arange(10)
    fine = truth.check_frame("shirt", V, F, V, edges, body.rest, body.skin_faces, hands, 0)
    assert fine["strain_max"] == 0 and fine["self_pairs"] == 0
    with pytest.raises(truth.TruthRejected, match="frame 3: .* intersect"):
        truth.check_frame("shirt", V - [0, 0.03, 0], F, V - [0, 0.03, 0], edges, body.rest, body.skin_faces, hands, 3)
    with pytest.raises(truth.TruthRejected, match="strain"):
        truth.check_frame("shirt", V, F, 0.7 * V, edges, body.rest, body.skin_faces, hands, 0)
    jump = np.stack([body.rest, body.rest, body.rest + [0, 0, 0.3]])
    with pytest.raises(truth.TruthRejected, match="frame 2: the body jumps"):
        truth.check_motion(jump, None)


def test_garment_with_other_loops_is_refused(tmp_path):
    from toile.studio.garment import read_shirt

    path = tmp_path / "sheet.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n")
    with pytest.raises(CaptureError, match="four open loops, this garment has 1"):
        read_shirt(str(path))
