// The last stage: a displacement of every vertex beside the graph's answer.
#pragma once
#include "base/sparse.h"
#include "kernels/nricp_match.h"

namespace toile {

/// K = (length / h)^4 U^2 / 9 + gradient (length / h)^2 U / 3 + rest I, per vertex, with U the graph Laplacian and h the
/// mean edge: waves shorter than `length` [m] are not followed whatever the resolution, unpulled vertices stay.
class NricpFine {
public:
    NricpFine(const Vertices& V, const Faces& F);

    /// Minimises d' K d + pull about `x - anchor`, d the displacement from `anchor`: conjugate gradients,
    /// preconditioned by the scalar factor of K + trace(A) / 3.
    Vertices step(const Vertices& anchor, const Vertices& x, const Pull& pull, double length, int sweeps);

    CholeskyFactor factor;

private:
    Sparse laplacian_, bilaplacian_, identity_;
    double edge_ = 0;
};

}  // namespace toile
