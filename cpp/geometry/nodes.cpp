#include "geometry/nodes.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <queue>

#include "base/parallel.h"
#include "geometry/closest.h"
#include "geometry/topology.h"

namespace toile {

namespace {

struct Link {
    int from, to;
    double length;
};

/// Every vertex of the smaller components to the closest face of the largest.
std::vector<Link> component_links(const Vertices& V, const Faces& F) {
    const Indices component = vertex_components(F, V.rows());
    std::vector<int> size(static_cast<std::size_t>(component.maxCoeff()) + 1, 0);
    for (Eigen::Index v = 0; v < V.rows(); ++v) ++size[component[v]];
    const int largest = static_cast<int>(std::max_element(size.begin(), size.end()) - size.begin());
    if (size[largest] == V.rows()) return {};
    std::vector<int> of_largest;
    for (int f = 0; f < F.rows(); ++f)
        if (component[F(f, 0)] == largest) of_largest.push_back(f);
    if (of_largest.empty()) return {};
    const SurfaceIndex index(V, F(of_largest, Eigen::all));
    std::vector<Link> links;
    for (int v = 0; v < V.rows(); ++v) {
        if (component[v] == largest) continue;
        const SurfacePoint hit = index.closest(V.row(v).transpose());
        if (hit.face < 0) continue;
        int corner = 0;
        hit.barycentric.maxCoeff(&corner);
        const int to = index.faces()(hit.face, corner);
        links.push_back({v, to, (V.row(v) - V.row(to)).norm()});
    }
    return links;
}

std::vector<std::pair<int, int>> node_pairs(const DeformationNodes& nodes) {
    std::vector<std::vector<int>> above(static_cast<std::size_t>(nodes.size()));
    for (std::size_t v = 0; v + 1 < nodes.start.size(); ++v)
        for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a)
            for (int b = a; b < nodes.start[v + 1]; ++b) above[nodes.carrier[a]].push_back(nodes.carrier[b]);
    std::vector<std::pair<int, int>> pairs;
    for (int k = 0; k < nodes.size(); ++k) {
        std::sort(above[k].begin(), above[k].end());
        above[k].erase(std::unique(above[k].begin(), above[k].end()), above[k].end());
        for (int l : above[k]) pairs.emplace_back(k, l);
    }
    return pairs;
}

}  // namespace

GeodesicGraph::GeodesicGraph(const Vertices& V, const Faces& F) {
    const Edges edges = unique_edges(F);
    std::vector<Link> links = component_links(V, F);
    for (Eigen::Index e = 0; e < edges.rows(); ++e)
        links.push_back({edges(e, 0), edges(e, 1), (V.row(edges(e, 0)) - V.row(edges(e, 1))).norm()});
    start_.assign(static_cast<std::size_t>(V.rows()) + 1, 0);
    for (const Link& l : links) {
        ++start_[l.from + 1];
        ++start_[l.to + 1];
    }
    std::partial_sum(start_.begin(), start_.end(), start_.begin());
    to_.resize(2 * links.size());
    length_.resize(to_.size());
    std::vector<int> next(start_.begin(), start_.end() - 1);
    const auto add = [&](int from, int to, double length) {
        to_[next[from]] = to;
        length_[next[from]++] = length;
    };
    for (const Link& l : links) {
        add(l.from, l.to, l.length);
        add(l.to, l.from, l.length);
    }
}

template <class Visit>
void GeodesicGraph::walk(int source, double reach, std::vector<double>& distance, Visit&& visit) const {
    using Entry = std::pair<double, int>;
    std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
    std::vector<int> touched{source};
    distance[source] = 0;
    queue.push({0, source});
    while (!queue.empty()) {
        const auto [d, v] = queue.top();
        queue.pop();
        if (d > distance[v]) continue;
        visit(v, d);
        for (int i = start_[v]; i < start_[v + 1]; ++i)
            if (const double next = d + length_[i]; next < reach && next < distance[to_[i]]) {
                if (distance[to_[i]] == INFINITY) touched.push_back(to_[i]);
                distance[to_[i]] = next;
                queue.push({next, to_[i]});
            }
    }
    for (int v : touched) distance[v] = INFINITY;
}

double GeodesicGraph::median_length() const {
    if (length_.empty()) return 0;
    std::vector<double> lengths = length_;
    const auto middle = lengths.begin() + static_cast<std::ptrdiff_t>(lengths.size() / 2);
    std::nth_element(lengths.begin(), middle, lengths.end());
    return *middle;
}

Cover cover(const GeodesicGraph& graph, double radius) {
    const auto n = static_cast<std::size_t>(graph.size());
    Cover out{{}, std::vector<int>(n, -1)};
    std::vector<double> scratch(n, INFINITY), nearest(n, INFINITY);
    for (int seed = 0; seed < graph.size(); ++seed) {
        if (out.owner[seed] >= 0) continue;
        const int own = static_cast<int>(out.vertex.size());
        out.vertex.push_back(seed);
        graph.walk(seed, std::nextafter(radius, INFINITY), scratch, [&](int v, double d) {
            if (d >= nearest[v]) return;
            nearest[v] = d;
            out.owner[v] = own;
        });
    }
    return out;
}

DeformationNodes deformation_nodes(const GeodesicGraph& graph, double radius) {
    struct Reach {
        double distance;
        int other;
        bool operator<(const Reach& o) const { return std::tie(distance, other) < std::tie(o.distance, o.other); }
    };
    DeformationNodes nodes;
    nodes.vertex = cover(graph, radius).vertex;
    constexpr std::int64_t block = 16;
    const std::int64_t count = nodes.size();
    std::vector<std::vector<Reach>> from(static_cast<std::size_t>(count));
    parallel_for((count + block - 1) / block, [&](std::int64_t b) {
        std::vector<double> scratch(static_cast<std::size_t>(graph.size()), INFINITY);
        for (std::int64_t k = b * block; k < std::min(count, (b + 1) * block); ++k)
            graph.walk(nodes.vertex[k], 2 * radius, scratch, [&](int v, double d) { from[k].push_back({d, v}); });
    }, 1);
    std::vector<std::vector<Reach>> reached(static_cast<std::size_t>(graph.size()));
    for (int k = 0; k < count; ++k)
        for (const Reach& r : from[k]) reached[r.other].push_back({r.distance, k});
    nodes.start.assign(1, 0);
    for (auto& near : reached) {
        std::sort(near.begin(), near.end());
        if (near.size() > DeformationNodes::carriers) near.resize(DeformationNodes::carriers);
        std::sort(near.begin(), near.end(), [](const Reach& a, const Reach& b) { return a.other < b.other; });
        double sum = 0;
        for (const Reach& r : near) sum += std::pow(1 - r.distance * r.distance / (4 * radius * radius), 3);
        for (const Reach& r : near) {
            nodes.carrier.push_back(r.other);
            nodes.weight.push_back(std::pow(1 - r.distance * r.distance / (4 * radius * radius), 3) / sum);
        }
        nodes.start.push_back(static_cast<int>(nodes.carrier.size()));
    }
    nodes.pairs = node_pairs(nodes);
    return nodes;
}

}  // namespace toile
