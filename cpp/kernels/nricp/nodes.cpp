#include "kernels/nricp/nodes.h"

#include <algorithm>

#include "geometry/rotation.h"

namespace toile {

namespace {

/// Rows of shares in the order visited: counted, then filled.
template <class Each>
Shares collect(std::size_t rows, Each&& each) {
    Shares s;
    s.start.assign(rows + 1, 0);
    each([&](std::size_t row, const Share&) { ++s.start[row + 1]; });
    for (std::size_t r = 0; r < rows; ++r) s.start[r + 1] += s.start[r];
    s.of.resize(s.start.back());
    std::vector<std::size_t> next(s.start.begin(), s.start.end() - 1);
    each([&](std::size_t row, const Share& share) { s.of[next[row]++] = share; });
    return s;
}

}  // namespace

NodeSystem::NodeSystem(const GeodesicGraph& surface, double radius, const std::vector<int>& matched, int size)
    : nodes(deformation_nodes(surface, radius)), radius(radius), matched(matched),
      is_matched(static_cast<std::size_t>(surface.size()), 0), size_(size) {
    const auto& pairs = nodes.pairs;
    pair_start_.assign(1, 0);
    for (int k = 0; k < nodes.size(); ++k) {
        std::size_t p = pair_start_.back();
        while (p < pairs.size() && pairs[p].first == k) ++p;
        pair_start_.push_back(p);
    }
    for (int v : matched) is_matched[v] = 1;
    carried = collect(static_cast<std::size_t>(nodes.size()), [&](auto&& visit) {
        for (int v = 0; v < surface.size(); ++v)
            for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a)
                visit(nodes.carrier[a], Share{v, static_cast<float>(nodes.weight[a])});
    });
    shared = collect(pairs.size(), [&](auto&& visit) {
        for (int i = 0; i < static_cast<int>(matched.size()); ++i) {
            const int v = matched[i];
            for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a)
                for (int b = a; b < nodes.start[v + 1]; ++b) {
                    const double w = nodes.weight[a] * nodes.weight[b];
                    visit(pair(nodes.carrier[a], nodes.carrier[b]), Share{i, static_cast<float>(w)});
                }
        }
    });
    std::vector<Eigen::Triplet<double>> entries;
    for (const auto& [k, l] : pairs)
        for (int c = 0; c < size; ++c)
            for (int r = 0; r < size; ++r)
                entries.emplace_back(size * l + r, size * k + c, r == c && k == l ? 1.0 : 0.0);
    H_.resize(size * nodes.size(), size * nodes.size());
    H_.setFromTriplets(entries.begin(), entries.end());
    H_.makeCompressed();
    factor.analyze(H_);
}

std::size_t NodeSystem::pair(int k, int l) const {
    const auto first = nodes.pairs.begin();
    const auto found = std::lower_bound(first + pair_start_[k], first + pair_start_[k + 1], std::pair(k, l));
    return static_cast<std::size_t>(found - first);
}

/// Where the block lies among the values: column node k holds its pairs one under the other.
NodeSystem::Block NodeSystem::block(std::size_t pair) {
    const auto k = static_cast<std::size_t>(nodes.pairs[pair].first), side = static_cast<std::size_t>(size_);
    const std::size_t height = side * (pair_start_[k + 1] - pair_start_[k]);
    double* first = H_.valuePtr() + side * side * pair_start_[k] + side * (pair - pair_start_[k]);
    return {first, size_, size_, Eigen::OuterStride<>(static_cast<Eigen::Index>(height))};
}

std::pair<Mat3, Vec3> NodeSystem::rigid_fit(int node, const Vertices& rest, const Vertices& x) const {
    Vec3 v0 = Vec3::Zero(), x0 = Vec3::Zero();
    double sum = 0;
    const auto each = [&](auto&& visit) {
        for (std::size_t s = carried.start[node]; s < carried.start[node + 1]; ++s) {
            const auto [v, weight] = carried.of[s];
            visit(double{weight}, rest.row(v).transpose(), x.row(v).transpose());
        }
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
    const Mat3 R = nearest_rotation(covariance);
    return {R, x0 + R * (rest.row(nodes.vertex[node]).transpose() - v0)};
}

void NodeSystem::solve_into(Matrix& gradient) {
    constexpr double damping = 1e-6;
    const double ridge = damping * std::max(H_.diagonal().mean(), 1e-12);
    for (int k = 0; k < nodes.size(); ++k) own(k).diagonal().array() += ridge;
    factor.factorize(H_);
    gradient = factor.solve(gradient);
}

}  // namespace toile
