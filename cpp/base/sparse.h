// Sparse Cholesky: CHOLMOD's supernodal LL' behind one small class that keeps its symbolic and numeric factors.
#pragma once
#include <cstdint>
#include <memory>

#include "types.h"

namespace toile {

/// LL' of a symmetric positive definite matrix (lower triangle is read). Movable, not copyable.
///
/// `analyze` fixes the fill-reducing ordering and the factor's pattern from A's; `factorize` may then be called any number
/// of times with new values, and analyses again only where A has another pattern; `solve` back-substitutes. One BLAS
/// thread, so bits do not depend on the number of threads.
class CholeskyFactor {
public:
    CholeskyFactor();
    ~CholeskyFactor();
    CholeskyFactor(CholeskyFactor&&) noexcept;
    CholeskyFactor& operator=(CholeskyFactor&&) noexcept;

    void analyze(const Sparse& A);
    CholeskyFactor symbolic() const;  ///< the analysis alone, to be factorised apart; no analysis of its own is counted
    void factorize(const Sparse& A);  ///< throws SolveError when A is not positive definite
    bool try_factorize(const Sparse& A);  ///< false instead of the SolveError
    Matrix solve(const Matrix& B) const;  ///< (n,k) -> (n,k)

    std::int64_t factorisations() const;  ///< numeric factorisations done so far
    std::int64_t analyses() const;        ///< symbolic ones
    double reciprocal_condition() const;  ///< CHOLMOD's rough estimate min(diag L)^2 / max(diag L)^2

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace toile
