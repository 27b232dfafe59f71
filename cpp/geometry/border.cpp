#include "geometry/border.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>

#include <tuple>

#include "geometry/weld.h"

namespace toile {

namespace {

using Row = Eigen::RowVector3d;

struct BorderEdge {
    int from, to, third;  ///< from < to, and the face's other corner
    bool operator<(const BorderEdge& o) const { return std::tie(from, to, third) < std::tie(o.from, o.to, o.third); }
};

std::vector<BorderEdge> border_edges(const Faces& F, Eigen::Index n) {
    const std::vector<char> open = open_vertices(F, n);
    std::vector<BorderEdge> all, once;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c)
            if (const int i = F(f, c), j = F(f, (c + 1) % 3); open[i] && open[j])
                all.push_back({std::min(i, j), std::max(i, j), F(f, (c + 2) % 3)});
    std::sort(all.begin(), all.end());
    const auto same = [](const BorderEdge& a, const BorderEdge& b) { return a.from == b.from && a.to == b.to; };
    for (std::size_t i = 0; i < all.size(); ++i)
        if ((i == 0 || !same(all[i], all[i - 1])) && (i + 1 == all.size() || !same(all[i], all[i + 1])))
            once.push_back(all[i]);
    return once;
}

/// Edges on the border, and which of them meet in a vertex.
struct Network {
    std::vector<BorderEdge> edges;
    std::vector<Row> off;              ///< conormals of the edges
    std::vector<std::vector<int>> at;  ///< edges of each vertex

    Network(const Vertices& V, const Faces& F)
        : edges(border_edges(F, V.rows())), at(static_cast<std::size_t>(V.rows())) {
        for (int e = 0; e < static_cast<int>(edges.size()); ++e) {
            const auto& [i, j, k] = edges[e];
            at[i].push_back(e);
            at[j].push_back(e);
            const Row along = (V.row(j) - V.row(i)).normalized(), in = V.row(k) - V.row(i);
            off.push_back((along * along.dot(in) - in).normalized());
        }
    }
    int beyond(int edge, int v) const { return edges[edge].from == v ? edges[edge].to : edges[edge].from; }

    /// All vertices connected to one, ascending, marked as seen.
    std::vector<int> connected(int first, std::vector<char>& seen) const {
        std::vector<int> reached{first};
        seen[first] = 1;
        for (std::size_t r = 0; r < reached.size(); ++r)
            for (int e : at[reached[r]])
                if (const int v = beyond(e, reached[r]); !seen[v]) {
                    seen[v] = 1;
                    reached.push_back(v);
                }
        std::sort(reached.begin(), reached.end());
        return reached;
    }
};

}  // namespace

double Border::total() const { return std::accumulate(length.begin(), length.end(), 0.0); }

Row Border::facing() const {
    Row sum = Row::Zero();
    for (std::size_t i = 0; i < vertex.size(); ++i) sum += length[i] * conormal.row(static_cast<Eigen::Index>(i));
    return sum / std::max(total(), 1e-300);
}

std::vector<Border> borders(const Vertices& V, const Vertices& N, const Faces& F) {
    const Network network(V, F);
    std::vector<char> seen(static_cast<std::size_t>(V.rows()), 0);
    std::vector<Border> found;
    for (int first = 0; first < V.rows(); ++first) {
        if (network.at[first].empty() || seen[first]) continue;
        Border border;
        std::vector<Row> conormal;
        for (int v : network.connected(first, seen)) {
            if (network.at[v].size() != 2) continue;
            const int e = network.at[v][0], f = network.at[v][1];
            std::array<int, 2> ends{network.beyond(e, v), network.beyond(f, v)};
            const double a = (V.row(ends[0]) - V.row(v)).norm(), b = (V.row(ends[1]) - V.row(v)).norm();
            const Row mean = a * network.off[e] + b * network.off[f];
            if (mean.isZero(0)) continue;
            if ((V.row(ends[1]) - V.row(ends[0])).cross(N.row(v)).dot(mean) < 0) std::swap(ends[0], ends[1]);
            border.vertex.push_back(v);
            border.beside.push_back(ends);
            border.length.push_back((a + b) / 2);
            conormal.push_back(mean.normalized());
        }
        const auto count = static_cast<Eigen::Index>(conormal.size());
        border.conormal.resize(count, 3);
        for (Eigen::Index i = 0; i < count; ++i) border.conormal.row(i) = conormal[i];
        if (!border.vertex.empty()) found.push_back(std::move(border));
    }
    return found;
}

}  // namespace toile
