#include "kernels/nricp_graph.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <numeric>

#include "base/parallel.h"

namespace toile {

namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;

Mat3 cross(const Vec3& a) {
    Mat3 m;
    m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
    return m;
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

/// Rows of shares, each ascending in the order visited: counted, then filled.
template <class Each>
NricpGraph::Shares NricpGraph::collect(std::size_t rows, Each&& each) {
    Shares s;
    s.start.assign(rows + 1, 0);
    each([&](std::size_t row, const Share&) { ++s.start[row + 1]; });
    for (std::size_t r = 0; r < rows; ++r) s.start[r + 1] += s.start[r];
    s.of.resize(s.start.back());
    std::vector<std::size_t> next(s.start.begin(), s.start.end() - 1);
    each([&](std::size_t row, const Share& share) { s.of[next[row]++] = share; });
    return s;
}

NricpGraph::NricpGraph(const GeodesicGraph& surface, double radius, const std::vector<int>& matched)
    : nodes_(deformation_nodes(surface, radius)), radius_(radius), matched_(matched),
      is_matched_(static_cast<std::size_t>(surface.size()), 0) {
    const auto& pairs = nodes_.pairs;
    pair_start_.assign(1, 0);
    for (int k = 0; k < nodes_.size(); ++k) {
        std::size_t p = pair_start_.back();
        while (p < pairs.size() && pairs[p].first == k) ++p;
        pair_start_.push_back(p);
    }
    for (int v : matched_) is_matched_[v] = 1;
    carried_ = collect(static_cast<std::size_t>(nodes_.size()), [&](auto&& visit) {
        for (int v = 0; v < surface.size(); ++v)
            for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a)
                visit(nodes_.carrier[a], Share{v, static_cast<float>(nodes_.weight[a])});
    });
    shared_ = collect(pairs.size(), [&](auto&& visit) {
        for (int i = 0; i < static_cast<int>(matched_.size()); ++i) {
            const int v = matched_[i];
            for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a)
                for (int b = a; b < nodes_.start[v + 1]; ++b)
                    visit(pair(nodes_.carrier[a], nodes_.carrier[b]), Share{i, static_cast<float>(nodes_.weight[a] * nodes_.weight[b])});
        }
    });
    std::vector<Eigen::Triplet<double>> entries;
    for (const auto& [k, l] : pairs)
        for (int c = 0; c < 6; ++c)
            for (int r = 0; r < 6; ++r) entries.emplace_back(6 * l + r, 6 * k + c, r == c && k == l ? 1.0 : 0.0);
    H_.resize(6 * nodes_.size(), 6 * nodes_.size());
    H_.setFromTriplets(entries.begin(), entries.end());
    H_.makeCompressed();
    factor.analyze(H_);
}

/// Index of (k, l), k <= l, among the pairs.
std::size_t NricpGraph::pair(int k, int l) const {
    const auto first = nodes_.pairs.begin();
    return static_cast<std::size_t>(std::lower_bound(first + pair_start_[k], first + pair_start_[k + 1], std::pair(k, l)) - first);
}

void NricpGraph::start(const Vertices& rest, const Vertices& rest_N, const Vertices& x) {
    rest_ = rest;
    rest_N_ = rest_N;
    const int count = nodes_.size();
    R_.assign(count, Mat3::Identity());
    centre_.resize(count, 3);
    parallel_for(count, [&](std::int64_t k) {
        Vec3 v0 = Vec3::Zero(), x0 = Vec3::Zero();
        double sum = 0;
        const auto each = [&](auto&& visit) {
            for (std::size_t s = carried_.start[k]; s < carried_.start[k + 1]; ++s)
                visit(double{carried_.of[s].weight}, rest.row(carried_.of[s].at).transpose(), x.row(carried_.of[s].at).transpose());
        };
        each([&](double w, const auto& from, const auto& to) {
            v0 += w * from;
            x0 += w * to;
            sum += w;
        });
        v0 /= sum;
        x0 /= sum;
        Mat3 covariance = Mat3::Zero();
        each([&](double w, const auto& from, const auto& to) { covariance += w * (to - x0) * (from - v0).transpose(); });
        R_[k] = procrustes(covariance);
        centre_.row(k) = (x0 + R_[k] * (rest.row(nodes_.vertex[k]).transpose() - v0)).transpose();
    }, 16);
}

