// The cheapest path through a lattice.
#pragma once
#include "base/types.h"

namespace toile {

/// argmin over paths j (k,) of sum_i cost(i, j_i) + sum_i step(j_i, j_i+1) for cost (k,m), step (m,m) (Viterbi 1967); of
/// equal ones that of lowest entries, from the last backwards.
Indices cheapest_path(const Matrix& cost, const Matrix& step);

}  // namespace toile
