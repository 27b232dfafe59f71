#include "base/sparse.h"

#include <dlfcn.h>
#include <omp.h>
#include <suitesparse/cholmod.h>

#include <cstring>

#include "base/errors.h"

namespace toile {

namespace {

// Threads inside BLAS would change the order of sums. The symbol exists only where OpenBLAS serves as BLAS.
void use_one_blas_thread() {
    using Setter = void (*)(int);
    if (auto set = reinterpret_cast<Setter>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"))) set(1);
}

/// CHOLMOD opens a team of four threads at every supernode, whatever the number of threads asked for; their waiting
/// costs up to thirty times the factorisation. While this lives, the calling thread opens none.
struct WithoutTeams {
    int before = omp_get_max_active_levels();
    WithoutTeams() { omp_set_max_active_levels(0); }
    ~WithoutTeams() { omp_set_max_active_levels(before); }
};

/// A view of the lower triangle of an Eigen matrix; CHOLMOD does not write to it.
cholmod_sparse lower_view(const Sparse& A) {
    cholmod_sparse view{};
    view.nrow = static_cast<std::size_t>(A.rows());
    view.ncol = static_cast<std::size_t>(A.cols());
    view.nzmax = static_cast<std::size_t>(A.nonZeros());
    view.p = const_cast<int*>(A.outerIndexPtr());
    view.i = const_cast<int*>(A.innerIndexPtr());
    view.x = const_cast<double*>(A.valuePtr());
    view.stype = -1;
    view.itype = CHOLMOD_INT;
    view.xtype = CHOLMOD_REAL;
    view.dtype = CHOLMOD_DOUBLE;
    view.sorted = 1;
    view.packed = 1;
    return view;
}

}  // namespace

struct CholeskyFactor::State {
    cholmod_common common{};
    cholmod_factor* factor = nullptr;
    std::int64_t factorisations = 0, analyses = 0;

    State() {
        use_one_blas_thread();
        cholmod_start(&common);
        common.supernodal = CHOLMOD_SUPERNODAL;
        common.final_ll = 1;
        common.print = 0;
        common.error_handler = nullptr;
    }
    ~State() {
        cholmod_free_factor(&factor, &common);
        cholmod_finish(&common);
    }
};

CholeskyFactor::CholeskyFactor() : state_(std::make_unique<State>()) {}
CholeskyFactor::~CholeskyFactor() = default;
CholeskyFactor::CholeskyFactor(CholeskyFactor&&) noexcept = default;
CholeskyFactor& CholeskyFactor::operator=(CholeskyFactor&&) noexcept = default;

void CholeskyFactor::analyze(const Sparse& A) {
    require(A.rows() == A.cols(), "cholesky: A has " + std::to_string(A.rows()) + " rows and " +
                                      std::to_string(A.cols()) + " columns");
    require(A.isCompressed(), "cholesky: A is not compressed");
    cholmod_free_factor(&state_->factor, &state_->common);
    cholmod_sparse view = lower_view(A);
    state_->factor = cholmod_analyze(&view, &state_->common);
    if (!state_->factor) throw SolveError("cholesky: the symbolic analysis failed");
    ++state_->analyses;
}

bool CholeskyFactor::try_factorize(const Sparse& A) {
    if (!state_->factor || state_->factor->n != static_cast<std::size_t>(A.rows())) analyze(A);
    cholmod_sparse view = lower_view(A);
    ++state_->factorisations;
    const WithoutTeams without_teams;
    cholmod_factorize(&view, state_->factor, &state_->common);
    if (state_->common.status < CHOLMOD_OK) throw SolveError("cholesky: out of memory or too large a problem");
    return state_->common.status == CHOLMOD_OK && state_->factor->minor == state_->factor->n;
}

void CholeskyFactor::factorize(const Sparse& A) {
    if (!try_factorize(A))
        throw SolveError("cholesky: the matrix is not positive definite (column " +
                         std::to_string(state_->factor->minor) + ")");
}

Matrix CholeskyFactor::solve(const Matrix& B) const {
    State& s = *state_;
    if (!s.factor || s.factorisations == 0) throw SolveError("cholesky: solve before factorize");
    require(B.rows() == static_cast<Eigen::Index>(s.factor->n), "cholesky: B has " + std::to_string(B.rows()) +
                                                                    " rows, the factor " + std::to_string(s.factor->n));
    if (B.cols() == 0) return B;
    Eigen::MatrixXd columns = B;  // CHOLMOD wants column order
    cholmod_dense rhs{};
    rhs.nrow = rhs.d = static_cast<std::size_t>(columns.rows());
    rhs.ncol = static_cast<std::size_t>(columns.cols());
    rhs.nzmax = rhs.nrow * rhs.ncol;
    rhs.x = columns.data();
    rhs.xtype = CHOLMOD_REAL;
    rhs.dtype = CHOLMOD_DOUBLE;
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, s.factor, &rhs, &s.common);
    if (!x) throw SolveError("cholesky: the back-substitution failed");
    std::memcpy(columns.data(), x->x, sizeof(double) * rhs.nzmax);
    cholmod_free_dense(&x, &s.common);
    return columns;
}

std::int64_t CholeskyFactor::factorisations() const { return state_->factorisations; }
std::int64_t CholeskyFactor::analyses() const { return state_->analyses; }
double CholeskyFactor::reciprocal_condition() const { return cholmod_rcond(state_->factor, &state_->common); }

}  // namespace toile
