#include "kernels/nricp_graph.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>

#include "base/parallel.h"

namespace toile {

namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;
using Mat36 = Eigen::Matrix<double, 3, 6>;

Mat3 cross(const Vec3& a) {
    Mat3 m;
    m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
    return m;
}

/// d(omega x a + delta) / d(omega, delta)
Mat36 jacobian(const Vec3& a) {
    Mat36 J;
    J << -cross(a), Mat3::Identity();
    return J;
}

Mat3 rotation_of(const Vec3& omega) {
    const double angle = omega.norm();
    return angle > 0 ? Eigen::AngleAxisd(angle, omega / angle).toRotationMatrix() : Mat3::Identity();
}

Vec3 rotation_vector(const Mat3& R) {
    const Eigen::AngleAxisd a(R);
    return a.angle() * a.axis();
}

/// Nearest rotation to a covariance sum (x - x0)(v - v0)' (Arun et al. 1987).
Mat3 procrustes(const Mat3& covariance) {
    const Eigen::JacobiSVD<Mat3> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Mat3 U = svd.matrixU();
    if ((U * svd.matrixV().transpose()).determinant() < 0) U.col(2) *= -1;
    return U * svd.matrixV().transpose();
}

}  // namespace

NricpGraph::NricpGraph(const Vertices& rest, const Faces& F, double radius)
    : nodes_(cover_by_nodes(rest, F, radius)), radius_(radius) {
    const auto& pairs = nodes_.pairs;
    const auto find = [&](int k, int l) {
        return static_cast<std::size_t>(std::lower_bound(pairs.begin(), pairs.end(), std::pair(k, l)) - pairs.begin());
    };
    // vertices of each pair, ascending: counted, then filled
    share_start_.assign(pairs.size() + 1, 0);
    const auto each = [&](auto&& visit) {
        for (Eigen::Index v = 0; v < rest.rows(); ++v)
            for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a)
                for (int b = a; b < nodes_.start[v + 1]; ++b)
                    visit(find(nodes_.carrier[a], nodes_.carrier[b]), Share{static_cast<int>(v), nodes_.weight[a] * nodes_.weight[b]});
    };
    each([&](std::size_t pair, const Share&) { ++share_start_[pair + 1]; });
    for (std::size_t p = 0; p < pairs.size(); ++p) share_start_[p + 1] += share_start_[p];
    shares_.resize(share_start_.back());
    std::vector<std::size_t> next(share_start_.begin(), share_start_.end() - 1);
    each([&](std::size_t pair, const Share& share) { shares_[next[pair]++] = share; });

    pair_start_.assign(1, 0);
    for (int k = 0; k < nodes_.size(); ++k) {
        std::size_t p = pair_start_.back();
        while (p < pairs.size() && pairs[p].first == k) ++p;
        pair_start_.push_back(p);
    }
    std::vector<Eigen::Triplet<double>> entries;
    for (const auto& [k, l] : pairs)
        for (int c = 0; c < 6; ++c)
            for (int r = 0; r < 6; ++r) entries.emplace_back(6 * l + r, 6 * k + c, r == c && k == l ? 1.0 : 0.0);
    H_.resize(6 * nodes_.size(), 6 * nodes_.size());
    H_.setFromTriplets(entries.begin(), entries.end());
    H_.makeCompressed();
    factor.analyze(H_);
}

void NricpGraph::start(const Vertices& rest, const Vertices& x) {
    rest_ = rest;
    const int count = nodes_.size();
    R_.assign(count, Mat3::Identity());
    centre_.resize(count, 3);
    parallel_for(count, [&](std::int64_t k) {
        const std::size_t own = pair_start_[k];  // the pair (k, k) comes first: the vertices that k carries
        Vec3 v0 = Vec3::Zero(), x0 = Vec3::Zero();
        double sum = 0;
        for (std::size_t s = share_start_[own]; s < share_start_[own + 1]; ++s) {
            v0 += shares_[s].weight * rest.row(shares_[s].vertex).transpose();
            x0 += shares_[s].weight * x.row(shares_[s].vertex).transpose();
            sum += shares_[s].weight;
        }
        v0 /= sum;
        x0 /= sum;
        Mat3 covariance = Mat3::Zero();
        for (std::size_t s = share_start_[own]; s < share_start_[own + 1]; ++s)
            covariance += shares_[s].weight * (x.row(shares_[s].vertex).transpose() - x0) * (rest.row(shares_[s].vertex) - v0.transpose());
        R_[k] = procrustes(covariance);
        centre_.row(k) = (x0 + R_[k] * (rest.row(nodes_.vertex[k]).transpose() - v0)).transpose();
    }, 16);
    offset_ = Vertices::Zero(x.rows(), 3);
    offset_ = x - positions();
}