void NricpGraph::place(const std::vector<int>& vertices, Pose& pose) const {
    parallel_for(static_cast<std::int64_t>(vertices.size()), [&](std::int64_t i) {
        const int v = vertices[i];
        Vec3 n = Vec3::Zero(), x = Vec3::Zero();
        for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a) {
            const int k = nodes_.carrier[a];
            x += nodes_.weight[a] * (arm(k, v) + centre_.row(k).transpose());
            n += nodes_.weight[a] * (R_[k] * rest_N_.row(v).transpose());
        }
        if (const double length = n.norm(); length > 0) n /= length;
        pose.V.row(v) = x.transpose();
        pose.N.row(v) = n.transpose();
    });
}

Pose NricpGraph::pose() const {
    Pose whole{Vertices(rest_.rows(), 3), Vertices(rest_.rows(), 3)};
    std::vector<int> all(static_cast<std::size_t>(rest_.rows()));
    std::iota(all.begin(), all.end(), 0);
    place(all, whole);
    return whole;
}

/// Where the block (l, k) lies among the values: column node k holds its pairs one under the other.
Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> NricpGraph::block(std::size_t pair) {
    const auto k = static_cast<std::size_t>(nodes_.pairs[pair].first);
    const std::size_t height = 6 * (pair_start_[k + 1] - pair_start_[k]);
    double* first = H_.valuePtr() + 36 * pair_start_[k] + 6 * (pair - pair_start_[k]);
    return {first, 6, 6, Eigen::OuterStride<>(static_cast<Eigen::Index>(height))};
}

namespace {

/// A vertex's quadratic as one of a rigid motion (omega, delta) of everything about the origin: J' A J and J' b with
/// J = (-[x]x, I).
struct Motion {
    std::array<double, 24> H{};  ///< -[x] A [x] and A as lower triangles, [x] A whole, and padding
    std::array<double, 6> g{};
    bool pulled = false;

    Motion() = default;
    Motion(const Mat3& A, const Vec3& b, const Vec3& x) : pulled(!A.isZero(0)) {
        const Mat3 X = cross(x), XA = X * A, K = -XA * X;
        const Vec3 m = x.cross(b);
        H = {K(0, 0), K(1, 0), K(2, 0), K(1, 1), K(2, 1), K(2, 2), A(0, 0), A(1, 0), A(2, 0), A(1, 1), A(2, 1), A(2, 2),
             XA(0, 0), XA(1, 0), XA(2, 0), XA(0, 1), XA(1, 1), XA(2, 1), XA(0, 2), XA(1, 2), XA(2, 2)};
        g = {m[0], m[1], m[2], b[0], b[1], b[2]};
    }
    void add(double w, const Motion& m) {
        for (int i = 0; i < 24; ++i) H[i] += w * m.H[i];
    }
    Mat6 matrix() const {
        Mat6 M;
        M << H[0], H[1], H[2], H[12], H[15], H[18], H[1], H[3], H[4], H[13], H[16], H[19], H[2], H[4], H[5], H[14], H[17], H[20],
            H[12], H[13], H[14], H[6], H[7], H[8], H[15], H[16], H[17], H[7], H[9], H[10], H[18], H[19], H[20], H[8], H[10], H[11];
        return M;
    }
};

}  // namespace

/// T of a node: J about its centre c is J T, T = (I, 0; [c]x, I). One sum over vertices then serves a pair of nodes.
NricpGraph::Mat6 NricpGraph::about(int node) const {
    Mat6 T = Mat6::Identity();
    T.bottomLeftCorner<3, 3>() = cross(centre_.row(node).transpose());
    return T;
}

