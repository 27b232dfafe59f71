"""Laws of the benchmark: what it generates, how it scores, and which points it puts on the front."""

import json

import numpy as np
import pytest
import trimesh

from bench import (
    clothing,
    front,
    kernel_problems,
    loop,
    measure,
    metrics,
    peers,
    plan,
    problems,
    sequences,
    summary,
    tradeoff,
)


def ball(subdivisions=4):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces)


def test_loop_surface_is_affinely_invariant_and_keeps_old_vertices_first():
    V, F = ball(1)
    N, fine, cage_face = loop.limit_surface(F, len(V), 2)
    A = np.array([[1, 2, 0], [0, 1, 3], [1, 0, 1.0]])
    assert np.allclose(N @ (V @ A.T + 5), (N @ V) @ A.T + 5, atol=1e-12)
    assert len(fine) == 16 * len(F) and np.bincount(cage_face).tolist() == [16] * len(F)
    assert np.allclose((N @ V)[: len(V)], loop.limit_surface(F, len(V), 0)[0] @ V, atol=1e-12)


def test_loop_limit_is_where_many_subdivisions_go():
    V, F = ball(0)
    V, F = V * [1, 2, 3], F[:-1]  # with a border
    S, P = F, V
    for _ in range(5):
        step, S = loop.subdivide(S, len(P))
        P = step @ P
    assert np.abs(P[: len(V)] - loop.limit(F, len(V)) @ V).max() < 2e-3


def test_noise_and_holes_are_as_large_as_said():
    V, F = ball(5)
    noisy, G = problems.corrupt(V, F, "noise1", np.random.default_rng(1))
    area = trimesh.Trimesh(noisy, G, process=False).area / trimesh.Trimesh(V, F, process=False).area
    assert area == pytest.approx(0.95, abs=0.005)
    assert np.unique(G).tolist() == list(range(len(noisy)))
    assert np.linalg.norm(noisy, axis=1).std() == pytest.approx(0.001, rel=0.05)


def test_clutter_floats_closed_and_apart():
    V, F = ball(4)
    dirty, G = problems.corrupt(V, F, "noise3", np.random.default_rng(2))
    parts = trimesh.Trimesh(dirty, G, process=False).split(only_watertight=True)
    assert len(parts) == 5
    assert all(np.abs(np.linalg.norm(p.vertices, axis=1) - 1).max() > 0.05 for p in parts)


def test_same_seed_same_bits_other_seed_other_bits():
    V, F = ball(4)
    one, again, other = (problems.corrupt(V, F, "noise3", np.random.default_rng(s))[0] for s in (3, 3, 4))
    assert np.array_equal(one, again) and one.tobytes() != other.tobytes()


def test_remeshing_gives_the_number_of_vertices_asked_for_near_the_surface():
    V, F = problems.remesh(*ball(4), 6000, np.random.default_rng(0))
    assert len(V) == pytest.approx(6000, rel=0.1)
    assert np.abs(np.linalg.norm(V, axis=1) - 1).max() < 0.01


@pytest.mark.parametrize("level", [1, 3])
def test_motion_stays_about_the_template_and_steps_as_its_level(level):
    angles = sequences.swings(level, np.random.default_rng(0))
    assert max(np.abs(angles(t)).max() for t in range(sequences.FRAMES)) <= sequences.SWING[level]
    steps = np.diff([angles(t) for t in range(sequences.FRAMES + 1)], axis=0)
    assert np.sqrt((steps**2).mean()) == pytest.approx(problems.POSE[level], rel=0.1)


def scored(move=0.0):
    V, F = ball(3)
    ext = V[:, 2] > -0.5
    problem = dict(gt_v=V, src_f=F, ext=ext, hand=V[:, 2] > 0.9, clean_v=V, clean_f=F)
    return metrics.score(V + move, problem)


def test_truth_scores_zero():
    assert {k: round(v, 9) for k, v in scored().items() if v > 1e-9} == {}


def test_a_shift_scores_its_length_in_mm():
    found = scored([0, 0.003, 0.004])
    for key in ("mean", "median", "rmse", "p95", "max", "hand_mean", "hand_max", "mean_all"):
        assert found[key] == pytest.approx(5)
    assert 0 < found["surf"] < 5


