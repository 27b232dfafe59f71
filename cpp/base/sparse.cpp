#include "base/sparse.h"

#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>

#include <algorithm>
#include <array>
#include <vector>

#include "base/cholmod_state.h"
#include "base/errors.h"

namespace toile {

namespace {

// Threads inside BLAS would change the order of sums. The symbol exists only where OpenBLAS serves as BLAS. Whoever else uses
// that may have set another number since the last factorisation.
void use_one_blas_thread() {
    using Setter = void (*)(int);
    static const auto set = reinterpret_cast<Setter>(dlsym(RTLD_DEFAULT, "openblas_set_num_threads"));
    if (set) set(1);
}

/// Calls `work`, which does not throw, on this thread with teams of one: CHOLMOD opens a team of four at every supernode,
/// whatever the number of threads asked for; their waiting costs up to thirty times the factorisation. A league of one team
/// limits the thread that opens it alone. (omp_set_max_active_levels limits every thread of older runtimes, one of which
/// comes with torch: who was about to open a team there waited for ever for the others.) Those count the leagues of all
/// threads as one, and may call a league's work twice or not at all.
template <class Work>
void without_teams(const Work& work) {
    bool done = false;
    while (!done) {
#pragma omp teams num_teams(1) thread_limit(1) default(none) shared(done, work)
        if (!done) {
            work();
            done = true;
        }
    }
}

/// METIS orders large matrices by the C library's rand(), which it seeds anew for each: of two analyses side by side neither
/// would get its own numbers.
Turn::Holder ordering{0};
[[maybe_unused]] const int handler = pthread_atfork(nullptr, nullptr, [] { ordering = 0; });

/// METIS catches these signals while it orders, and gives them back as handlers of System V, which serve once. They get their
/// flags back here, unless another thread has set another handler meanwhile.
class Signals {
public:
    Signals() {
        for (std::size_t k = 0; k < caught.size(); ++k) sigaction(caught[k], nullptr, &before_[k]);
    }
    ~Signals() {
        for (std::size_t k = 0; k < caught.size(); ++k) {
            struct sigaction now {};
            sigaction(caught[k], nullptr, &now);
            if (now.sa_handler == before_[k].sa_handler) sigaction(caught[k], &before_[k], nullptr);
        }
    }
    Signals(const Signals&) = delete;
    Signals& operator=(const Signals&) = delete;

private:
    static constexpr std::array<int, 2> caught{SIGTERM, SIGABRT};
    std::array<struct sigaction, 2> before_{};
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

/// A row of four right-hand sides in one register. (gcc 12 copies an Eigen array of this size through memory.)
using Four = double __attribute__((vector_size(32)));

/// Substitution in a supernodal factor, four right-hand sides and four columns at a time, so that each entry of L is
/// read once and serves all of them. (CHOLMOD's own solve copies between layouts and calls BLAS for each panel.)
class Panels {
public:
    explicit Panels(const cholmod_factor& L)
        : count_(static_cast<int>(L.nsuper)), first_(static_cast<const int*>(L.super)),
          rows_begin_(static_cast<const int*>(L.pi)), values_begin_(static_cast<const int*>(L.px)),
          rows_(static_cast<const int*>(L.s)), values_(static_cast<const double*>(L.x)) {}

    void forward(Four* x) const {  ///< x <- L^-1 x
        for (int s = 0; s < count_; ++s) {
            const Panel p = panel(s);
            for (int j = 0; j < p.columns; j += 4)
                p.columns - j >= 4 ? forward_columns<4>(p, j, x) : forward_rest(p, j, x);
        }
    }
    void backward(Four* x) const {  ///< x <- L^-T x
        for (int s = count_ - 1; s >= 0; --s) {
            const Panel p = panel(s);
            const int whole = p.columns / 4 * 4;
            if (whole < p.columns) backward_rest(p, whole, x);
            for (int j = whole - 4; j >= 0; j -= 4) backward_columns<4>(p, j, x);
        }
    }

private:
    struct Panel {
        int columns, height;  // dense lower trapezoid, its first `columns` rows being those columns
        const int* rows;
        const double* values;  // column after column, each of `height` entries
    };

