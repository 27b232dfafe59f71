"""Laws of `mrf`: brute force on small graphs, known bounds, peers' energies, votes, refusals."""

import itertools

import numpy as np
import pytest

from toile.kernels import InputError, mrf


def energy(labels, unary, edges, weights, pairwise):
    nodes = np.arange(len(unary))
    edges = np.reshape(edges, (-1, 2)).astype(int)
    return unary[nodes, labels].sum() + (weights * pairwise[labels[edges[:, 0]], labels[edges[:, 1]]]).sum()


def brute_force(unary, edges, weights, pairwise):
    """The least energy over all labellings."""
    n, labels = unary.shape
    X = np.array(list(itertools.product(range(labels), repeat=n)))
    E = unary[np.arange(n), X].sum(1)
    for (p, q), w in zip(edges, weights):
        E = E + w * pairwise[X[:, p], X[:, q]]
    return E.min()


def random_problem(seed, n, labels, edges, strength=1.0):
    rng = np.random.default_rng(seed)
    E = rng.integers(0, n, (edges, 2))
    E = E[E[:, 0] != E[:, 1]]
    return rng.uniform(0, 1, (n, labels)), E, rng.uniform(0, strength, len(E))


def potts(labels):
    return 1.0 - np.eye(labels)


def truncated_linear(labels, most=2):
    i = np.arange(labels)
    return np.minimum(np.abs(i[:, None] - i), most).astype(float)


def random_metric(labels, seed):
    points = np.random.default_rng(seed).normal(size=(labels, 3))
    D = np.linalg.norm(points[:, None] - points, axis=2)
    return (D + D.T) / 2


def grid_edges(height, width):
    i = np.arange(height * width).reshape(height, width)
    return np.r_[np.c_[i[:, :-1].ravel(), i[:, 1:].ravel()], np.c_[i[:-1].ravel(), i[1:].ravel()]]


@pytest.mark.parametrize("seed", range(20))
def test_mrf_matches_brute_force_on_12_nodes_with_two_labels(seed):
    unary, edges, weights = random_problem(seed, n=12, labels=2, edges=30, strength=0.5)
    result = mrf(unary, edges, weights)
    assert result.energy == pytest.approx(brute_force(unary, edges, weights, potts(2)), abs=1e-9)


@pytest.mark.parametrize(
    "pairwise", [potts(3), truncated_linear(3), random_metric(3, 1)], ids=["potts", "linear", "metric"]
)
def test_mrf_stays_within_the_bound_of_expansion(pairwise):
    exact = 0
    off_diagonal = pairwise[~np.eye(3, dtype=bool)]
    bound = 2 * off_diagonal.max() / off_diagonal.min()
    for seed in range(30):
        unary, edges, weights = random_problem(seed, n=8, labels=3, edges=16)
        best = brute_force(unary, edges, weights, pairwise)
        result = mrf(unary, edges, weights, pairwise)
        assert best - 1e-9 <= result.energy <= bound * best
        exact += result.energy <= best + 1e-9
    assert exact >= 24  # it is nearly always the optimum itself


def test_mrf_no_expansion_improves_its_answer():
    """Plain reference of one expansion: all subsets of nodes."""
    unary, edges, weights = random_problem(3, n=9, labels=4, edges=20)
    pairwise = random_metric(4, 2)
    result = mrf(unary, edges, weights, pairwise)
    for alpha in range(4):
        for subset in itertools.product([False, True], repeat=9):
            moved = np.where(subset, alpha, result.labels)
            assert energy(moved, unary, edges, weights, pairwise) >= result.energy - 1e-9


def test_mrf_energy_is_that_of_its_labels_and_never_rises():
    unary, edges, weights = random_problem(4, n=300, labels=6, edges=900)
    pairwise = truncated_linear(6)
    result = mrf(unary, edges, weights, pairwise)
    assert result.energy == pytest.approx(energy(result.labels, unary, edges, weights, pairwise), rel=1e-12)
    assert result.energy == result.unary_energy + result.pairwise_energy == result.sweep_energy[-1]
    assert (np.diff(result.sweep_energy) <= 0).all() and len(result.sweep_energy) == result.sweeps + 1
    assert result.stop == "converged" and result.expansions >= 6


