#include "kernels/nricp/graph.h"

#include <algorithm>
#include <array>
#include <numeric>

#include "base/parallel.h"
#include "geometry/rotation.h"

namespace toile {

namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;

}  // namespace

NricpGraph::NricpGraph(const GeodesicGraph& surface, double radius, const std::vector<int>& matched)
    : system(surface, radius, matched, 6) {}

void NricpGraph::start(const Pose& rest, const Vertices& x) {
    rest_ = rest;
    const int count = system.nodes.size();
    R_.assign(count, Mat3::Identity());
    centre_.resize(count, 3);
    parallel_for(count, [&](std::int64_t k) {
        const auto [R, centre] = system.rigid_fit(static_cast<int>(k), rest.V, x);
        R_[k] = R;
        centre_.row(k) = centre.transpose();
    }, 16);
}

void NricpGraph::place(const std::vector<int>& vertices, Pose& pose) const {
    parallel_for(static_cast<std::int64_t>(vertices.size()), [&](std::int64_t i) {
        const int v = vertices[i];
        Vec3 n = Vec3::Zero(), x = Vec3::Zero();
        for (int a = system.nodes.start[v]; a < system.nodes.start[v + 1]; ++a) {
            const int k = system.nodes.carrier[a];
            x += system.nodes.weight[a] * (arm(k, v) + centre_.row(k).transpose());
            n += system.nodes.weight[a] * (R_[k] * rest_.N.row(v).transpose());
        }
        if (const double length = n.norm(); length > 0) n /= length;
        pose.V.row(v) = x.transpose();
        pose.N.row(v) = n.transpose();
    });
}

Pose NricpGraph::pose() const {
    Pose whole{Vertices(rest_.V.rows(), 3), Vertices(rest_.V.rows(), 3)};
    std::vector<int> all(static_cast<std::size_t>(rest_.V.rows()));
    std::iota(all.begin(), all.end(), 0);
    place(all, whole);
    return whole;
}

namespace {

/// A vertex's quadratic as one of a rigid motion (omega, delta) of everything about the origin: J' A J and J' b with
/// J = (-[x]x, I).
struct Motion {
    std::array<double, 24> H{};  ///< -[x] A [x] and A as lower triangles, [x] A whole, and padding
    Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
    bool pulled = false;

    Motion() = default;
    Motion(const Mat3& A, const Vec3& b, const Vec3& x) : pulled(!A.isZero(0)) {
        const Mat3 X = cross_matrix(x), XA = X * A, K = -XA * X;
        const Vec3 m = x.cross(b);
        H = {K(0, 0), K(1, 0),  K(2, 0),  K(1, 1),  K(2, 1),  K(2, 2),  A(0, 0),  A(1, 0),  A(2, 0),  A(1, 1), A(2, 1),
             A(2, 2), XA(0, 0), XA(1, 0), XA(2, 0), XA(0, 1), XA(1, 1), XA(2, 1), XA(0, 2), XA(1, 2), XA(2, 2)};
        g.head<3>() = m;
        g.tail<3>() = b;
    }
    void add(double w, const Motion& m) {
        for (int i = 0; i < 24; ++i) H[i] += w * m.H[i];
    }
    Mat6 matrix() const {
        Mat6 M;
        M << H[0], H[1], H[2], H[12], H[15], H[18],  //
            H[1], H[3], H[4], H[13], H[16], H[19],   //
            H[2], H[4], H[5], H[14], H[17], H[20],   //
            H[12], H[13], H[14], H[6], H[7], H[8],   //
            H[15], H[16], H[17], H[7], H[9], H[10],  //
            H[18], H[19], H[20], H[8], H[10], H[11];
        return M;
    }
};

}  // namespace

/// T of a node: J about its centre c is J T, T = (I, 0; [c]x, I). One sum over vertices then serves a pair of nodes.
NricpGraph::Mat6 NricpGraph::about(int node) const {
    Mat6 T = Mat6::Identity();
    T.bottomLeftCorner<3, 3>() = cross_matrix(centre_.row(node).transpose());
    return T;
}

