#include "kernels/nricp_fine.h"

#include <algorithm>

#include "base/parallel.h"
#include "geometry/topology.h"

namespace toile {

NricpFine::NricpFine(const Vertices& V, const Faces& F) {
    const Edges edges = unique_edges(F);
    std::vector<Eigen::Triplet<double>> entries;
    for (Eigen::Index e = 0; e < edges.rows(); ++e) {
        const int i = edges(e, 0), j = edges(e, 1);
        entries.insert(entries.end(), {{i, i, 1.0}, {j, j, 1.0}, {i, j, -1.0}, {j, i, -1.0}});
        edge_ += (V.row(i) - V.row(j)).norm();
    }
    edge_ /= std::max<Eigen::Index>(edges.rows(), 1);
    laplacian_.resize(V.rows(), V.rows());
    laplacian_.setFromTriplets(entries.begin(), entries.end());
    identity_.resize(V.rows(), V.rows());
    identity_.setIdentity();
    bilaplacian_ = laplacian_ * laplacian_;
    factor.analyze(Sparse(bilaplacian_ + laplacian_ + identity_));
}

Vertices NricpFine::step(const Vertices& anchor, const Vertices& x, const Pull& pull, double length, int sweeps) {
    constexpr double gradient = 0.01, rest = 1e-4;
    const Eigen::Index n = anchor.rows();
    const double q = length * length / (edge_ * edge_) / 3;
    const Sparse K = (q * q / n) * bilaplacian_ + (gradient * q / n) * laplacian_ + (rest / n) * identity_;
    Sparse P = K;
    for (Eigen::Index v = 0; v < n; ++v) P.coeffRef(v, v) += pull.A[v].trace() / 3;
    factor.factorize(P);
    const auto apply = [&](const Vertices& d) {
        Vertices y(n, 3);
        parallel_for(n, [&](std::int64_t v) {
            Eigen::RowVector3d sum = d.row(v) * pull.A[v];
            for (Sparse::InnerIterator it(K, v); it; ++it) sum += it.value() * d.row(it.row());  // K is symmetric
            y.row(v) = sum;
        });
        return y;
    };
    Vertices d = x - anchor, r(n, 3);
    for (Eigen::Index v = 0; v < n; ++v) r.row(v) = pull.b.row(v) + d.row(v) * pull.A[v];
    r -= apply(d);
    Vertices z = factor.solve(r), p = z;
    double rz = r.cwiseProduct(z).sum();
    for (int i = 0; i < sweeps && rz > 0; ++i) {
        const Vertices Ap = apply(p);
        const double alpha = rz / p.cwiseProduct(Ap).sum();
        d += alpha * p;
        r -= alpha * Ap;
        z = factor.solve(r);
        const double next = r.cwiseProduct(z).sum();
        p = z + next / rz * p;
        rz = next;
    }
    return anchor + d;
}

}  // namespace toile