def test_mrf_reaches_the_energy_of_middlebury_tsukuba(shared_data):
    data = np.load(shared_data / "mrf_middlebury" / "tsukuba_mrf_problem.npz")
    height, width, labels = data["unary"].shape
    weights = np.r_[data["h_weight"].ravel(), data["v_weight"].ravel()]
    result = mrf(data["unary"].reshape(-1, labels), grid_edges(height, width), weights, data["pairwise"])
    assert result.energy <= 1.001 * 371297


@pytest.mark.parametrize("pairwise", [potts(5), truncated_linear(5)], ids=["potts", "linear"])
def test_mrf_is_as_good_as_gco(pairwise):
    gco = pytest.importorskip("gco")
    height, width = 40, 50
    rng = np.random.default_rng(6)
    unary = rng.uniform(0, 100, (height * width, 5))
    edges, weights = grid_edges(height, width), rng.uniform(1, 40, 40 * 49 + 39 * 50)
    theirs = np.asarray(
        gco.cut_general_graph(edges.astype(np.int32), weights, unary, pairwise)
    )  # integers it would round to 0
    start = unary.argmin(1)
    theirs = energy(theirs, unary, edges, weights, pairwise)
    assert theirs < 0.9 * energy(start, unary, edges, weights, pairwise)
    assert mrf(unary, edges, weights, pairwise).energy == pytest.approx(theirs, rel=0.01)  # two local minima


def test_mrf_two_labels_equal_one_maximum_flow():
    maxflow = pytest.importorskip("maxflow")
    unary, edges, weights = random_problem(7, n=3000, labels=2, edges=9000, strength=0.7)
    graph = maxflow.GraphFloat()
    nodes = graph.add_nodes(len(unary))
    for v in range(len(unary)):
        graph.add_tedge(nodes[v], unary[v, 1], unary[v, 0])
    for (p, q), w in zip(edges, weights):
        graph.add_edge(p, q, w, w)
    assert mrf(unary, edges, weights).energy == pytest.approx(graph.maxflow(), rel=1e-12)


def test_mrf_without_edges_or_coupling_takes_the_cheapest_label():
    unary, edges, weights = random_problem(8, n=50, labels=64, edges=80)
    for arguments in (([], []), (edges, 0 * weights)):
        result = mrf(unary, *arguments)
        np.testing.assert_array_equal(result.labels, unary.argmin(1))
        assert result.energy == pytest.approx(unary.min(1).sum())


def test_mrf_with_one_label_returns_it():
    unary, edges, weights = random_problem(9, n=10, labels=1, edges=12)
    result = mrf(unary, edges, weights)
    assert (result.labels == 0).all() and result.energy == pytest.approx(unary.sum()) and result.stop == "converged"


def test_mrf_strong_coupling_takes_one_label_everywhere_though_64_are_offered():
    rng = np.random.default_rng(10)
    unary, edges = rng.uniform(0, 1, (200, 64)), np.c_[np.arange(199), np.arange(1, 200)]
    result = mrf(unary, edges, np.full(199, 1e3))
    assert (result.labels == unary.sum(0).argmin()).all()


def test_mrf_certain_nodes_keep_their_label_however_large_the_cost():
    """Probabilities of exactly 0 and 1 as large finite costs: they must not drown the others' small ones."""
    n = 100
    unary = np.random.default_rng(11).uniform(0, 1, (n, 3))
    edges, weights = np.c_[np.arange(n - 1), np.arange(1, n)], np.full(n - 1, 0.2)
    certain = {0: 2, 50: 1, 99: 0}
    for cost in (1e2, 1e9, 1e300):
        for v, label in certain.items():
            unary[v] = np.where(np.arange(3) == label, 0, cost)
        labels = mrf(unary, edges, weights).labels
        assert all(labels[v] == label for v, label in certain.items())
        if cost == 1e2:
            expected = labels
        np.testing.assert_array_equal(labels, expected)


def test_mrf_does_not_depend_on_the_unit_of_energy():
    unary, edges, weights = random_problem(12, n=200, labels=4, edges=600)
    expected = mrf(unary, edges, weights)
    for scale in (1e-8, 1e12):
        result = mrf(scale * unary, edges, scale * weights)
        assert result.energy == pytest.approx(scale * expected.energy, rel=1e-9)