void NricpGraph::add_pull(const Pull& pull, const Vertices& x, Vector& gradient) {
    const auto motion_of = [&](int v) { return Motion(pull.A[v], pull.b.row(v).transpose(), x.row(v).transpose()); };
    std::vector<Motion> motion(matched_.size());
    parallel_for(static_cast<std::int64_t>(matched_.size()), [&](std::int64_t i) { motion[i] = motion_of(matched_[i]); });
    parallel_for(static_cast<std::int64_t>(nodes_.pairs.size()), [&](std::int64_t p) {
        const auto [k, l] = nodes_.pairs[p];
        Motion sum;
        for (std::size_t s = shared_.start[p]; s < shared_.start[p + 1]; ++s) {
            const Motion& m = motion[shared_.of[s].at];
            if (!m.pulled) continue;
            const double w = shared_.of[s].weight;
            sum.add(w, m);
            if (k == l)
                for (int i = 0; i < 6; ++i) sum.g[i] += std::sqrt(w) * m.g[i];
        }
        block(p) = about(l).transpose() * sum.matrix() * about(k);
        if (k == l) gradient.segment<6>(6 * k) = about(k).transpose() * Eigen::Map<const Eigen::Matrix<double, 6, 1>>(sum.g.data());
    }, 8);
    for (int v : pull.marked) {
        if (is_matched_[v]) continue;
        const Motion m = motion_of(v);
        for (int a = nodes_.start[v]; a < nodes_.start[v + 1]; ++a) {
            const int k = nodes_.carrier[a];
            gradient.segment<6>(6 * k) += nodes_.weight[a] * about(k).transpose() * Eigen::Map<const Eigen::Matrix<double, 6, 1>>(m.g.data());
            for (int b = a; b < nodes_.start[v + 1]; ++b)
                block(pair(k, nodes_.carrier[b])) += nodes_.weight[a] * nodes_.weight[b] * about(nodes_.carrier[b]).transpose() * m.matrix() * about(k);
        }
    }
}

void NricpGraph::step(const Pull& pull, const Vertices& x, double stiffness, double rotation_weight) {
    Vector gradient = Vector::Zero(6 * nodes_.size());
    add_pull(pull, x, gradient);
    add_rigidity(stiffness, rotation_weight, gradient);
    constexpr double damping = 1e-6;
    const double ridge = damping * std::max(H_.diagonal().mean(), 1e-12);
    for (int k = 0; k < nodes_.size(); ++k) block(pair_start_[k]).diagonal().array() += ridge;
    factor.factorize(H_);
    const Matrix update = factor.solve(gradient);
    for (int k = 0; k < nodes_.size(); ++k) {
        R_[k] = rotation_of(update.block<3, 1>(6 * k, 0)) * R_[k];
        centre_.row(k) += update.block<3, 1>(6 * k + 3, 0).transpose();
    }
}

/// Mean over neighbours of |R_k (g_l - g_k) + c_k - c_l|^2, both ways, and of radius^2 |log R_l R_k'|^2.
void NricpGraph::add_rigidity(double stiffness, double rotation_weight, Vector& gradient) {
    const auto& pairs = nodes_.pairs;
    const std::size_t count = pairs.size() - static_cast<std::size_t>(nodes_.size());
    if (count == 0) return;
    const double alpha = stiffness / static_cast<double>(count), beta = alpha * rotation_weight * radius_ * radius_;
    const Mat3 I = Mat3::Identity();
    for (std::size_t p = 0; p < pairs.size(); ++p) {
        const auto [k, l] = pairs[p];
        if (k == l) continue;
        auto kk = block(pair_start_[k]), ll = block(pair_start_[l]), lk = block(p);
        const auto hinge = [&](int from, int to, auto& own, auto& other) {  // `from` predicts the centre of `to`
            const Vec3 a = arm(from, nodes_.vertex[to]), r = (centre_.row(to) - centre_.row(from)).transpose() - a;
            const Mat3 X = cross(a);
            own.template topLeftCorner<3, 3>() -= alpha * X * X;
            own.template topRightCorner<3, 3>() += alpha * X;
            own.template bottomLeftCorner<3, 3>() -= alpha * X;
            own.template bottomRightCorner<3, 3>() += alpha * I;
            other.template bottomRightCorner<3, 3>() += alpha * I;
            if (from == k) lk.template bottomLeftCorner<3, 3>() += alpha * X;
            else lk.template topRightCorner<3, 3>() -= alpha * X;
            lk.template bottomRightCorner<3, 3>() -= alpha * I;
            gradient.segment<3>(6 * from) += alpha * a.cross(r);
            gradient.segment<3>(6 * from + 3) += alpha * r;
            gradient.segment<3>(6 * to + 3) -= alpha * r;
        };
        hinge(k, l, kk, ll);
        hinge(l, k, ll, kk);
        const Vec3 difference = rotation_vector(R_[l] * R_[k].transpose());
        kk.topLeftCorner<3, 3>() += beta * I;
        ll.topLeftCorner<3, 3>() += beta * I;
        lk.topLeftCorner<3, 3>() -= beta * I;
        gradient.segment<3>(6 * k) += beta * difference;
        gradient.segment<3>(6 * l) -= beta * difference;
    }
}

}  // namespace toile