    Panel panel(int s) const {
        return {first_[s + 1] - first_[s], rows_begin_[s + 1] - rows_begin_[s], rows_ + rows_begin_[s],
                values_ + values_begin_[s]};
    }

    template <int K>
    static void forward_columns(const Panel& p, int j, Four* x) {
        const double* column[K];
        Four known[K];
        for (int k = 0; k < K; ++k) column[k] = p.values + static_cast<std::ptrdiff_t>(j + k) * p.height;
        for (int k = 0; k < K; ++k) {
            known[k] = x[p.rows[j + k]];
            for (int i = 0; i < k; ++i) known[k] -= column[i][j + k] * known[i];
            known[k] /= column[k][j + k];
            x[p.rows[j + k]] = known[k];
        }
        for (int i = j + K; i < p.height; ++i) {
            Four row = x[p.rows[i]];
            for (int k = 0; k < K; ++k) row -= column[k][i] * known[k];
            x[p.rows[i]] = row;
        }
    }
    template <int K>
    static void backward_columns(const Panel& p, int j, Four* x) {
        const double* column[K];
        Four sum[K];
        for (int k = 0; k < K; ++k) {
            column[k] = p.values + static_cast<std::ptrdiff_t>(j + k) * p.height;
            sum[k] = x[p.rows[j + k]];
        }
        for (int i = j + K; i < p.height; ++i) {
            const Four row = x[p.rows[i]];
            for (int k = 0; k < K; ++k) sum[k] -= column[k][i] * row;
        }
        for (int k = K - 1; k >= 0; --k) {
            for (int i = k + 1; i < K; ++i) sum[k] -= column[k][j + i] * sum[i];
            sum[k] /= column[k][j + k];
            x[p.rows[j + k]] = sum[k];
        }
    }
    static void forward_rest(const Panel& p, int j, Four* x) {
        switch (p.columns - j) {
            case 1: return forward_columns<1>(p, j, x);
            case 2: return forward_columns<2>(p, j, x);
            default: return forward_columns<3>(p, j, x);
        }
    }
    static void backward_rest(const Panel& p, int j, Four* x) {
        switch (p.columns - j) {
            case 1: return backward_columns<1>(p, j, x);
            case 2: return backward_columns<2>(p, j, x);
            default: return backward_columns<3>(p, j, x);
        }
    }