def test_mrf_repeated_edges_add_up():
    unary, edges, weights = random_problem(13, n=60, labels=3, edges=150)
    twice = mrf(unary, np.r_[edges, edges[:, ::-1]], np.r_[weights, weights])
    once = mrf(unary, edges, 2 * weights)
    assert twice.energy == pytest.approx(once.energy, rel=1e-12)
    np.testing.assert_array_equal(twice.labels, once.labels)


def test_mrf_constant_costs_at_a_node_change_nothing():
    unary, edges, weights = random_problem(14, n=80, labels=3, edges=200)
    shift = np.random.default_rng(15).normal(size=(80, 1)) * 10
    np.testing.assert_array_equal(mrf(unary + shift, edges, weights).labels, mrf(unary, edges, weights).labels)


def test_mrf_constant_costs_at_a_node_hide_no_gain():
    n = 200
    unary = np.tile([0.0, 1.0], (n, 1))
    unary[0] = 1e14
    result = mrf(unary, np.c_[: n - 1, 1:n], np.full(n - 1, 10.0), start=np.ones(n, int))
    assert (result.labels == 0).all() and result.stop == "converged"


def test_mrf_goes_on_from_given_labels():
    unary, edges, weights = random_problem(16, n=100, labels=4, edges=300)
    first = mrf(unary, edges, weights)
    again = mrf(unary, edges, weights, start=first.labels)
    assert again.sweeps == 1 and again.sweep_energy[0] == first.energy
    np.testing.assert_array_equal(again.labels, first.labels)
    start = np.full(100, 3)
    stopped = mrf(unary, edges, weights, start=start, max_sweeps=0)
    assert stopped.stop == "max_iterations" and (stopped.labels == 3).all()


def frames_of_a_grid(count, temporal, seed=20):
    """A 20x30 grid over `count` frames, each node joined to itself in the next frame; (unary, edges, weights) of all."""
    rng = np.random.default_rng(seed)
    n, one = 600, grid_edges(20, 30)
    truth = (np.arange(n) % 30) // 10
    wrong = rng.random((count, n)) < 0.3
    seen = np.where(wrong, rng.integers(0, 3, (count, n)), truth)
    unary = rng.uniform(0.5, 1, (count, n, 1)) * (seen[..., None] != np.arange(3))
    joined = [np.c_[np.arange(n), np.arange(n) + n] + t * n for t in range(count - 1)]
    edges = np.concatenate([one + t * n for t in range(count)] + joined)
    weights = np.r_[np.full(count * len(one), 0.3), np.full((count - 1) * n, temporal)]
    return unary, one, edges, weights, truth


def test_mrf_temporal_edges_of_weight_zero_leave_each_of_10_frames_to_itself():
    unary, one, edges, weights, _ = frames_of_a_grid(10, temporal=0)
    together = mrf(unary.reshape(-1, 3), edges, weights)
    alone = [mrf(u, one, np.full(len(one), 0.3)).energy for u in unary]
    assert together.energy == pytest.approx(sum(alone), rel=0.005)  # local minima each


def test_mrf_temporal_edges_settle_labels_over_10_frames():
    def run(temporal):
        unary, _, edges, weights, truth = frames_of_a_grid(10, temporal)
        x = mrf(unary.reshape(-1, 3), edges, weights).labels.reshape(10, -1)
        return (x[1:] != x[:-1]).mean(), (x != truth).mean()

    (flicker, wrong), (flicker_joined, wrong_joined) = run(0), run(0.5)
    assert flicker_joined < 0.2 * flicker and wrong_joined < 0.5 * wrong


def test_mrf_temporal_edges_that_cannot_be_cut_give_every_frame_the_labels_of_their_sum():
    unary, one, edges, weights, _ = frames_of_a_grid(10, temporal=1e6)
    result = mrf(unary.reshape(-1, 3), edges, weights)
    frames = result.labels.reshape(10, -1)
    assert (frames == frames[0]).all()
    assert result.energy == pytest.approx(mrf(unary.sum(0), one, np.full(len(one), 3.0)).energy, rel=0.005)


def test_mrf_starts_of_all_kinds_end_within_a_percent_of_each_other():
    unary, edges, weights = random_problem(21, n=2000, labels=5, edges=6000, strength=1.0)
    free = mrf(unary, edges, weights)
    starts = [np.zeros(2000, int), unary.argmin(1), np.random.default_rng(22).integers(0, 5, 2000)]
    for start in starts:
        assert mrf(unary, edges, weights, start=start).energy == pytest.approx(free.energy, rel=0.01)


