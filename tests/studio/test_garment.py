import tomllib

import numpy as np
import pytest

from toile.errors import UserError


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
    from toile.studio.surface import border_edges, open_loops
    from toile.studio.template import SIZE_OFF, make_template

    V, F = shirt
    t = make_template(V, F, V, body.rest, body.rest)
    at = np.einsum("gc,gcd->gd", t.map_bary, V[F[t.map_face]])
    middle = 0.5 * (at.min(0) + at.max(0))
    assert np.allclose(t.mesh.vertices, middle + SIZE_OFF * (at - middle), atol=1e-9)
    assert 5000 < len(at) < 7500 and len(at) != len(V)
    assert len(open_loops(t.mesh.faces)) == 4
    rim, edges = np.concatenate(open_loops(t.mesh.faces)), border_edges(F)[0]
    a, b = V[edges[:, 0]], V[edges[:, 1]]
    s = np.clip(((at[rim, None] - a) * (b - a)).sum(2) / ((b - a) ** 2).sum(1), 0, 1)
    assert np.linalg.norm(a + s[..., None] * (b - a) - at[rim, None], axis=2).min(1).max() < 1e-9
    assert t.mesh.uv.min() >= 0 and t.mesh.uv.max() <= 1 and t.mesh.face_uv.shape == t.mesh.faces.shape


def test_checks_find_what_breaks_a_bound(body, cut):
    from toile.studio import truth
    from toile.studio.surface import unique_edges

    V, F = cut
    edges, hands = unique_edges(F), np.arange(10)
    fine = truth.check_frame("shirt", V, F, V, edges, body.rest, body.skin_faces, hands, 0)
    assert fine["strain_max"] == 0 and fine["self_pairs"] == 0
    with pytest.raises(truth.TruthRejected, match="frame 3: .* intersect"):
        truth.check_frame("shirt", V - [0, 0.03, 0], F, V - [0, 0.03, 0], edges, body.rest, body.skin_faces, hands, 3)
    low = V - [0, 0.03, 0]
    pierced = truth.check_frame("shirt", low, F, low, edges, body.rest, body.skin_faces, hands, 3, allowed=10**6)[
        "pairs"
    ]
    with pytest.raises(truth.TruthRejected, match=f"{pierced} triangle pairs"):
        truth.check_frame("shirt", low, F, low, edges, body.rest, body.skin_faces, hands, 3, allowed=pierced - 1)
    with pytest.raises(truth.TruthRejected, match="strain"):
        truth.check_frame("shirt", V, F, 0.7 * V, edges, body.rest, body.skin_faces, hands, 0)
    with pytest.raises(truth.TruthRejected, match="strain .*bounds 0.25"):
        truth.check_frame("shirt", V, F, 0.79 * V, edges, body.rest, body.skin_faces, hands, 0, strained=0.25)
    less = truth.check_frame("shirt", V, F, 0.82 * V, edges, body.rest, body.skin_faces, hands, 0, strained=0.25)
    assert 0.2 < less["strain_p99"] < 0.25
    jump = np.stack([body.rest, body.rest, body.rest + [0, 0, 0.3]])
    with pytest.raises(truth.TruthRejected, match="frame 2: the body jumps"):
        truth.check_motion(jump, None)


def test_garment_with_other_loops_is_refused(tmp_path):
    from toile.studio.garment import read_shirt

    path = tmp_path / "sheet.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n")
    with pytest.raises(UserError, match="four open loops, this garment has 1"):
        read_shirt(str(path))


@pytest.fixture(scope="module")
def trousers(body):
    from toile.studio.cut import cut_garment

    return cut_garment("trousers", body)


def test_cut_trousers_have_a_waist_and_two_ankles_and_touch_nothing(body, trousers):
    from toile.studio.outfit import upper_border
    from toile.studio.surface import open_loops
    from toile.studio.truth import clearance, pairs_between, pairs_within

    V, F = trousers
    loops = open_loops(F)
    assert len(loops) == 3 and len(upper_border(V, F)) == len(loops[0])
    assert sorted(np.sign(V[c, 0].mean()) for c in loops[1:]) == [-1, 1]
    assert pairs_between(body.rest, body.skin_faces, V, F) == pairs_within(V, F) == 0
    assert clearance(V, body.rest, body.skin_faces) > 0.006


def test_a_cut_shirt_stays_clear_of_the_trousers_it_is_cut_over(body, trousers):
    from toile.studio.cut import cut_garment
    from toile.studio.truth import clearance, pairs_between

    T, TF = trousers
    over = np.concatenate([body.rest, T]), np.concatenate([body.skin_faces, TF + len(body.rest)])
    V, F = cut_garment("tshirt", body, over)
    assert V[:, 2].min() < T[:, 2].max() - 0.05  # it hangs over the waist
    assert pairs_between(*over, V, F) == 0 and clearance(V, *over) > 0.006


def test_bound_points_move_rigidly_with_the_surface_they_stick_to(body, trousers):
    from scipy.spatial.transform import Rotation

    from toile.studio.outfit import AttachedPoints

    points = trousers[0][::50]
    bound = AttachedPoints(points, body.rest, body.skin_faces)
    R, t = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix(), np.array([0.1, 2.0, -0.4])
    assert np.allclose(bound.at(body.rest), points, atol=1e-12)
    assert np.allclose(bound.at(body.rest @ R.T + t), points @ R.T + t, atol=1e-12)


