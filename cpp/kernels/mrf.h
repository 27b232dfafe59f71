// Labels of a Markov random field by alpha-expansion.
#pragma once
#include <string>
#include <vector>

#include "../base/stop.h"
#include "../base/types.h"

namespace toile {

struct MrfOptions {
    int max_sweeps = 100;  ///< a sweep expands every label once
    Indices start;         ///< (n,) first labels; empty: each node's cheapest given its neighbours'
    Edges prefer;          ///< (k,2) manual votes (node, label): adds `vote_cost` to the node's other labels
    Edges forbid;          ///< (k,2) manual votes (node, label): adds `vote_cost` to that label
    double vote_cost = 0;  ///< in units of energy; 0: more than anything that speaks against the vote
};

struct MrfResult {
    Indices labels;           ///< (n,)
    double energy = 0;        ///< of `labels`, summed anew: unary_energy + pairwise_energy
    double unary_energy = 0;  ///< votes included
    double pairwise_energy = 0;
    std::vector<double> sweep_energy;  ///< of the first labels, then after each sweep
    int sweeps = 0;
    int expansions = 0;                ///< moves tried
    Stop stop = Stop::max_iterations;  ///< converged: no expansion lowers the energy; or max_iterations
};

/// Minimises sum_i unary(i, x_i) + sum_e weights[e] pairwise(x_p, x_q) by alpha-expansion (Boykov, Veksler, Zabih
/// 2001), each move a minimum cut (Kolmogorov and Zabih 2004).
///
/// unary (n,L), any sign; edges (E,2), repeated ones add up; weights (E,), not negative; pairwise (L,L) a metric
/// (zero diagonal, symmetric, triangle inequality to 1e-9 of its largest entry), or (0,0) for Potts, [x_p != x_q].
/// Ends in a local minimum with respect to every expansion: for Potts within twice the global minimum, and at it
/// for two labels. Weights are rounded to 2^-50 of the largest sum of weights at a node while cutting.
/// Nothing is kept between calls; within one the flow found for a label starts the next search for it.
/// Throws InputError for NaN, infinity, indices out of range, a negative weight, a pairwise that is no metric.
MrfResult mrf(const Matrix& unary, const Edges& edges, const Vector& weights, const Matrix& pairwise = {},
              const MrfOptions& options = {});

}  // namespace toile