def test_interior_vertices_do_not_count_but_their_faces_do():
    V, F = ball(3)
    problem = dict(gt_v=V, src_f=F, ext=V[:, 2] > -0.5, hand=V[:, 2] > 0.9)
    moved = V.copy()
    deep = V[:, 2].argmin()
    moved[deep, :2] += 0.5
    found = metrics.score(moved, problem)
    assert found["mean"] == 0 and found["mean_all"] > 0 and found["flips"] > 0


def test_vertices_that_are_not_finite_are_a_kilometre_off():
    V, F = ball(3)
    problem = dict(gt_v=V, src_f=F, ext=np.ones(len(V), bool), hand=np.zeros(len(V), bool))
    broken = V.copy()
    broken[7] = np.nan
    found = metrics.score(broken, problem)
    assert found["nan"] == 1 and found["max"] > 1e6


def test_a_result_of_another_shape_is_refused():
    V, F = ball(1)
    with pytest.raises(ValueError, match="shape"):
        metrics.score(V[:-1], dict(gt_v=V, src_f=F, ext=np.ones(len(V), bool), hand=np.zeros(len(V), bool)))


def test_front_holds_what_nothing_beats_in_both():
    places = [(1, 5, False), (2, 4, False), (3, 4.5, False), (4, 1, False), (0.5, 0.5, True), (5, 1, False)]
    points = [dict(seconds=s, error=e, oracle=o, failed=0) for s, e, o in places]
    summary.mark_front(points)
    assert [p.get("on_front", False) for p in points] == [True, True, False, True, False, False]


def a_row(kernel, panel):
    names = dict(kernel=kernel, panel=panel, problem="p", seed=1, method="m", ours=True, oracle=False)
    return names | dict(prepare_s=0.1, solve_s=0.2, process_s=1.0, peak_mb=1.0)


def test_mrf_error_is_the_energy_above_the_least_of_its_problem():
    base = a_row("mrf", "mrf")
    rows = [base | dict(method=m, energy=e) for m, e in (("a", 100.0), ("b", 101.0))]
    points = {p["method"]: p for p in summary.summarise(rows)["mrf"]["points"]}
    assert points["b"]["error"] == pytest.approx(0.01) and points["a"]["error"] == summary.LEAST["mrf"]


def test_failures_are_counted_and_not_averaged():
    base = a_row("register", "L1")
    rows = [base | dict(mean=2.0), base | dict(error="3 vertices are not finite")]
    (point,) = summary.summarise(rows)["L1"]["points"]
    assert (point["error"], point["problems"], point["failed"], point["on_front"]) == (2.0, 2, 1, False)


def test_harmonic_reference_reproduces_a_shift_and_the_known_rows():
    pytest.importorskip("igl")
    problem = kernel_problems.patch(600)
    assert set(loop.edges_of(problem["F"])[2]) == {1, 2}  # a manifold tube with two rims
    D = kernel_problems.harmonic_reference(problem | dict(D_known=np.ones((len(problem["known"]), 3))))
    assert np.abs(D - 1).max() < 1e-7


@pytest.mark.parametrize("peer", ["gco_expansion", "pymaxflow_expansion"])
def test_expansion_peers_come_close_to_the_least_energy(peer):
    pytest.importorskip({"gco_expansion": "gco", "pymaxflow_expansion": "maxflow"}[peer])
    from toile.kernels import mrf

    problem = kernel_problems.labelling(*ball(3))
    energy = kernel_problems.score_mrf(getattr(peers, peer)(problem), problem)["energy"]
    assert energy == pytest.approx(mrf(problem["unary"], problem["edges"], problem["weights"]).energy, rel=2e-3)


def test_clothing_truth_lies_on_the_true_shirt():
    pytest.importorskip("igl")
    from toile.io.capture import open_capture

    problem = clothing.make(open_capture(plan.CAPTURE), 0)
    assert metrics.score(problem["gt_v"], problem)["surf"] < 0.01
    assert metrics.score(problem["src_v"], problem)["surf"] > 2


def method(kernel, name):
    return next(m for m in tradeoff.methods() if (m.kernel, m.name) == (kernel, name))