Vertices NricpGraph::positions() const {
    Vertices x = offset_;
    parallel_for(x.rows(), [&](std::int64_t v) {
        for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a) {
            const int k = nodes_.carrier[a];
            x.row(v) += nodes_.weight[a] * (arm(k, v).transpose() + centre_.row(k));
        }
    });
    return x;
}

/// Where the block (l, k) lies among the values: column node k holds its pairs one under the other.
Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> NricpGraph::block(std::size_t pair) {
    const auto k = static_cast<std::size_t>(nodes_.pairs[pair].first);
    const std::size_t height = 6 * (pair_start_[k + 1] - pair_start_[k]);
    double* first = H_.valuePtr() + 36 * pair_start_[k] + 6 * (pair - pair_start_[k]);
    return {first, 6, 6, Eigen::OuterStride<>(static_cast<Eigen::Index>(height))};
}

/// `value` is the block (l, k).
void NricpGraph::add_pair(int k, int l, const Mat6& value) {
    const auto& pairs = nodes_.pairs;
    const auto at = std::lower_bound(pairs.begin(), pairs.end(), std::pair(k, l)) - pairs.begin();
    block(static_cast<std::size_t>(at)) += value;
}

void NricpGraph::step(const Pull& pull, double stiffness, double rotation_weight) {
    Vector gradient = Vector::Zero(6 * nodes_.size());
    parallel_for(static_cast<std::int64_t>(nodes_.pairs.size()), [&](std::int64_t p) {
        const auto [k, l] = nodes_.pairs[p];
        Mat6 sum = Mat6::Zero();
        Eigen::Matrix<double, 6, 1> own = Eigen::Matrix<double, 6, 1>::Zero();
        for (std::size_t s = share_start_[p]; s < share_start_[p + 1]; ++s) {
            const auto [v, w] = shares_[s];
            if (pull.A[v].isZero(0)) continue;
            const Mat36 J_l = jacobian(arm(l, v));
            sum.noalias() += J_l.transpose() * (w * pull.A[v] * jacobian(arm(k, v)));
            if (k == l) own += std::sqrt(w) * J_l.transpose() * pull.b.row(v).transpose();
        }
        block(p) = sum;
        if (k == l) gradient.segment<6>(6 * k) = own;
    }, 8);
    add_rigidity(stiffness, rotation_weight, gradient);
    constexpr double damping = 1e-6;
    const double ridge = damping * std::max(H_.diagonal().mean(), 1e-12);
    for (int i = 0; i < H_.rows(); ++i) H_.coeffRef(i, i) += ridge;
    factor.factorize(H_);
    const Matrix update = factor.solve(gradient);
    for (int k = 0; k < nodes_.size(); ++k) {
        R_[k] = rotation_of(update.block<3, 1>(6 * k, 0)) * R_[k];
        centre_.row(k) += update.block<3, 1>(6 * k + 3, 0).transpose();
    }
}

/// Mean over neighbours of |R_k (g_l - g_k) + c_k - c_l|^2, both ways, and of radius^2 |log R_l R_k'|^2.
void NricpGraph::add_rigidity(double stiffness, double rotation_weight, Vector& gradient) {
    std::size_t count = 0;
    for (const auto& [k, l] : nodes_.pairs) count += k != l;
    if (count == 0) return;
    const double alpha = stiffness / static_cast<double>(count), beta = alpha * rotation_weight * radius_ * radius_;
    const auto hinge = [&](int k, int l) {  // node k predicts the centre of l
        const Vec3 a = arm(k, nodes_.vertex[l]);
        const Vec3 r = (centre_.row(l) - centre_.row(k)).transpose() - a;
        const Mat36 J = jacobian(a);
        Mat36 K = Mat36::Zero();
        K.rightCols<3>().setIdentity();
        add_pair(k, k, alpha * J.transpose() * J);
        add_pair(l, l, alpha * K.transpose() * K);
        add_pair(std::min(k, l), std::max(k, l), k < l ? Mat6(-alpha * K.transpose() * J) : Mat6(-alpha * J.transpose() * K));
        gradient.segment<6>(6 * k) += alpha * J.transpose() * r;
        gradient.segment<6>(6 * l) -= alpha * K.transpose() * r;
    };
    Mat6 turn = Mat6::Zero();
    turn.topLeftCorner<3, 3>().setIdentity();
    for (const auto& [k, l] : nodes_.pairs) {
        if (k == l) continue;
        hinge(k, l);
        hinge(l, k);
        const Vec3 difference = rotation_vector(R_[l] * R_[k].transpose());
        add_pair(k, k, beta * turn);
        add_pair(l, l, beta * turn);
        add_pair(k, l, -beta * turn);
        gradient.segment<3>(6 * k) += beta * difference;
        gradient.segment<3>(6 * l) -= beta * difference;
    }
}

}  // namespace toile
