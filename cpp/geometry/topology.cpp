#include "geometry/topology.h"

#include <algorithm>
#include <map>
#include <numeric>

namespace toile {

Edges unique_edges(const Faces& F) {
    std::vector<std::pair<int, int>> e;
    e.reserve(static_cast<std::size_t>(F.rows()) * 3);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            if (i != j) e.emplace_back(std::min(i, j), std::max(i, j));
        }
    std::sort(e.begin(), e.end());
    e.erase(std::unique(e.begin(), e.end()), e.end());
    Edges out(static_cast<Eigen::Index>(e.size()), 2);
    for (std::size_t k = 0; k < e.size(); ++k) out.row(static_cast<Eigen::Index>(k)) << e[k].first, e[k].second;
    return out;
}

namespace {

/// Compressed rows from (row, value) pairs, values ascending and each once per row.
Adjacency compress(const std::vector<std::pair<int, int>>& pairs, Eigen::Index rows) {
    std::vector<int> next(static_cast<std::size_t>(rows) + 1, 0), values(pairs.size());
    for (const auto& [row, value] : pairs) ++next[static_cast<std::size_t>(row) + 1];
    std::partial_sum(next.begin(), next.end(), next.begin());
    const std::vector<int> begin = next;
    for (const auto& [row, value] : pairs) values[static_cast<std::size_t>(next[static_cast<std::size_t>(row)]++)] = value;
    Adjacency a;
    a.start.reserve(begin.size());
    a.start.push_back(0);
    a.index.reserve(pairs.size());
    for (std::size_t row = 0; row + 1 < begin.size(); ++row) {
        const auto first = values.begin() + begin[row], last = values.begin() + begin[row + 1];
        std::sort(first, last);
        a.index.insert(a.index.end(), first, std::unique(first, last));
        a.start.push_back(static_cast<int>(a.index.size()));
    }
    return a;
}

}  // namespace

Adjacency vertex_neighbours(const Faces& F, Eigen::Index n) {
    std::vector<std::pair<int, int>> pairs;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            if (i == j) continue;
            pairs.emplace_back(i, j);
            pairs.emplace_back(j, i);
        }
    return compress(pairs, n);
}

Adjacency vertex_faces(const Faces& F, Eigen::Index n) {
    std::vector<std::pair<int, int>> pairs;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) pairs.emplace_back(F(f, c), static_cast<int>(f));
    return compress(pairs, n);
}

std::vector<std::vector<int>> boundary_loops(const Faces& F) {
    std::map<std::pair<int, int>, int> count;  // undirected edge -> faces
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            ++count[{std::min(i, j), std::max(i, j)}];
        }
    std::multimap<int, int> next;  // boundary half-edges i -> j
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            if (i != j && count[{std::min(i, j), std::max(i, j)}] == 1) next.emplace(i, j);
        }
    std::vector<std::vector<int>> loops;
    while (!next.empty()) {
        auto edge = next.begin();  // smallest vertex first
        std::vector<int> loop{edge->first};
        int at = edge->second;
        next.erase(edge);
        while (at != loop.front()) {
            loop.push_back(at);
            auto step = next.find(at);
            if (step == next.end()) break;  // an open chain of a badly oriented mesh
            at = step->second;
            next.erase(step);
        }
        loops.push_back(std::move(loop));
    }
    std::stable_sort(loops.begin(), loops.end(), [](const auto& a, const auto& b) { return a.size() > b.size(); });
    return loops;
}

std::vector<char> boundary_vertices(const Faces& F, Eigen::Index n) {
    std::vector<char> mark(static_cast<std::size_t>(n), 0);
    for (const auto& loop : boundary_loops(F))
        for (int v : loop) mark[static_cast<std::size_t>(v)] = 1;
    return mark;
}

Indices vertex_components(const Faces& F, Eigen::Index n) {
    std::vector<int> parent(static_cast<std::size_t>(n));
    std::iota(parent.begin(), parent.end(), 0);
    auto root = [&](int v) {
        while (parent[static_cast<std::size_t>(v)] != v)
            v = parent[static_cast<std::size_t>(v)] = parent[static_cast<std::size_t>(parent[static_cast<std::size_t>(v)])];
        return v;
    };
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 1; c < 3; ++c) {
            const int a = root(F(f, 0)), b = root(F(f, c));
            parent[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
        }
    Indices component(n);
    int components = 0;
    for (Eigen::Index v = 0; v < n; ++v) {
        const int r = root(static_cast<int>(v));
        component[v] = r == v ? components++ : component[r];  // roots are the smallest of their component
    }
    return component;
}

}  // namespace toile
