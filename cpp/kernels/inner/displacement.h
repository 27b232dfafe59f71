// The one energy of `inner`: displacements of the body's vertices, pulled by skin and cloth and held smooth.
#pragma once
#include <vector>

#include "base/sparse.h"
#include "kernels/inner.h"

namespace toile {

/// One scalar matrix smooth + diag(m w), refactored only when its weights change.
class Weighted {
public:
    /// `analysis` is that of `smooth`.
    Weighted(const Sparse& smooth, const Vector& mass, const CholeskyFactor& analysis)
        : smooth_(smooth), mass_(mass), factor_(analysis.symbolic()) {}

    Vertices solve(const Vector& weights, const Vertices& targets) {
        if (weights.size() != last_.size() || weights != last_) {
            Sparse A = smooth_;
            for (int c = 0; c < A.outerSize(); ++c)
                for (Sparse::InnerIterator it(A, c); it; ++it)
                    if (it.row() == it.col()) it.valueRef() += mass_[c] * weights[c];
            factor_.factorize(A);
            last_ = weights;
        }
        return factor_.solve((mass_.asDiagonal() * targets).eval());
    }
    std::int64_t factorisations() const { return factor_.factorisations(); }
    std::int64_t analyses() const { return factor_.analyses(); }
    double smoothness(const Vertices& d) const { return (d.transpose() * (smooth_ * d)).trace(); }

private:
    const Sparse& smooth_;
    const Vector& mass_;
    CholeskyFactor factor_;
    Vector last_;
};

/// What one linear solve knows of each vertex.
struct Evidence {
    Vertices skin_target;  // (n,3) displacement where skin was seen
    Vector skin;           // (n,) in [0,1]
    Vertices normals;      // (n,3)
    Vector room;           // (n,) along the normal to the cloth less the gap, at d = 0; infinity: none
    Vector likely;         // (n,) along the normal to where the body is likely, at d = 0
    Vector pull;           // (n,) weight of that; 0 where nothing tells
};

struct Fitted {
    Vertices d;
    std::vector<double> energy;
    bool converged = false;
};

/// length^4 L M^-1 L, with masses below (length / 10)^2 raised to that: smaller cells bend as one, and the smallest
/// triangles of fingers and lids do not ruin the factor's condition.
Sparse smoothness_matrix(const Vertices& V, const Faces& F, const Vector& mass, double length);

/// Reweighted least squares of E(d), from d.
Fitted fit_displacement(Weighted& system, const Vector& mass, const Evidence& e, const InnerOptions& o, Vertices d);

}  // namespace toile