def test_mrf_votes_decide_unless_they_are_priced():
    unary, edges, weights = random_problem(17, n=100, labels=4, edges=300, strength=3)
    free = mrf(unary, edges, weights)
    wanted, refused = (10, (free.labels[10] + 1) % 4), (20, free.labels[20])
    voted = mrf(unary, edges, weights, prefer=[wanted], forbid=[refused])
    assert voted.labels[10] == wanted[1] and voted.labels[20] != refused[1]
    priced = unary.copy()
    priced[10] += 0.3 * (np.arange(4) != wanted[1])
    priced[20, refused[1]] += 0.3
    votes = mrf(unary, edges, weights, prefer=[wanted], forbid=[refused], vote_cost=0.3)
    assert votes.energy == pytest.approx(mrf(priced, edges, weights).energy)


@pytest.mark.parametrize("height, width, labels", [(50, 60, 5), (370, 400, 2)], ids=["small", "large"])
def test_mrf_bits_do_not_depend_on_threads(threads, height, width, labels):
    rng, edges = np.random.default_rng(18), grid_edges(height, width)
    unary, weights = rng.uniform(0, 1, (height * width, labels)), rng.uniform(0, 0.5, len(edges))
    results = []
    for n in (1, 2, 3, 8):
        threads(n)
        r = mrf(unary, edges, weights, random_metric(labels, 3), max_sweeps=2)
        results.append((r.labels.tobytes(), r.energy, tuple(r.sweep_energy)))
    assert all(r == results[0] for r in results)


NOT_METRIC = np.array([[0.0, 1, 5], [1, 0, 1], [5, 1, 0]])


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(unary=np.zeros((0, 3))), "unary is empty"),
        (dict(unary=np.zeros((3, 0))), "unary is empty"),
        (dict(unary=np.array([[0, 1, 2], [0, np.inf, 0], [0, 0, 0]])), r"unary\[1\] is not finite"),
        (dict(unary=np.zeros(3)), "unary has shape"),
        (dict(edges=[[0, 1], [1, 3]]), r"edges\[1\] is \(1, 3\)"),
        (dict(edges=[[0, 1], [2, 2]]), r"edges\[1\] joins node 2 to itself"),
        (dict(edges=[[0.0, 1], [1, 2]]), "edges has dtype"),
        (dict(weights=[1.0]), "weights has 1 entries, edges has 2 rows"),
        (dict(weights=[1.0, -1]), r"weights\[1\] is negative"),
        (dict(weights=[np.nan, 1]), r"weights\[0\] is not finite"),
        (dict(pairwise=NOT_METRIC), r"pairwise\[0, 2\] exceeds pairwise\[0, 1\] \+ pairwise\[1, 2\]"),
        (dict(pairwise=potts(2)), r"pairwise has shape \(2, 2\)"),
        (dict(pairwise=potts(3) + np.eye(3)), r"pairwise\[0, 0\] is"),
        (dict(pairwise=np.triu(potts(3))), r"pairwise\[0, 1\] differs from pairwise\[1, 0\]"),
        (dict(pairwise=-potts(3)), r"pairwise\[0, 1\] is negative"),
        (dict(pairwise=potts(3) * np.nan), r"pairwise\[0\] is not finite"),
        (dict(start=[0, 1]), "start has 2 labels"),
        (dict(start=[0, 1, 3]), r"start\[2\] is 3"),
        (dict(prefer=[(0, 1), (0, 3)]), r"prefer\[1\] is \(0, 3\)"),
        (dict(forbid=[(-1, 1)]), r"forbid\[0\] is \(-1, 1\)"),
        (dict(vote_cost=-1.0), "vote_cost"),
        (dict(max_sweeps=-1), "max_sweeps"),
    ],
)
def test_mrf_refuses_bad_input_by_name(change, message):
    arguments = dict(unary=np.zeros((3, 3)), edges=[[0, 1], [1, 2]], weights=[1.0, 1.0]) | change
    with pytest.raises(InputError, match=message):
        mrf(**arguments)


def test_mrf_unknown_option_is_a_type_error():
    with pytest.raises(TypeError, match="swaps"):
        mrf(np.zeros((2, 2)), [[0, 1]], [1.0], swaps=1)