void NricpGraph::add_pull(const Pull& pull, const Vertices& x, Matrix& gradient) {
    const DeformationNodes& nodes = system.nodes;
    const auto motion_of = [&](int v) { return Motion(pull.A[v], pull.b.row(v).transpose(), x.row(v).transpose()); };
    const auto count = static_cast<std::int64_t>(system.matched.size());
    std::vector<Motion> motion(system.matched.size());
    parallel_for(count, [&](std::int64_t i) { motion[i] = motion_of(system.matched[i]); });
    parallel_for(static_cast<std::int64_t>(nodes.pairs.size()), [&](std::int64_t p) {
        const auto [k, l] = nodes.pairs[p];
        Motion sum;
        for (std::size_t s = system.shared.start[p]; s < system.shared.start[p + 1]; ++s) {
            const Motion& m = motion[system.shared.of[s].at];
            if (!m.pulled) continue;
            const double w = system.shared.of[s].weight;
            sum.add(w, m);
            if (k == l) sum.g += std::sqrt(w) * m.g;
        }
        system.block(p) = about(l).transpose() * sum.matrix() * about(k);
        if (k == l) gradient.middleRows<6>(6 * k) = about(k).transpose() * sum.g;
    }, 8);
    for (int v : pull.marked) {
        if (system.is_matched[v]) continue;
        const Motion m = motion_of(v);
        for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a) {
            const int k = nodes.carrier[a];
            gradient.middleRows<6>(6 * k) += nodes.weight[a] * about(k).transpose() * m.g;
            for (int b = a; b < nodes.start[v + 1]; ++b) {
                const int l = nodes.carrier[b];
                const double w = nodes.weight[a] * nodes.weight[b];
                system.block(system.pair(k, l)) += w * about(l).transpose() * m.matrix() * about(k);
            }
        }
    }
}

void NricpGraph::step(const Pull& pull, const Vertices& x, double stiffness, double rotation_weight) {
    Matrix update = Matrix::Zero(6 * system.nodes.size(), 1);
    add_pull(pull, x, update);
    add_rigidity(stiffness, rotation_weight, update);
    system.solve_into(update);
    for (int k = 0; k < system.nodes.size(); ++k) {
        R_[k] = rotation_of(update.block<3, 1>(6 * k, 0)) * R_[k];
        centre_.row(k) += update.block<3, 1>(6 * k + 3, 0).transpose();
    }
}

/// Mean over neighbours of |R_k (g_l - g_k) + c_k - c_l|^2, both ways, and of radius^2 |log R_l R_k'|^2.
void NricpGraph::add_rigidity(double stiffness, double rotation_weight, Matrix& gradient) {
    const auto& pairs = system.nodes.pairs;
    const std::size_t count = pairs.size() - static_cast<std::size_t>(system.nodes.size());
    if (count == 0) return;
    const double alpha = stiffness / static_cast<double>(count);
    const double beta = alpha * rotation_weight * system.radius * system.radius;
    const Mat3 I = Mat3::Identity();
    for (std::size_t p = 0; p < pairs.size(); ++p) {
        const auto [k, l] = pairs[p];
        if (k == l) continue;
        auto kk = system.own(k), ll = system.own(l), lk = system.block(p);
        const auto hinge = [&](int from, int to, auto& own, auto& other) {  // `from` predicts the centre of `to`
            const Vec3 a = arm(from, system.nodes.vertex[to]);
            const Vec3 r = (centre_.row(to) - centre_.row(from)).transpose() - a;
            const Mat3 X = cross_matrix(a);
            own.template topLeftCorner<3, 3>() -= alpha * X * X;
            own.template topRightCorner<3, 3>() += alpha * X;
            own.template bottomLeftCorner<3, 3>() -= alpha * X;
            own.template bottomRightCorner<3, 3>() += alpha * I;
            other.template bottomRightCorner<3, 3>() += alpha * I;
            if (from == k)
                lk.template bottomLeftCorner<3, 3>() += alpha * X;
            else
                lk.template topRightCorner<3, 3>() -= alpha * X;
            lk.template bottomRightCorner<3, 3>() -= alpha * I;
            gradient.middleRows<3>(6 * from) += alpha * a.cross(r);
            gradient.middleRows<3>(6 * from + 3) += alpha * r;
            gradient.middleRows<3>(6 * to + 3) -= alpha * r;
        };
        hinge(k, l, kk, ll);
        hinge(l, k, ll, kk);
        const Vec3 difference = rotation_vector(R_[l] * R_[k].transpose());
        kk.topLeftCorner<3, 3>() += beta * I;
        ll.topLeftCorner<3, 3>() += beta * I;
        lk.topLeftCorner<3, 3>() -= beta * I;
        gradient.middleRows<3>(6 * k) += beta * difference;
        gradient.middleRows<3>(6 * l) -= beta * difference;
    }
}

}  // namespace toile
