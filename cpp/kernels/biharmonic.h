// Biharmonic displacement: the smoothest field that takes given values at given vertices.
#pragma once
#include <string>
#include <vector>

#include "../base/sparse.h"
#include "../base/types.h"

namespace toile {

struct BiharmonicOptions {
    double accuracy = 1e-8;  ///< relative error at which a factor, and a solve, is refused
    int refinements = 6;     ///< most steps of iterative refinement a solve
};

/// D = argmin tr(D' L M^-1 L D) with D[known] given (Jacobson, Tosun, Sorkine, Zorin 2010); L the cotangent Laplacian,
/// M mixed Voronoi areas, natural boundary. Factored once by LL'; each solve back-substitutes. Where three fields tried
/// beforehand show that this alone misses `accuracy`, it is refined against L M^-1 L unformed, so that the error is that
/// of L and not that of its square.
///
/// The factor is checked on the constant field, which it must reproduce to `accuracy`. Only where it fails (needles,
/// faces of no area) the edge lengths are mollified, by as little as passes, and `mollified` says by how much.
///
/// Keeps the symbolic analysis and the numeric factor of (L M^-1 L)_uu: a solve only substitutes.
class BiharmonicSolver {
public:
    /// V (n,3) [m], F (m,3), known (k,) distinct vertices. InputError for a bad mesh or index, a repeated known vertex,
    /// or a connected component without one. SolveError when no mollification passes the check.
    BiharmonicSolver(const Vertices& V, const Faces& F, const Indices& known, const BiharmonicOptions& options = {});

    /// D_known (k,3) in the order of `known` -> D (n,3), the same unit. Vertices that no face uses get zero unless
    /// known. SolveError when refinement stalls above `accuracy`.
    Vertices solve(const Vertices& D_known) const;

    std::int64_t factorisations() const { return factor_.factorisations(); }  ///< 1, and 1 more per mollification tried
    double mollified() const { return mollified_; }        ///< amount added to every edge [m], 0 when none was needed
    double factor_error() const { return factor_error_; }  ///< measured on the constant field

private:
    bool factorize(const Sparse& L, const Vector& mass);
    void substitute(Vertices& D) const;
    Matrix correction(const Vertices& D) const;
    double settle(Vertices& D) const;
    double error_of_one(const Vertices& D) const;

    BiharmonicOptions options_;
    Eigen::Index n_;
    std::vector<int> known_, unknown_;
    Sparse L_, coupling_;  // coupling_ = -(L M^-1 L)_uk
    Vector inverse_mass_;
    CholeskyFactor factor_;
    bool refine_ = false;
    double mollified_ = 0, factor_error_ = 0;
};

/// One solve; for several displacements of one mesh keep a BiharmonicSolver.
Vertices biharmonic(const Vertices& V, const Faces& F, const Indices& known, const Vertices& D_known,
                    const BiharmonicOptions& options = {});

}  // namespace toile
