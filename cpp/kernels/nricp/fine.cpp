#include "kernels/nricp/fine.h"

#include <algorithm>
#include <cmath>

#include "base/parallel.h"
#include "geometry/topology.h"

namespace toile {

namespace {

/// The graph's, which no sliver harms, at the scale of the cotangent Laplacian on equilateral faces.
Sparse laplacian(const Vertices& V, const Faces& F) {
    const Edges edges = unique_edges(F);
    std::vector<Eigen::Triplet<double>> entries;
    for (Eigen::Index e = 0; e < edges.rows(); ++e) {
        const int i = edges(e, 0), j = edges(e, 1);
        entries.insert(entries.end(), {{i, i, 1.0}, {j, j, 1.0}, {i, j, -1.0}, {j, i, -1.0}});
    }
    Sparse L(V.rows(), V.rows());
    L.setFromTriplets(entries.begin(), entries.end());
    return L / std::sqrt(3.0);
}

double dot(const Vertices& a, const Vertices& b) {
    return parallel_sum(a.rows(), 0.0, [&](double& sum, std::int64_t v) { sum += a.row(v).dot(b.row(v)); }, 2048);
}

}  // namespace

NricpFine::NricpFine(const Vertices& V, const Faces& F, const Vector& area) : mass_(area.cwiseMax(1e-3 * area.mean())) {
    const Sparse L = laplacian(V, F);
    bilaplacian_ = L * mass_.cwiseInverse().asDiagonal() * L;
    analysis_.analyze(Sparse(bilaplacian_ + Sparse(mass_.asDiagonal())));
}

NricpFine::Level& NricpFine::level(double length) {
    const int key = static_cast<int>(std::lround(2 * std::log2(length)));
    const auto found = levels_.find(key);
    if (found != levels_.end()) return found->second;
    constexpr double rest = 1e-4, matched = 1.0 / 3;
    const double wave = std::pow(2.0, key / 2.0);
    const Sparse M(mass_.asDiagonal());
    Sparse K = std::pow(wave, 4) * bilaplacian_ + rest * M;
    CholeskyFactor factor = analysis_.symbolic();
    factor.factorize(Sparse(K + matched * M));
    analyses_ += factor.analyses();
    return levels_.emplace(key, Level{std::move(K), SingleFactor(factor)}).first->second;
}

Vertices NricpFine::step(const Vertices& anchor, const Vertices& x, const Pull& pull, double length, int sweeps) {
    const Level& own = level(length);
    const Eigen::Index n = anchor.rows();
    const auto apply = [&](const Vertices& d) {
        Vertices y(n, 3);
        parallel_for(n, [&](std::int64_t v) {
            Eigen::RowVector3d sum = d.row(v) * pull.A[v];
            for (Sparse::InnerIterator it(own.K, v); it; ++it) sum += it.value() * d.row(it.row());  // K is symmetric
            y.row(v) = sum;
        });
        return y;
    };
    Vertices d = x - anchor, r(n, 3);
    for (Eigen::Index v = 0; v < n; ++v) r.row(v) = pull.b.row(v) + d.row(v) * pull.A[v];
    r -= apply(d);
    Vertices z = own.factor.solve(r), p = z;
    double rz = dot(r, z);
    for (int i = 0; i < sweeps && rz > 0; ++i) {
        const Vertices Ap = apply(p);
        const double alpha = rz / dot(p, Ap);
        d += alpha * p;
        if (i + 1 == sweeps) break;
        r -= alpha * Ap;
        z = own.factor.solve(r);
        const double next = dot(r, z);
        p = z + next / rz * p;
        rz = next;
    }
    return anchor + d;
}

}  // namespace toile