    int count_;
    const int *first_, *rows_begin_, *values_begin_, *rows_;
    const double* values_;
};

}  // namespace

bool CholeskyFactor::State::analysed(const Sparse& A) const {
    return factor && static_cast<std::size_t>(A.outerSize()) + 1 == outer.size() &&
           static_cast<std::size_t>(A.nonZeros()) == inner.size() &&
           std::equal(outer.begin(), outer.end(), A.outerIndexPtr()) &&
           std::equal(inner.begin(), inner.end(), A.innerIndexPtr());
}

CholeskyFactor::State::State() {
    cholmod_start(&common);
    common.supernodal = CHOLMOD_SUPERNODAL;
    common.final_ll = 1;
    common.print = 0;
    common.error_handler = nullptr;
}

CholeskyFactor::State::~State() {
    cholmod_free_factor(&factor, &common);
    cholmod_finish(&common);
}

CholeskyFactor::CholeskyFactor() : state_(std::make_unique<State>()) {}
CholeskyFactor::~CholeskyFactor() = default;
CholeskyFactor::CholeskyFactor(CholeskyFactor&&) noexcept = default;
CholeskyFactor& CholeskyFactor::operator=(CholeskyFactor&&) noexcept = default;

void CholeskyFactor::State::analyze(const Sparse& A) {
    require(A.rows() == A.cols(),
            "cholesky: A has " + std::to_string(A.rows()) + " rows and " + std::to_string(A.cols()) + " columns");
    require(A.isCompressed(), "cholesky: A is not compressed");
    cholmod_free_factor(&factor, &common);
    sound = false;
    cholmod_sparse view = lower_view(A);
    {
        const Turn turn(ordering, "cholesky");
        const Signals signals;
        factor = cholmod_analyze(&view, &common);
    }
    if (!factor) throw SolveError("cholesky: the symbolic analysis failed");
    outer.assign(A.outerIndexPtr(), A.outerIndexPtr() + A.outerSize() + 1);
    inner.assign(A.innerIndexPtr(), A.innerIndexPtr() + A.nonZeros());
    ++analyses;
}

void CholeskyFactor::analyze(const Sparse& A) {
    const Calls::Writing alone(state_->calls, "cholesky");
    state_->analyze(A);
}

CholeskyFactor CholeskyFactor::symbolic() const {
    const Calls::Reading together(state_->calls, "cholesky");
    require(state_->factor && state_->factor->xtype == CHOLMOD_PATTERN, "cholesky: nothing but an analysis is copied");
    CholeskyFactor copy;
    copy.state_->factor = cholmod_copy_factor(state_->factor, &copy.state_->common);
    if (!copy.state_->factor) throw SolveError("cholesky: out of memory");
    copy.state_->outer = state_->outer;
    copy.state_->inner = state_->inner;
    return copy;
}

void CholeskyFactor::State::factorize(const Sparse& A) {
    if (!analysed(A)) analyze(A);
    cholmod_sparse view = lower_view(A);
    ++factorisations;
    sound = false;
    use_one_blas_thread();
    without_teams([&] { cholmod_factorize(&view, factor, &common); });
    if (common.status < CHOLMOD_OK) throw SolveError("cholesky: out of memory or too large a problem");
    sound = common.status == CHOLMOD_OK && factor->minor == factor->n;
}

bool CholeskyFactor::try_factorize(const Sparse& A) {
    const Calls::Writing alone(state_->calls, "cholesky");
    state_->factorize(A);
    return state_->sound;
}

void CholeskyFactor::factorize(const Sparse& A) {
    const Calls::Writing alone(state_->calls, "cholesky");
    state_->factorize(A);
    if (!state_->sound)
        throw SolveError("cholesky: the matrix is not positive definite (column " +
                         std::to_string(state_->factor->minor) + ")");
}

Matrix CholeskyFactor::solve(const Matrix& B) const {
    const Calls::Reading together(state_->calls, "cholesky");
    const State& s = *state_;
    if (!s.sound) throw SolveError("cholesky: solve without a factor");
    require(B.rows() == static_cast<Eigen::Index>(s.factor->n),
            "cholesky: B has " + std::to_string(B.rows()) + " rows, the factor " + std::to_string(s.factor->n));
    const Panels panels(*s.factor);
    const int* order = static_cast<const int*>(s.factor->Perm);
    Matrix X(B.rows(), B.cols());
    std::vector<Four> x(static_cast<std::size_t>(B.rows()));
    for (Eigen::Index c = 0; c < B.cols(); c += 4) {
        const Eigen::Index width = std::min<Eigen::Index>(4, B.cols() - c);
        for (Eigen::Index i = 0; i < B.rows(); ++i) {
            Four row{};
            for (Eigen::Index k = 0; k < width; ++k) row[k] = B(order[i], c + k);
            x[static_cast<std::size_t>(i)] = row;
        }
        panels.forward(x.data());
        panels.backward(x.data());
        for (Eigen::Index i = 0; i < B.rows(); ++i)
            for (Eigen::Index k = 0; k < width; ++k) X(order[i], c + k) = x[static_cast<std::size_t>(i)][k];
    }
    return X;
}

std::int64_t CholeskyFactor::factorisations() const { return state_->factorisations; }
std::int64_t CholeskyFactor::analyses() const { return state_->analyses; }
double CholeskyFactor::reciprocal_condition() const {
    const Calls::Writing alone(state_->calls, "cholesky");  // `common` is written
    return cholmod_rcond(state_->factor, &state_->common);
}

}  // namespace toile
