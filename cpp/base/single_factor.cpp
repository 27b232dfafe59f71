#include <suitesparse/cholmod.h>

#include <algorithm>
#include <cstring>

#include "base/cholmod_state.h"
#include "base/errors.h"
#include "base/sparse.h"

namespace toile {

namespace {

using Eight = float __attribute__((vector_size(32)));

Eight eight_at(const float* p) {
    Eight v;
    std::memcpy(&v, p, sizeof v);
    return v;
}

float sum_of(const Eight& v) { return ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7])); }

/// Sums over i in [begin, end) of the columns a and b, each times the three rows of y.
struct Sums {
    float a[3]{}, b[3]{};
    Sums(const float* a_, const float* b_, const float* y, std::size_t stride, int begin, int end) {
        Eight va[3]{}, vb[3]{};
        int i = begin;
        for (; i + 8 <= end; i += 8) {
            const Eight l = eight_at(a_ + i), m = eight_at(b_ + i);
            for (int c = 0; c < 3; ++c) {
                const Eight at = eight_at(y + c * stride + i);
                va[c] += l * at;
                vb[c] += m * at;
            }
        }
        for (int c = 0; c < 3; ++c) {
            a[c] = sum_of(va[c]), b[c] = sum_of(vb[c]);
            for (int k = i; k < end; ++k) {
                a[c] += a_[k] * y[c * stride + k];
                b[c] += b_[k] * y[c * stride + k];
            }
        }
    }
};

}  // namespace

SingleFactor::SingleFactor(const CholeskyFactor& factor) {
    const Calls::Reading together(factor.state_->calls, "cholesky");
    const CholeskyFactor::State& s = *factor.state_;
    require(s.sound, "cholesky: a preconditioner without a factor");
    const cholmod_factor& L = *s.factor;
    const auto *super = static_cast<const int*>(L.super), *pi = static_cast<const int*>(L.pi),
               *px = static_cast<const int*>(L.px), *rows = static_cast<const int*>(L.s),
               *order = static_cast<const int*>(L.Perm);
    const auto count = static_cast<int>(L.nsuper);
    for (int k = 0; k < count; ++k) {
        const int height = pi[k + 1] - pi[k];
        panels_.push_back({super[k], super[k + 1] - super[k], height, static_cast<std::size_t>(pi[k]),
                           static_cast<std::size_t>(px[k])});
        tallest_ = std::max(tallest_, height);
    }
    rows_.assign(rows, rows + pi[count]);
    order_.assign(order, order + L.n);
    const auto* values = static_cast<const double*>(L.x);
    values_.assign(values, values + px[count]);
}

/// y <- L^-1 y of a panel's own rows, and what they take from those below.
void SingleFactor::forward(const Panel& p, float* __restrict y, std::size_t stride) const {
    const float* const first = values_.data() + p.values;
    const auto column = [&](int j) { return first + static_cast<std::size_t>(j) * p.height; };
    int j = 0;
    for (; j + 2 <= p.columns; j += 2) {
        const float* __restrict a = column(j), * __restrict b = column(j + 1);
        for (int c = 0; c < 3; ++c) {
            float* __restrict at = y + c * stride;
            const float u = at[j] /= a[j], v = at[j + 1] = (at[j + 1] - a[j + 1] * u) / b[j + 1];
            for (int i = j + 2; i < p.height; ++i) at[i] -= a[i] * u + b[i] * v;
        }
    }
    if (j == p.columns) return;
    const float* __restrict a = column(j);
    for (int c = 0; c < 3; ++c) {
        float* __restrict at = y + c * stride;
        const float u = at[j] /= a[j];
        for (int i = j + 1; i < p.height; ++i) at[i] -= a[i] * u;
    }
}

/// y <- L^-T y of a panel's own rows, those below being known.
void SingleFactor::backward(const Panel& p, float* y, std::size_t stride) const {
    const float* const first = values_.data() + p.values;
    const auto column = [&](int j) { return first + static_cast<std::size_t>(j) * p.height; };
    int j = p.columns;
    for (; j >= 2; j -= 2) {
        const float *a = column(j - 2), *b = column(j - 1);
        const Sums known(a, b, y, stride, j, p.height);
        for (int c = 0; c < 3; ++c) {
            float* const at = y + c * stride;
            at[j - 1] = (at[j - 1] - known.b[c]) / b[j - 1];
            at[j - 2] = (at[j - 2] - known.a[c] - a[j - 1] * at[j - 1]) / a[j - 2];
        }
    }
    if (j == 0) return;
    const float* const a = column(0);
    const Sums known(a, a, y, stride, 1, p.height);
    for (int c = 0; c < 3; ++c) y[c * stride] = (y[c * stride] - known.a[c]) / a[0];
}

Vertices SingleFactor::solve(const Vertices& B) const {
    const auto n = order_.size(), stride = static_cast<std::size_t>(tallest_);
    require(B.rows() == static_cast<Eigen::Index>(n),
            "cholesky: B has " + std::to_string(B.rows()) + " rows, the factor " + std::to_string(n));
    std::vector<float> x(3 * n), y(3 * stride);
    for (std::size_t i = 0; i < n; ++i)
        for (int c = 0; c < 3; ++c) x[3 * i + c] = static_cast<float>(B(order_[i], c));
    const auto load = [&](const Panel& p) {
        for (int i = 0; i < p.height; ++i)
            for (int c = 0; c < 3; ++c) y[c * stride + i] = x[3 * rows_[p.rows + i] + c];
    };
    const auto store = [&](const Panel& p, int height) {
        for (int i = 0; i < height; ++i)
            for (int c = 0; c < 3; ++c) x[3 * rows_[p.rows + i] + c] = y[c * stride + i];
    };
    for (const Panel& p : panels_) {
        load(p);
        forward(p, y.data(), stride);
        store(p, p.height);
    }
    for (auto p = panels_.rbegin(); p != panels_.rend(); ++p) {
        load(*p);
        backward(*p, y.data(), stride);
        store(*p, p->columns);
    }
    Vertices X(B.rows(), 3);
    for (std::size_t i = 0; i < n; ++i)
        for (int c = 0; c < 3; ++c) X(order_[i], c) = x[3 * i + c];
    return X;
}

}  // namespace toile
