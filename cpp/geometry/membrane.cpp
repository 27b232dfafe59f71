#include "geometry/membrane.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/parallel.h"

namespace toile {

namespace {

constexpr int block_size = 1024;
constexpr double parallel = 1e-3;      // squared sine, below which half-spaces count as one
constexpr double most_opposed = -0.5;  // cosine; the corner of more opposed half-spaces lies too far away to be meant

using Row = Eigen::Vector4d;  // the fourth entry is 0: rows of 32 bytes

/// The nearest point of the half-spaces. Of two that oppose each other the first is kept.
Vec3 project(const Vec3& d, const HalfSpaces& h) {
    if (h.count == 0) return d;
    const double a = h.least[0] - h.normal[0].dot(d);
    const Vec3 first = a > 0 ? Vec3(d + a * h.normal[0]) : d;
    if (h.count == 1 || h.normal[1].dot(first) >= h.least[1]) return first;
    const double b = h.least[1] - h.normal[1].dot(d), cosine = h.normal[0].dot(h.normal[1]);
    if (cosine < most_opposed) return first;
    const Vec3 second = b > 0 ? Vec3(d + b * h.normal[1]) : d;
    if (h.normal[0].dot(second) >= h.least[0]) return second;
    const double sine2 = 1 - cosine * cosine;
    if (sine2 < parallel) return b > a ? second : first;
    return d + (a - cosine * b) / sine2 * h.normal[0] + (b - cosine * a) / sine2 * h.normal[1];
}

/// Vertices by breadth-first search from the smallest vertex of each component.
std::vector<int> breadth_first(const Adjacency& ring) {
    const auto n = static_cast<std::size_t>(ring.size());
    std::vector<int> order;
    order.reserve(n);
    std::vector<char> seen(n, 0);
    for (int root = 0; root < static_cast<int>(n); ++root) {
        if (seen[static_cast<std::size_t>(root)]) continue;
        seen[static_cast<std::size_t>(root)] = 1;
        order.push_back(root);
        for (std::size_t head = order.size() - 1; head < order.size(); ++head) {
            const auto v = static_cast<std::size_t>(order[head]);
            for (int k = ring.start[v]; k < ring.start[v + 1]; ++k) {
                const int w = ring.index[static_cast<std::size_t>(k)];
                if (!seen[static_cast<std::size_t>(w)]) seen[static_cast<std::size_t>(w)] = 1, order.push_back(w);
            }
        }
    }
    return order;
}

}  // namespace

Membrane::Membrane(const Adjacency& ring) {
    const std::vector<int> order = breadth_first(ring);
    std::vector<int> block(order.size()), row(order.size());
    for (std::size_t k = 0; k < order.size(); ++k)
        block[static_cast<std::size_t>(order[k])] = static_cast<int>(k) / block_size;
    std::vector<int> joints;
    vertex_.reserve(order.size());
    for (std::size_t k = 0; k < order.size(); ++k) {
        const auto v = static_cast<std::size_t>(order[k]);
        if (k % block_size == 0) blocks_.push_back({static_cast<int>(vertex_.size()), 0});
        // One side of a seam is enough: an edge between two blocks needs one end among the joints.
        const bool joint = std::any_of(ring.index.begin() + ring.start[v], ring.index.begin() + ring.start[v + 1],
                                       [&](int w) { return block[static_cast<std::size_t>(w)] > block[v]; });
        (joint ? joints : vertex_).push_back(order[k]);
        blocks_.back().end = static_cast<int>(vertex_.size());
    }
    joints_ = {static_cast<int>(vertex_.size()), static_cast<int>(order.size())};
    vertex_.insert(vertex_.end(), joints.begin(), joints.end());
    for (std::size_t k = 0; k < vertex_.size(); ++k) row[static_cast<std::size_t>(vertex_[k])] = static_cast<int>(k);
    start_.push_back(0);
    for (int vertex : vertex_) {
        const auto v = static_cast<std::size_t>(vertex);
        for (int k = ring.start[v]; k < ring.start[v + 1]; ++k)
            row_.push_back(row[static_cast<std::size_t>(ring.index[static_cast<std::size_t>(k)])]);
        start_.push_back(static_cast<int>(row_.size()));
    }
}

/// One over-relaxed, projected step of row k; returns the square of its length.
double Membrane::update(Matrix& d, int k, const HalfSpaces& bounds, double stiffness, double over) const {
    const int begin = start_[static_cast<std::size_t>(k)], end = start_[static_cast<std::size_t>(k) + 1];
    Row sum = Row::Zero();
    for (int i = begin; i < end; ++i) sum += Eigen::Map<const Row>(d.data() + 4 * row_[static_cast<std::size_t>(i)]);
    Eigen::Map<Row> mine(d.data() + 4 * k);
    const double weight = static_cast<double>(end - begin) + stiffness;
    const Row wanted = mine + over * (sum / weight - mine);
    const Vec3 allowed = project(wanted.head<3>(), bounds);
    const double step = (allowed - mine.head<3>()).squaredNorm();
    mine.head<3>() = allowed;
    return step;
}

int Membrane::relax(Vertices& d, const std::vector<HalfSpaces>& bounds, double stiffness, double tolerance,
                    int max_sweeps) const {
    const auto n = static_cast<Eigen::Index>(vertex_.size());
    Matrix rows = Matrix::Zero(n, 4);
    std::vector<HalfSpaces> planes(vertex_.size());
    for (Eigen::Index k = 0; k < n; ++k) {
        const int v = vertex_[static_cast<std::size_t>(k)];
        rows.row(k).head<3>() = d.row(v);
        planes[static_cast<std::size_t>(k)] = bounds[static_cast<std::size_t>(v)];
    }
    const double radius = 6 / (6 + stiffness);  // of Jacobi's iteration on a regular mesh
    const double over = std::min(1.9, 2 / (1 + std::sqrt(1 - radius * radius)));
    std::vector<double> step(blocks_.size());
    const auto sweep = [&](const Range& range) {
        double largest = 0;
        for (int k = range.begin; k < range.end; ++k)
            largest = std::max(largest, update(rows, k, planes[static_cast<std::size_t>(k)], stiffness, over));
        return largest;
    };
    int sweeps = 0;
    for (double largest = std::numeric_limits<double>::infinity();
         sweeps < max_sweeps && largest > tolerance * tolerance; ++sweeps) {
        parallel_for(static_cast<std::int64_t>(blocks_.size()), [&](std::int64_t b) {
            step[static_cast<std::size_t>(b)] = sweep(blocks_[static_cast<std::size_t>(b)]);
        }, 1);
        largest = sweep(joints_);
        for (double s : step) largest = std::max(largest, s);
    }
    for (Eigen::Index k = 0; k < n; ++k) d.row(vertex_[static_cast<std::size_t>(k)]) = rows.row(k).head<3>();
    return sweeps;
}

}  // namespace toile
