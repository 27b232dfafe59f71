// The last stage: a displacement of every vertex beside the graph's answer.
#pragma once
#include <map>

#include "base/sparse.h"
#include "kernels/nricp/match.h"

namespace toile {

/// K = length^4 L' M^-1 L + rest M over the template (Botsch and Kobbelt 2004): waves shorter than `length` are not
/// followed whatever the resolution, unpulled vertices follow smoothly.
class NricpFine {
public:
    NricpFine(const Vertices& V, const Faces& F, const Vector& area);

    /// Minimises d' K d + pull about `x - anchor`, d the displacement from `anchor`: conjugate gradients,
    /// preconditioned by the scalar factor of K + M / 3 in single precision. A power of sqrt(2) stands for `length`, so that a sequence
    /// factorises once.
    Vertices step(const Vertices& anchor, const Vertices& x, const Pull& pull, double length, int sweeps);

    std::int64_t analyses() const { return analyses_; }  ///< one: all lengths have the same pattern
    std::int64_t factorisations() const { return static_cast<std::int64_t>(levels_.size()); }

private:
    struct Level {
        Sparse K;
        SingleFactor factor;
    };
    Level& level(double length);

    Vector mass_;
    Sparse bilaplacian_;
    CholeskyFactor analysis_;
    std::int64_t analyses_ = 1;
    std::map<int, Level> levels_;  ///< by 2 log2(length)
};

}  // namespace toile
