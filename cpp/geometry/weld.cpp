#include "geometry/weld.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <numeric>
#include <tuple>

namespace toile {

/// In a closed ring every neighbour is seen twice, so that the neighbours' hashes cancel (splitmix64). A tenth of the
/// time of counting edges.
std::vector<char> open_vertices(const Faces& F, Eigen::Index n) {
    const auto hash = [](int v) {
        std::uint64_t z = (static_cast<std::uint64_t>(v) + 1) * 0x9e3779b97f4a7c15ull;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
        return z ^ (z >> 31);
    };
    std::vector<std::uint64_t> sum(static_cast<std::size_t>(n), 0);
    for (Eigen::Index f = 0; f < F.rows(); ++f)
        for (int c = 0; c < 3; ++c) sum[F(f, c)] ^= hash(F(f, (c + 1) % 3)) ^ hash(F(f, (c + 2) % 3));
    std::vector<char> open(sum.size());
    std::transform(sum.begin(), sum.end(), open.begin(), [](std::uint64_t x) { return x != 0; });
    return open;
}

std::vector<int> first_alike(const Faces& F, Eigen::Index n) {
    struct Listing {
        int middle, largest, face;
    };
    std::vector<int> start(static_cast<std::size_t>(n) + 1, 0);  // faces by their smallest corner
    for (Eigen::Index f = 0; f < F.rows(); ++f) ++start[F.row(f).minCoeff() + 1];
    std::partial_sum(start.begin(), start.end(), start.begin());
    std::vector<int> next(start.begin(), start.end() - 1), first(static_cast<std::size_t>(F.rows()));
    std::vector<Listing> listed(first.size());
    for (int f = 0; f < F.rows(); ++f) {
        std::array<int, 3> c{F(f, 0), F(f, 1), F(f, 2)};
        std::sort(c.begin(), c.end());
        const auto end = listed.begin() + next[c[0]];
        const auto same = std::find_if(listed.begin() + start[c[0]], end,
                                       [&](const Listing& l) { return l.middle == c[1] && l.largest == c[2]; });
        first[f] = same == end ? f : same->face;
        if (same == end) listed[next[c[0]]++] = {c[1], c[2], f};
    }
    return first;
}

Faces distinct_faces(const Faces& F, Eigen::Index n) {
    const std::vector<int> first = first_alike(F, n);
    std::vector<int> keep;
    keep.reserve(first.size());
    for (int f = 0; f < F.rows(); ++f)
        if (first[f] == f && F(f, 0) != F(f, 1) && F(f, 1) != F(f, 2) && F(f, 2) != F(f, 0)) keep.push_back(f);
    return static_cast<Eigen::Index>(keep.size()) == F.rows() ? F : F(keep, Eigen::all);
}

Welded weld(const Vertices& V, const Faces& F) {
    Welded out{distinct_faces(F, V.rows()), {}};
    const std::vector<char> open = open_vertices(out.F, V.rows());
    std::vector<int> order;
    for (int v = 0; v < V.rows(); ++v)
        if (open[v]) order.push_back(v);
    const auto place = [&](int v) { return std::tuple(V(v, 0), V(v, 1), V(v, 2)); };
    std::sort(order.begin(), order.end(),
              [&](int a, int b) { return std::tuple(place(a), a) < std::tuple(place(b), b); });
    for (std::size_t i = 1; i < order.size(); ++i) {
        if (place(order[i]) != place(order[i - 1])) continue;
        if (out.to.empty()) {
            out.to.resize(static_cast<std::size_t>(V.rows()));
            std::iota(out.to.begin(), out.to.end(), 0);
        }
        out.to[order[i]] = out.to[order[i - 1]];
    }
    if (!out.to.empty()) out.F = distinct_faces(out.F.unaryExpr([&](int v) { return out.to[v]; }), V.rows());
    return out;
}

}  // namespace toile
