"""Labels on the nodes of any graph: Markov random field by alpha-expansion."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import _core
from .._core import MrfResult
from .arrays import Array, Ints, as_faces, as_floats, as_indices

Votes = Sequence[tuple[int, int]]  # (node, label)


def mrf(
    unary: Array,
    edges: Any,
    weights: Array,
    pairwise: Array | None = None,
    start: Array | None = None,
    prefer: Votes = (),
    forbid: Votes = (),
    **options: Any,
) -> MrfResult:
    """x = argmin sum_i unary[i, x_i] + sum_e weights[e] pairwise[x_p, x_q], a local minimum of all expansions.

    unary: (n,L) float64, any sign; edges: (E,2) int, repeated ones add up, temporal edges are ordinary ones;
    weights: (E,) float64, not negative; pairwise: (L,L) metric (zero diagonal, symmetric, triangle inequality), None
    for Potts, [x_p != x_q]. start: (n,) first labels; None: each node's cheapest given its neighbours'.
    prefer, forbid: manual votes, lists of (node, label): `prefer` adds `vote_cost` to the node's other labels,
    `forbid` adds it to that label.

    Options: vote_cost=0 (in units of energy; 0: more than all that speaks against the vote); max_sweeps=100 (a sweep
    expands every label once).

    -> MrfResult: .labels (n,) int32; .energy, recomputed from the labels (votes included) = .unary_energy +
    .pairwise_energy; .sweep_energy, of the first labels and after each sweep; .sweeps; .expansions;
    .stop (`Stop`): "converged", no expansion lowers the energy, or "max_iterations" after max_sweeps.
    Nothing is kept between calls.

    With two labels the result is a global minimum; with Potts its energy is at most twice the least (for energies
    without negative terms). Bits do not depend on the number of threads.
    InputError: NaN or infinity (clip log-probabilities of 0 to a large finite cost), an index out of range, an edge
    from a node to itself, a negative weight, a pairwise that is no metric (the message names the entries).
    Source: Boykov, Veksler, Zabih 2001; Kolmogorov, Zabih 2004; max-flow by Goldberg et al. 2011.
    """
    unary = as_floats("mrf", "unary", unary, (None, None))
    if len(edges) == 0:
        edges = np.zeros((0, 2), dtype=np.int32)
    if pairwise is None:
        pairwise = np.zeros((0, 0))
    elif (pairwise := as_floats("mrf", "pairwise", pairwise, (None, None))).size == 0:
        raise _core.InputError("mrf: pairwise is empty")
    return _core.mrf(
        unary,
        as_faces("mrf", "edges", edges, width=2),
        as_floats("mrf", "weights", weights, (None,)),
        pairwise,
        start=np.zeros(0, dtype=np.int32) if start is None else as_indices("mrf", "start", start),
        prefer=_as_votes("prefer", prefer),
        forbid=_as_votes("forbid", forbid),
        **options,
    )


def _as_votes(name: str, votes: Votes) -> Ints:
    return as_faces("mrf", name, votes if len(votes) else np.zeros((0, 2), dtype=np.int32), width=2)
