#include "kernels/inner/displacement.h"

#include <cmath>
#include <utility>

#include "geometry/laplacian.h"

namespace toile {

Sparse smoothness_matrix(const Vertices& V, const Faces& F, const Vector& mass, double length) {
    const Sparse L = cotangent_laplacian(V, F);
    const Vector inverse = mass.cwiseMax(0.01 * length * length).cwiseInverse();
    Sparse Q = L.transpose() * inverse.asDiagonal() * L * std::pow(length, 4);
    Sparse diagonal(V.rows(), V.rows());  // isolated vertices keep a place on the diagonal
    diagonal.setIdentity();
    Q += 0 * diagonal;
    Q.makeCompressed();
    return Q;
}

Weighted::Weighted(const Sparse& smooth, const Vector& mass, std::vector<int> free, const Vertices& known)
    : smooth_(smooth), mass_(mass), free_(std::move(free)), known_(known),
      drawn_(Vertices::Zero(static_cast<Eigen::Index>(free_.size()), 3)) {
    std::vector<int> number(static_cast<std::size_t>(smooth.rows()), -1);
    for (std::size_t i = 0; i < free_.size(); ++i) number[free_[i]] = static_cast<int>(i);
    std::vector<Eigen::Triplet<double>> entries;
    for (int v : free_)
        for (Sparse::InnerIterator it(smooth, v); it; ++it)
            if (const int row = number[it.row()]; row >= 0)
                entries.emplace_back(row, number[v], it.value());
            else
                drawn_.row(number[v]) -= it.value() * known.row(it.row());  // `smooth` is symmetric
    const auto size = static_cast<Eigen::Index>(free_.size());
    part_.resize(size, size);
    part_.setFromTriplets(entries.begin(), entries.end());
}

Vertices Weighted::solve(const Vector& weights, const Vertices& targets) {
    const bool whole = free_.empty();
    if (weights.size() != last_.size() || weights != last_) {
        Sparse A = whole ? smooth_ : part_;
        for (int c = 0; c < A.outerSize(); ++c)
            for (Sparse::InnerIterator it(A, c); it; ++it)
                if (it.row() == it.col()) {
                    const int v = whole ? c : free_[c];
                    it.valueRef() += mass_[v] * weights[v];
                }
        factor_.factorize(A);
        last_ = weights;
    }
    if (whole) return factor_.solve((mass_.asDiagonal() * targets).eval());
    Vertices right = drawn_, d = known_;
    for (std::size_t i = 0; i < free_.size(); ++i) right.row(i) += mass_[free_[i]] * targets.row(free_[i]);
    d(free_, Eigen::all) = factor_.solve(right);
    return d;
}

Fitted fit_displacement(Weighted& system, const Vector& mass, const Evidence& e, const InnerOptions& o, Vertices d) {
    Fitted result;
    const Eigen::Index n = mass.size();
    Vector weights(n);
    Vertices targets(n, 3);
    for (int i = 0; i < o.max_iterations; ++i) {
        double energy = system.smoothness(d);
        for (Eigen::Index v = 0; v < n; ++v) {
            const Vec3 dv = d.row(v), n_v = e.normals.row(v);
            const Vec3 skin_miss = dv - Vec3(e.skin_target.row(v));
            weights[v] = o.prior + o.skin * e.skin[v];
            targets.row(v) = o.skin * e.skin[v] * e.skin_target.row(v);
            double cost = o.prior * dv.squaredNorm() + o.skin * e.skin[v] * skin_miss.squaredNorm();
            const auto draw = [&](double weight, double miss) {  // moves along the normal, stays put across it
                weights[v] += weight;
                targets.row(v) += (weight * (dv + miss * n_v)).transpose();
            };
            const double hidden = 1 - e.skin[v];
            if (const double slack = e.room[v] - n_v.dot(dv); slack < 0) {
                cost += hidden * o.out * slack * slack;
                draw(hidden * o.out, slack);
            }
            if (e.pull[v] > 0) {
                const double miss = e.likely[v] - n_v.dot(dv), pull = hidden * e.pull[v];
                const double q = miss * miss / (o.fit_scale * o.fit_scale);
                cost += pull * miss * miss / (1 + q);
                draw(pull / ((1 + q) * (1 + q)), miss);
            }
            energy += mass[v] * cost;
        }
        result.energy.push_back(energy);
        const Vertices next = system.solve(weights, targets);
        const double moved = (next - d).rowwise().norm().maxCoeff();
        d = next;
        if (moved < o.tolerance) {
            result.converged = true;
            break;
        }
    }
    result.d = d;
    return result;
}

}  // namespace toile
