#include "geometry/topology.h"

#include <algorithm>
#include <iterator>
#include <numeric>
#include <tuple>

#include "base/parallel.h"

namespace toile {

namespace {

/// Compressed rows of the (row, value) pairs that `each` visits; values ascending, repeats kept.
template <class Each>
Adjacency rows_of(Eigen::Index rows, Each&& each) {
    Adjacency a;
    a.start.assign(static_cast<std::size_t>(rows) + 1, 0);
    each([&](int row, int) { ++a.start[row + 1]; });
    std::partial_sum(a.start.begin(), a.start.end(), a.start.begin());
    a.index.resize(static_cast<std::size_t>(a.start.back()));
    std::vector<int> next(a.start.begin(), a.start.end() - 1);
    each([&](int row, int value) { a.index[next[row]++] = value; });
    parallel_for(
        rows, [&](std::int64_t r) { std::sort(a.index.begin() + a.start[r], a.index.begin() + a.start[r + 1]); }, 4096);
    return a;
}

Adjacency each_once(const Adjacency& a) {
    Adjacency once;
    once.start.assign(1, 0);
    once.index.reserve(a.index.size());
    for (int r = 0; r < a.size(); ++r) {
        std::unique_copy(a.index.begin() + a.start[r], a.index.begin() + a.start[r + 1],
                         std::back_inserter(once.index));
        once.start.push_back(static_cast<int>(once.index.size()));
    }
    return once;
}

/// The ends of every face's sides, seen from both ends.
Adjacency sides(const Faces& F, Eigen::Index n) {
    return rows_of(n, [&](auto&& visit) {
        for (Eigen::Index f = 0; f < F.rows(); ++f)
            for (int c = 0; c < 3; ++c)
                if (const int i = F(f, c), j = F(f, (c + 1) % 3); i != j) {
                    visit(i, j);
                    visit(j, i);
                }
    });
}

}  // namespace

Edges unique_edges(const Faces& F) {
    const Adjacency ring = vertex_neighbours(F, F.size() > 0 ? F.maxCoeff() + 1 : 0);
    Edges edges(static_cast<Eigen::Index>(ring.index.size() / 2), 2);
    Eigen::Index e = 0;
    for (int v = 0; v < ring.size(); ++v)
        for (int k = ring.start[v]; k < ring.start[v + 1]; ++k)
            if (ring.index[k] > v) edges.row(e++) << v, ring.index[k];
    return edges;
}

Adjacency vertex_neighbours(const Faces& F, Eigen::Index n) { return each_once(sides(F, n)); }

Adjacency vertex_faces(const Faces& F, Eigen::Index n) {
    return each_once(rows_of(n, [&](auto&& visit) {
        for (Eigen::Index f = 0; f < F.rows(); ++f)
            for (int c = 0; c < 3; ++c) visit(F(f, c), static_cast<int>(f));
    }));
}

namespace {

using Sides = std::vector<std::pair<int, int>>;

/// Sides of one face only, as that face runs, in the order of faces.
Sides border_sides(const Faces& F, Eigen::Index n) {
    const Adjacency ends = sides(F, n);
    Sides border;
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) {
            const int i = F(f, c), j = F(f, (c + 1) % 3);
            const auto begin = ends.index.begin();
            const auto [first, last] = std::equal_range(begin + ends.start[i], begin + ends.start[i + 1], j);
            if (i != j && last - first == 1) border.emplace_back(i, j);
        }
    return border;
}

/// Walks along each side once, in its direction where one leaves the vertex, else against it.
class BorderWalk {
public:
    BorderWalk(const Sides& border, Eigen::Index n)
        : border_(border), m_(static_cast<int>(border.size())), taken_(border.size(), 0),
          at_(rows_of(n,
                      [&](auto&& visit) {
                          for (int k = 0; k < m_; ++k) {
                              visit(border[k].first, k);
                              visit(border[k].second, m_ + k);
                          }
                      })),
          next_(at_.start) {}

