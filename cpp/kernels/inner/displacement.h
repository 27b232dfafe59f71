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
    /// Of the vertices `free` alone, rising; the others stay at `known` (n,3).
    Weighted(const Sparse& smooth, const Vector& mass, std::vector<int> free, const Vertices& known);

    Vertices solve(const Vector& weights, const Vertices& targets);
    std::int64_t factorisations() const { return factor_.factorisations(); }
    std::int64_t analyses() const { return factor_.analyses(); }
    double smoothness(const Vertices& d) const { return (d.transpose() * (smooth_ * d)).trace(); }

private:
    const Sparse& smooth_;
    const Vector& mass_;
    CholeskyFactor factor_;
    Vector last_;
    std::vector<int> free_;   ///< empty: all
    Sparse part_;             ///< of `smooth_` among them
    Vertices known_, drawn_;  ///< where the others stay, and how they draw the free ones
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