def test_a_waistband_is_not_folded_by_the_thighs_that_are_lifted_under_it(body, trousers):
    from toile.studio.garment import waistband
    from toile.studio.outfit import HOLDING, AttachedPoints
    from toile.studio.surface import unique_edges

    V, F = trousers
    held = waistband(V, F)
    place = np.full(len(V), -1)
    place[held] = np.arange(len(held))
    edges = place[unique_edges(F)]
    edges = edges[(edges >= 0).all(1)]
    rotations = np.zeros((len(body.J), 3))
    for side in "LR":
        rotations[body.model.joint(f"upperleg01.{side}"), 0] = np.radians(-65)
    raised = AttachedPoints(V[held], body.rest, body.trunk_faces, HOLDING).at(body.pose(rotations, np.zeros(3)))
    lengths = [np.linalg.norm(P[edges[:, 1]] - P[edges[:, 0]], axis=1) for P in (raised, V[held])]
    assert np.abs(lengths[0] / lengths[1] - 1).max() < 0.3


def test_a_calf_passes_through_the_trousers_ankles(body, trousers):
    from toile.studio.cut import CUTS
    from toile.studio.surface import open_loops
    from toile.surface.loops import loop_length

    V, F = trousers
    bone = [body.J[body.model.joint(f"{j}.L")] for j in ("lowerleg01", "foot")]
    level = bone[0][2] + 0.3 * (bone[1][2] - bone[0][2])
    ring = body.rest[(np.abs(body.rest[:, 2] - level) < 0.02) & (body.rest[:, 0] > 0)]
    calf = np.pi * np.ptp(ring[:, :2], axis=0).mean()
    for loop in open_loops(F)[1:]:
        assert (1 + CUTS["trousers"].ease) * loop_length(V[loop]) > 1.05 * calf


def test_borders_are_turned_in_under_the_skin_for_what_is_worn_over_them(body, trousers):
    import igl

    from toile.studio.outfit import TurnedInGarment
    from toile.studio.surface import open_loops
    from toile.studio.truth import pairs_between

    V, F = trousers
    lip = TurnedInGarment(V, F, body.rest, body.skin_faces)
    P = lip.vertices(V, body.rest)
    assert len(P) == lip.count and np.array_equal(P[: len(V)], V)
    edge = P[len(V) :]
    assert (igl.fast_winding_number(body.rest, body.skin_faces.astype(np.int64), edge) > 0.5).all()
    assert not np.isin(np.concatenate(open_loops(lip.faces)), np.concatenate(open_loops(F))).any()
    half = np.concatenate([lip.faces[:, [0, 1]], lip.faces[:, [1, 2]], lip.faces[:, [2, 0]]])
    assert len(np.unique(half, axis=0)) == len(half)  # oriented as the garment is
    assert pairs_between(P, lip.faces, body.rest, body.skin_faces) > 0


@pytest.mark.parametrize(
    "kind, openings", [("shorts", 3), ("skirt", 2), ("dress", 4), ("longsleeve", 4), ("baselayer", 4), ("tank", 4)]
)  # fmt: skip
def test_what_is_cut_from_the_body_has_its_openings_and_touches_nothing(body, kind, openings):
    from toile.studio.cut import cut_garment
    from toile.studio.surface import open_loops
    from toile.studio.truth import clearance, pairs_between

    V, F = cut_garment(kind, body)
    assert len(open_loops(F)) == openings and 3000 < len(V) < 12_000
    assert pairs_between(body.rest, body.skin_faces, V, F) == 0
    assert clearance(V, body.rest, body.skin_faces) > 0.005


def test_a_shirt_is_cut_clear_of_the_tank_top_under_it(body):
    from toile.studio.cut import cut_garment
    from toile.studio.truth import pairs_between

    T, TF = cut_garment("tank", body)
    over = np.concatenate([body.rest, T]), np.concatenate([body.skin_faces, TF + len(body.rest)])
    assert pairs_between(*over, *cut_garment("tshirt", body, over)) == 0


def test_what_is_worn_is_named_inner_to_outer_or_refused():
    from toile.studio.make import scene_toml
    from toile.studio.options import StudioOptions

    worn = StudioOptions(wear="tank+tshirt")
    assert worn.garments == (("tank", "cut"), ("tshirt", "newton"))
    text = scene_toml(worn)
    assert text.index('name = "tank"') < text.index('name = "tshirt"') and "tank = 7" in text and "dress" not in text
    assert StudioOptions(wear="trousers+longsleeve", garment=None).garments[1] == ("longsleeve", "cut")
    for wrong in ("kilt", "tank+tank"):
        with pytest.raises(UserError, match=f"wear is '{wrong}'".replace("+", r"\+")):
            StudioOptions(wear=wrong)


def test_a_scene_is_named_after_its_motion_file_whatever_that_is_called():
    from toile.studio.make import scene_toml
    from toile.studio.options import StudioOptions

    text = scene_toml(StudioOptions(motion='clips/Äpfel "zwei" \\ drei.bvh'))
    assert tomllib.loads(text)["scene"]["name"] == 'fitted-Äpfel "zwei" \\ drei'
