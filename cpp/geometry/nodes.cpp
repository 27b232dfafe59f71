#include "geometry/nodes.h"

#include <algorithm>
#include <cmath>
#include <queue>

#include "geometry/closest.h"
#include "geometry/topology.h"

namespace toile {

namespace {

struct Arc {
    int to;
    double length;
};
using Graph = std::vector<std::vector<Arc>>;

/// Links every vertex of the smaller components to the closest face of the largest.
void link_components(const Vertices& V, const Faces& F, Graph& graph) {
    const Indices component = vertex_components(F, V.rows());
    std::vector<int> size(static_cast<std::size_t>(component.maxCoeff()) + 1, 0);
    for (Eigen::Index v = 0; v < V.rows(); ++v) ++size[component[v]];
    const int largest = static_cast<int>(std::max_element(size.begin(), size.end()) - size.begin());
    if (size[largest] == V.rows()) return;
    std::vector<int> of_largest;
    for (int f = 0; f < F.rows(); ++f)
        if (component[F(f, 0)] == largest) of_largest.push_back(f);
    if (of_largest.empty()) return;
    const SurfaceIndex index(V, F(of_largest, Eigen::all));
    for (int v = 0; v < V.rows(); ++v) {
        if (component[v] == largest) continue;
        const SurfacePoint hit = index.closest(V.row(v).transpose());
        if (hit.face < 0) continue;
        int corner = 0;
        hit.barycentric.maxCoeff(&corner);
        const int to = index.faces()(hit.face, corner);
        const double length = (V.row(v) - V.row(to)).norm();
        graph[v].push_back({to, length});
        graph[to].push_back({v, length});
    }
}

Graph edge_graph(const Vertices& V, const Faces& F) {
    Graph graph(static_cast<std::size_t>(V.rows()));
    const Edges edges = unique_edges(F);
    for (Eigen::Index e = 0; e < edges.rows(); ++e) {
        const int i = edges(e, 0), j = edges(e, 1);
        const double length = (V.row(i) - V.row(j)).norm();
        graph[i].push_back({j, length});
        graph[j].push_back({i, length});
    }
    link_components(V, F, graph);
    return graph;
}

/// Dijkstra from one vertex up to `reach`; calls visit(vertex, distance) in order of (distance, vertex). `distance`
/// is scratch, infinite before and after.
template <class Visit>
void walk(const Graph& graph, int source, double reach, std::vector<double>& distance, Visit&& visit) {
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
        for (const Arc& arc : graph[v])
            if (const double next = d + arc.length; next < reach && next < distance[arc.to]) {
                distance[arc.to] = next;
                touched.push_back(arc.to);
                queue.push({next, arc.to});
            }
    }
    for (int v : touched) distance[v] = INFINITY;
}

std::vector<std::pair<int, int>> node_pairs(const DeformationNodes& nodes) {
    std::vector<std::pair<int, int>> pairs;
    for (std::size_t v = 0; v + 1 < nodes.start.size(); ++v)
        for (int a = nodes.start[v]; a < nodes.start[v + 1]; ++a)
            for (int b = a; b < nodes.start[v + 1]; ++b) pairs.emplace_back(nodes.carrier[a], nodes.carrier[b]);
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    return pairs;
}

}  // namespace

DeformationNodes cover_by_nodes(const Vertices& V, const Faces& F, double radius) {
    struct Reach {
        double distance;
        int node;
        bool operator<(const Reach& o) const { return std::tie(distance, node) < std::tie(o.distance, o.node); }
    };
    const Graph graph = edge_graph(V, F);
    std::vector<double> scratch(graph.size(), INFINITY);
    std::vector<char> covered(graph.size(), 0);
    std::vector<std::vector<Reach>> reached(graph.size());
    DeformationNodes nodes;
    for (int seed = 0; seed < V.rows(); ++seed) {
        if (covered[seed]) continue;
        const int node = nodes.size();
        nodes.vertex.push_back(seed);
        walk(graph, seed, 2 * radius, scratch, [&](int v, double d) {
            if (d <= radius) covered[v] = 1;
            reached[v].push_back({d, node});
        });
    }
    nodes.start.assign(1, 0);
    for (auto& near : reached) {
        std::sort(near.begin(), near.end());
        if (near.size() > DeformationNodes::carriers) near.resize(DeformationNodes::carriers);
        std::sort(near.begin(), near.end(), [](const Reach& a, const Reach& b) { return a.node < b.node; });
        double sum = 0;
        for (const Reach& r : near) sum += std::pow(1 - r.distance * r.distance / (4 * radius * radius), 3);
        for (const Reach& r : near) {
            nodes.carrier.push_back(r.node);
            nodes.weight.push_back(std::pow(1 - r.distance * r.distance / (4 * radius * radius), 3) / sum);
        }
        nodes.start.push_back(static_cast<int>(nodes.carrier.size()));
    }
    nodes.pairs = node_pairs(nodes);
    return nodes;
}

}  // namespace toile
