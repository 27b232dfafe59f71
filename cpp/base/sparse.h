// Sparse Cholesky: CHOLMOD's supernodal LL' behind one small class that keeps its symbolic and numeric factors.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "types.h"

namespace toile {

/// LL' of a symmetric positive definite matrix (lower triangle is read). Movable, not copyable.
///
/// `analyze` fixes the fill-reducing ordering and the factor's pattern from A's; `factorize` may then be called any number
/// of times with new values, and analyses again only where A has another pattern; `solve` back-substitutes. One BLAS
/// thread, so bits do not depend on the number of threads. Threads may solve side by side; a call that changes the factor while
/// another is at work on it, or the other way round, is an InputError.
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
    friend class SingleFactor;
    struct State;
    std::unique_ptr<State> state_;
};

/// The numbers of a factor in single precision, for preconditioners: half the memory to read, three right-hand sides at a
/// time. Copyable; knows nothing of the factor it was made from.
class SingleFactor {
public:
    explicit SingleFactor(const CholeskyFactor& factor);
    Vertices solve(const Vertices& B) const;  ///< (n,3) -> (n,3), off by about 1e-6 of the condition

private:
    struct Panel {
        int first, columns, height;  ///< a dense lower trapezoid: its first rows are its own columns
        std::size_t rows, values;    ///< where its rows and its numbers begin
    };
    void forward(const Panel& panel, float* y, std::size_t stride) const;
    void backward(const Panel& panel, float* y, std::size_t stride) const;

    std::vector<Panel> panels_;
    std::vector<int> rows_, order_;
    std::vector<float> values_;
    int tallest_ = 0;
};

}  // namespace toile