    /// The vertex after v, -1 where no side is left.
    int step(int v) {
        for (int& i = next_[v]; i < at_.start[v + 1]; ++i) {
            const int k = at_.index[i] % m_;
            if (taken_[k]) continue;
            taken_[k] = 1;
            return at_.index[i] < m_ ? border_[k].second : border_[k].first;
        }
        return -1;
    }

private:
    const Sides& border_;
    int m_;
    std::vector<char> taken_;
    Adjacency at_;  // of a vertex the sides that leave it, and m more for those that reach it
    std::vector<int> next_;
};

}  // namespace

std::vector<std::vector<int>> boundary_loops(const Faces& F) {
    const Eigen::Index n = F.size() > 0 ? F.maxCoeff() + 1 : 0;
    const Sides border = border_sides(F, n);
    BorderWalk walk(border, n);
    std::vector<std::vector<int>> loops;
    std::vector<int> path, place(static_cast<std::size_t>(n), -1);  // of a vertex on the path
    for (const auto& side : border) {
        path.assign(1, side.first);
        place[side.first] = 0;
        while (!path.empty()) {
            const int at = walk.step(path.back());
            if (at < 0) {  // the start again, or the end of an open chain
                place[path.back()] = -1;
                path.pop_back();
            } else if (place[at] < 0) {
                place[at] = static_cast<int>(path.size());
                path.push_back(at);
            } else {
                const auto first = path.begin() + place[at];
                auto& loop = loops.emplace_back(first, path.end());
                std::rotate(loop.begin(), std::min_element(loop.begin(), loop.end()), loop.end());
                std::for_each(first + 1, path.end(), [&](int v) { place[v] = -1; });
                path.erase(first + 1, path.end());
            }
        }
    }
    std::sort(loops.begin(), loops.end(),
              [](const auto& a, const auto& b) { return a.size() != b.size() ? a.size() > b.size() : a < b; });
    return loops;
}

Faces face_neighbours(const Faces& F) {
    struct Side {
        std::int32_t low, high;  // its ends
        std::int64_t corner;     // opposite, 3 f + k
    };
    std::vector<Side> sides;
    sides.reserve(static_cast<std::size_t>(F.size()));
    for (std::int64_t c = 0; c < F.size(); ++c) {
        const auto [low, high] = std::minmax({F(c / 3, (c + 1) % 3), F(c / 3, (c + 2) % 3)});
        sides.push_back({low, high, c});
    }
    std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
        return std::tie(a.low, a.high, a.corner) < std::tie(b.low, b.high, b.corner);
    });
    Faces beyond = Faces::Constant(F.rows(), 3, -1);
    for (std::size_t first = 0, last = 0; first < sides.size(); first = last) {
        while (last < sides.size() && sides[last].low == sides[first].low && sides[last].high == sides[first].high)
            ++last;
        if (last - first != 2) continue;
        const std::int64_t one = sides[first].corner, other = sides[first + 1].corner;
        beyond(one / 3, one % 3) = static_cast<std::int32_t>(other / 3);
        beyond(other / 3, other % 3) = static_cast<std::int32_t>(one / 3);
    }
    return beyond;
}

std::vector<char> border_vertices(const Faces& F, Eigen::Index n) {
    const Adjacency ends = sides(F, n);
    std::vector<char> mark(static_cast<std::size_t>(n), 0);
    parallel_for(n, [&](std::int64_t v) {
        const auto begin = ends.index.begin() + ends.start[v], end = ends.index.begin() + ends.start[v + 1];
        for (auto i = begin; i != end;) {
            const auto next = std::upper_bound(i, end, *i);
            mark[v] |= next - i == 1;
            i = next;
        }
    }, 4096);
    return mark;
}

Indices vertex_components(const Faces& F, Eigen::Index n) {
    std::vector<int> parent(static_cast<std::size_t>(n));
    std::iota(parent.begin(), parent.end(), 0);
    auto root = [&](int v) {
        while (parent[static_cast<std::size_t>(v)] != v)
            v = parent[static_cast<std::size_t>(v)] =
                parent[static_cast<std::size_t>(parent[static_cast<std::size_t>(v)])];
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
