// What a CholeskyFactor holds: CHOLMOD's own, for the files that stand on it.
#pragma once
#include <suitesparse/cholmod.h>

#include <algorithm>
#include <vector>

#include "base/sparse.h"
#include "base/turns.h"

namespace toile {

struct CholeskyFactor::State {
    cholmod_common common{};
    cholmod_factor* factor = nullptr;
    std::atomic<std::int64_t> factorisations{0}, analyses{0};
    Calls calls;
    bool sound = false;             ///< the numbers in `factor` are those of a whole factorisation
    std::vector<int> outer, inner;  ///< the pattern that was analysed

    State();
    ~State();
    bool analysed(const Sparse& A) const;
    void analyze(const Sparse& A);
    void factorize(const Sparse& A);
};

}  // namespace toile
