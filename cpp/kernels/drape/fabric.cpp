#include "kernels/drape/fabric.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>

#include "base/errors.h"
#include "base/parallel.h"
#include "geometry/topology.h"

namespace toile {

namespace {

constexpr double lightest = 0.1;      // of the mean mass: across needles masses would differ by any factor
constexpr double shortest = 0.1;      // of the mean length: what the strain of needles is told by
constexpr double thinnest = 1e-3;     // area of a face over its longest side squared: cotangents beyond say nothing
constexpr std::int64_t grain = 2048;  // constraints; fewer are not worth another thread

/// Row of edges, sorted, that joins a and b.
Eigen::Index edge_row(const Edges& edges, int a, int b) {
    const std::array<int, 2> want{std::min(a, b), std::max(a, b)};
    Eigen::Index low = 0, high = edges.rows();
    while (low < high) {
        const Eigen::Index middle = (low + high) / 2;
        if (std::array<int, 2>{edges(middle, 0), edges(middle, 1)} < want)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

bool has_three_corners(const Faces& F, Eigen::Index f) {
    return F(f, 0) != F(f, 1) && F(f, 1) != F(f, 2) && F(f, 2) != F(f, 0);
}

/// Of a triangle with these sides (Heron); 0 where they do not close.
double area_of(double a, double b, double c) {
    const double s = (a + b + c) / 2;
    return std::sqrt(std::max(0.0, s * (s - a) * (s - b) * (s - c)));
}

/// Reorders `items` by colour, first come first served: items of a colour share no vertex. What finds none of 32 colours
/// free, at vertices of very many edges, comes last.
template <class Item, class Vertices>
Colours colour(std::vector<Item>& items, Eigen::Index n, Vertices&& vertices) {
    constexpr int most = 32;
    std::vector<std::uint32_t> taken(static_cast<std::size_t>(n), 0);
    std::vector<std::vector<Item>> groups(most + 1);
    for (const Item& item : items) {
        std::uint32_t used = 0;
        for (int v : vertices(item)) used |= taken[static_cast<std::size_t>(v)];
        const int c = std::countr_one(used);
        if (c < most)
            for (int v : vertices(item)) taken[static_cast<std::size_t>(v)] |= std::uint32_t{1} << c;
        groups[static_cast<std::size_t>(c)].push_back(item);
    }
    items.clear();
    Colours out;
    for (const auto& group : groups) {
        items.insert(items.end(), group.begin(), group.end());
        out.start.push_back(static_cast<int>(items.size()));
    }
    return out;
}

template <class Solve>
void sweep(const Colours& colours, Solve&& solve) {
    const std::size_t last = colours.start.size() - 2;
    for (std::size_t c = 0; c < last; ++c) {
        const int begin = colours.start[c];
        parallel_for(colours.start[c + 1] - begin, [&](std::int64_t k) { solve(begin + k); }, grain);
    }
    for (int k = colours.start[last]; k < colours.start[last + 1]; ++k) solve(k);
}

}  // namespace

Fabric::Fabric(const Faces& F, Eigen::Index n, const Vector& lengths, double density, double stretch, double bending)
    : mass_(Vector::Zero(n)) {
    const Edges edges = unique_edges(F);
    require(lengths.size() == edges.rows(), "drape: lengths has " + std::to_string(lengths.size()) +
                                                " entries, cloth_F has " + std::to_string(edges.rows()) + " edges");
    Vector edge_area = Vector::Zero(edges.rows());
    for (Eigen::Index f = 0; f < F.rows(); ++f) {
        if (!has_three_corners(F, f)) continue;
        std::array<Eigen::Index, 3> side;
        for (int c = 0; c < 3; ++c) side[c] = edge_row(edges, F(f, c), F(f, (c + 1) % 3));
        const double area = area_of(lengths[side[0]], lengths[side[1]], lengths[side[2]]);
        for (int c = 0; c < 3; ++c) edge_area[side[c]] += area, mass_[F(f, c)] += density * area / 3;
    }
    const double total = mass_.sum();
    require(total > 0 && std::isfinite(total), "drape: lengths leave the faces of cloth_F no area");
    const double least = lightest * total / static_cast<double>((mass_.array() > 0).count());
    for (double& m : mass_)
        if (m > 0) m = std::max(m, least);
    add_edges(edges, lengths, edge_area, stretch);
    add_hinges(F, edges, lengths, bending);
}

void Fabric::add_edges(const Edges& edges, const Vector& lengths, const Vector& areas, double stretch) {
    for (Eigen::Index e = 0; e < edges.rows(); ++e)
        if (edges(e, 0) != edges(e, 1) && areas[e] > 0)
            edges_.push_back({edges(e, 0), edges(e, 1), lengths[e], lengths[e] * lengths[e] / (stretch * areas[e])});
    edge_colours_ = colour(edges_, mass_.size(), [](const Edge& e) { return std::array<int, 2>{e.i, e.j}; });
}

void Fabric::add_hinges(const Faces& F, const Edges& edges, const Vector& lengths, double bending) {
    if (bending == 0) return;
    struct Side {
        int face = -1, corner = -1, count = 0;
    };
    const auto angle = [&](int at, int b, int c) {  // cotangent at the corner `at` of a face, and the face's area
        const double u = lengths[edge_row(edges, at, b)], v = lengths[edge_row(edges, at, c)],
                     w = lengths[edge_row(edges, b, c)], area = area_of(u, v, w);
        const double longest = std::max({u, v, w});
        return area > thinnest * longest * longest ? std::pair((u * u + v * v - w * w) / (4 * area), area)
                                                   : std::pair(0.0, 0.0);
    };
    std::vector<Side> first(static_cast<std::size_t>(edges.rows())), second = first;
    for (int f = 0; f < F.rows(); ++f) {
        if (!has_three_corners(F, f)) continue;
        for (int c = 0; c < 3; ++c) {
            const auto e = static_cast<std::size_t>(edge_row(edges, F(f, c), F(f, (c + 1) % 3)));
            Side& side = first[e].count++ == 0 ? first[e] : second[e];
            side.face = f, side.corner = F(f, (c + 2) % 3);
        }
    }
    for (std::size_t e = 0; e < first.size(); ++e) {
        if (first[e].count != 2 || first[e].corner == second[e].corner) continue;
        const auto row = static_cast<Eigen::Index>(e);
        const int i = edges(row, 0), j = edges(row, 1), k = first[e].corner, l = second[e].corner;
        const auto [ik, one] = angle(i, j, k);
        const auto [jk, same] = angle(j, i, k);
        const auto [il, other] = angle(i, j, l);
        const auto [jl, alike] = angle(j, i, l);
        if (one == 0 || other == 0) continue;
        hinges_.push_back({{i, j, k, l}, {jk + jl, ik + il, -ik - jk, -il - jl}, (one + other) / (3 * bending)});
    }
    hinge_colours_ = colour(hinges_, mass_.size(), [](const Hinge& h) { return h.at; });
}

void Fabric::relax(Vertices& x, const Vector& w, double h) const {
    const double scale = 1 / (h * h);
    sweep(edge_colours_, [&](std::int64_t k) {
        const Edge& e = edges_[static_cast<std::size_t>(k)];
        const Vec3 d = x.row(e.i) - x.row(e.j);
        const double length = d.norm(), sum = w[e.i] + w[e.j] + e.compliance * scale;
        if (!(length > 0) || !(sum > 0)) return;
        const Vec3 push = (e.length - length) / (sum * length) * d;
        x.row(e.i) += w[e.i] * push;
        x.row(e.j) -= w[e.j] * push;
    });
    if (hinges_.empty()) return;
    sweep(hinge_colours_, [&](std::int64_t k) {
        const Hinge& hinge = hinges_[static_cast<std::size_t>(k)];
        Vec3 sum = Vec3::Zero();
        double resistance = hinge.compliance * scale;
        for (int c = 0; c < 4; ++c) {
            sum += hinge.cotangent[c] * x.row(hinge.at[c]);
            resistance += w[hinge.at[c]] * hinge.cotangent[c] * hinge.cotangent[c];
        }
        sum /= resistance;
        for (int c = 0; c < 4; ++c) x.row(hinge.at[c]) -= w[hinge.at[c]] * hinge.cotangent[c] * sum;
    });
}

double Fabric::strain(const Vertices& x) const {
    double mean = 0, most = -1;
    for (const Edge& e : edges_) mean += e.length / static_cast<double>(edges_.size());
    for (const Edge& e : edges_)
        most = std::max(most, ((x.row(e.i) - x.row(e.j)).norm() - e.length) / std::max(e.length, shortest * mean));
    return most;
}

}  // namespace toile