def test_a_method_is_measured_in_a_process_of_its_own(tmp_path):
    plan.save(tmp_path / "p.npz", kernel_problems.labelling(*ball(2)))
    row, labels = measure.run(method("mrf", "toile"), tmp_path / "p.npz", 60)
    assert labels.shape == (162,)
    assert 0 < row["solve_s"] < row["process_s"] and 20 < row["peak_mb"] < 1000


def test_failing_and_endless_methods_give_a_row_that_says_so(tmp_path):
    plan.save(tmp_path / "p.npz", dict(unary=np.zeros((4, 2))))
    row, result = measure.run(method("mrf", "toile"), tmp_path / "p.npz", 60)
    assert result is None and "KeyError" in row["error"]
    row, result = measure.run(method("mrf", "toile"), tmp_path / "p.npz", 0.01)
    assert result is None and row["error"] == "over 0.01 s"


def test_a_run_goes_on_where_it_stood(tmp_path):
    plan.save(tmp_path / "p.npz", kernel_problems.labelling(*ball(2)))
    problem = plan.Problem("mrf", "p", 0, tmp_path / "p.npz", "p")
    one = [method("mrf", "toile")]
    first = tradeoff.measure_all([problem], one, tmp_path / "rows.jsonl", 1, 60, lambda text: None)
    again = tradeoff.measure_all([problem], one, tmp_path / "rows.jsonl", 1, 60, lambda text: pytest.fail(text))
    assert json.dumps(first) == json.dumps(again)


def test_the_pipelines_qualities_become_a_panel_an_error_with_the_sum_of_their_stages():
    table = {
        "draft": {"seconds": {"track": 0.1, "dress": 0.2}, "errors": {"boundary_mm": 5.0, "surface_mm": 1.0}},
        "standard": {"seconds": {"track": 0.3, "dress": 0.4}, "errors": {"boundary_mm": 2.0, "surface_mm": 1.5}},
        "reference": {"calibration": 0.05},
    }
    made = front.panels(table)
    assert set(made) == {f"register: {title}" for title in front.PANELS.values()}
    openings, surface = (made[f"register: {front.PANELS[key]}"]["points"] for key in ("boundary_mm", "surface_mm"))
    assert [(p["method"], p["seconds"]) for p in openings] == [("draft", pytest.approx(0.3)), ("standard", 0.7)]
    assert [p["on_front"] for p in openings] == [True, True] and [p["on_front"] for p in surface] == [True, False]
    assert all(p["error"] is None for p in made[f"register: {front.PANELS['hidden_mm']}"]["points"])


def test_picture_shows_the_panels_and_says_who_gave_no_answer(tmp_path):
    pytest.importorskip("matplotlib")
    from PIL import Image

    from bench.picture import draw

    point = dict(method="toile draft", ours=True, oracle=False, failed=0, seconds=0.1, error=2.0, on_front=True)
    lost = point | dict(method="peer", ours=False, seconds=None, error=None, on_front=False)
    for name, points in (("a.png", [point, lost]), ("b.png", [point])):
        draw({"L1": dict(error="mean error [mm]", points=points)}, tmp_path / name)
    a, b = (np.asarray(Image.open(tmp_path / name).convert("RGB")).astype(int) for name in ("a.png", "b.png"))
    assert ((a[..., 0] - a[..., 1]) > 80).sum() > 20  # our red mark and its name
    changed = (np.abs(a - b) > 100).any(2).nonzero()  # beyond what a palette changes
    assert len(changed[0]) and changed[0].min() > len(a) / 2  # the failure stands below, and nowhere else


@pytest.mark.slow
def test_templates_and_targets_sample_one_smooth_surface():
    pytest.importorskip("igl")
    from bench.person import SyntheticPerson

    person = SyntheticPerson()
    for size in ("14k", "3k"):
        template = person.template(size)
        problem = problems.make(person, template, 2, "clean", 5000, seed=1)
        assert metrics.score(problem["gt_v"], problem)["surf"] < 0.02
        assert metrics.surface_distance(problem["tgt_v"], problem["clean_v"], problem["clean_f"]).max() < 2e-5
        assert metrics.score(problem["gt_v"], problem)["mean"] == 0
        assert np.linalg.norm(problem["lm_p"] - problem["gt_v"][problem["lm_v"]], axis=1).max() < 0.02
        again = problems.make(person, template, 2, "clean", 5000, seed=1)
        assert all(np.array_equal(problem[k], again[k]) for k in problem)
