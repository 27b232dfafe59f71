#include "geometry/oriented_tree.h"

#include <algorithm>

#include "base/parallel.h"

namespace toile {

namespace {

constexpr float nowhere = 1e15f;  // the square stays finite

/// Begin of share i of n things in `shares` equal parts.
int share(std::int64_t n, std::int64_t i, std::int64_t shares) { return static_cast<int>(n * i / shares); }

template <class Row>
float least(const Row& r) {
    return std::min({std::min(r[0], r[4]), std::min(r[1], r[5]), std::min(r[2], r[6]), std::min(r[3], r[7])});
}

template <class Row>
float greatest(const Row& r) {
    return -least<Row>(-r);
}

}  // namespace

OrientedTree::OrientedTree(const Vertices& X, const Vertices& N) : leaf_of_(static_cast<std::size_t>(X.rows())) {
    const std::int64_t n = X.rows();
    if (n == 0) return;
    std::int64_t leaves = 1, inner = 0;
    for (; leaves * wide < n; leaves *= wide) inner += leaves;
    std::vector<Place> order(leaf_of_.size());
    parallel_for(n, [&](std::int64_t v) {
        for (int c = 0; c < 3; ++c) {
            order[v].at[c] = static_cast<float>(X(v, c));
            order[v].at[c + 3] = static_cast<float>(0.2 * N(v, c));
        }
        order[v].point = static_cast<int>(v);
    }, 4096);
    for (std::int64_t parts = 1; parts < leaves; parts *= 2)
        parallel_for(parts, [&](std::int64_t i) {
            Place* const all = order.data();
            split(all + share(n, i, parts), all + share(n, 2 * i + 1, 2 * parts), all + share(n, i + 1, parts));
        }, 1);
    leaves_.resize(static_cast<std::size_t>(leaves));
    boxes_.resize(static_cast<std::size_t>(inner));
    for (std::int64_t l = 0; l < leaves; ++l) {
        Leaf& leaf = leaves_[l];
        const int begin = share(n, l, leaves), end = share(n, l + 1, leaves);
        std::sort(order.begin() + begin, order.begin() + end,
                  [](const Place& a, const Place& b) { return a.point < b.point; });
        for (int i = 0; i < wide; ++i) {
            leaf.point[i] = begin + i < end ? order[begin + i].point : -1;
            if (begin + i < end)
                leaf_of_[order[begin + i].point] = static_cast<int>(l);
            else
                for (Row& at : leaf.at) at[i] = nowhere;
        }
    }
    follow(X, N);
}

/// Parts [begin, end) about `middle` along its widest side; a normal counts a fifth of a unit of length.
void OrientedTree::split(Place* begin, Place* middle, Place* end) {
    if (middle == begin || middle == end) return;
    float low[6], high[6];
    for (int c = 0; c < 6; ++c) low[c] = high[c] = begin->at[c];
    for (const Place* p = begin + 1; p != end; ++p)
        for (int c = 0; c < 6; ++c) {
            low[c] = std::min(low[c], p->at[c]);
            high[c] = std::max(high[c], p->at[c]);
        }
    int widest = 0;
    for (int c = 1; c < 6; ++c)
        if (high[c] - low[c] > high[widest] - low[widest]) widest = c;
    std::nth_element(begin, middle, end, [widest](const Place& a, const Place& b) {
        return a.at[widest] < b.at[widest] || (a.at[widest] == b.at[widest] && a.point < b.point);
    });
}

void OrientedTree::follow(const Vertices& X, const Vertices& N) {
    parallel_for(static_cast<std::int64_t>(leaves_.size()), [&](std::int64_t l) {
        Leaf& leaf = leaves_[l];
        for (int i = 0; i < wide; ++i)
            if (const int v = leaf.point[i]; v >= 0)
                for (int c = 0; c < 3; ++c) {
                    leaf.at[c][i] = static_cast<float>(X(v, c));
                    leaf.at[c + 3][i] = static_cast<float>(N(v, c));
                }
    });
    for (std::size_t g = boxes_.size(); g-- > 0;) fit(g);
}

/// The boxes of the eight children of inner node `g`; child j is node 8 g + 1 + j of all, inner ones before leaves.
void OrientedTree::fit(std::size_t g) {
    for (int j = 0; j < wide; ++j) {
        const std::size_t child = wide * g + 1 + j;
        const bool is_leaf = child >= boxes_.size();
        for (int c = 0; c < 6; ++c) {
            if (is_leaf) {
                const Leaf& leaf = leaves_[child - boxes_.size()];
                const Row at = leaf.at[c], flipped = at == nowhere ? -at : at;
                boxes_[g].low[c][j] = least<Row>(at);
                boxes_[g].high[c][j] = greatest<Row>(flipped);
            } else {
                boxes_[g].low[c][j] = least<Row>(boxes_[child].low[c]);
                boxes_[g].high[c][j] = greatest<Row>(boxes_[child].high[c]);
            }
        }
    }
}

int OrientedTree::nearest(const Vec3& x, const Vec3& n, double spread, double reach, int guess) const {
    if (leaves_.empty()) return -1;
    const auto half = static_cast<float>(spread * spread / 2);
    const float scale[6] = {1, 1, 1, half, half, half};
    float q[6];
    for (int c = 0; c < 3; ++c) {
        q[c] = static_cast<float>(x[c]);
        q[c + 3] = static_cast<float>(n[c]);
    }
    float best = static_cast<float>(std::min(reach * reach, 1e29));
    int found = -1;
    const auto visit = [&](const Leaf& leaf) {
        Row d{};
        for (int c = 0; c < 6; ++c) {
            const Row e = leaf.at[c] - q[c];
            d += e * e * scale[c];
        }
        if (least<Row>(d) > best) return;
        for (int i = 0; i < wide; ++i)
            if (const int point = leaf.point[i];
                point >= 0 && (d[i] < best || (d[i] == best && (found < 0 || point < found)))) {
                best = d[i];
                found = point;
            }
    };
    if (guess >= 0) visit(leaves_[leaf_of_[guess]]);
    struct Entry {
        float gap;
        int node;
    } stack[wide * 12];
    int depth = 0;
    stack[depth++] = {0, 0};
    const int inner = static_cast<int>(boxes_.size());
    while (depth > 0) {
        const auto [gap, node] = stack[--depth];
        if (gap > best) continue;
        if (node >= inner) {
            visit(leaves_[node - inner]);
            continue;
        }
        const Boxes& b = boxes_[node];
        Row gaps{};
        for (int c = 0; c < 6; ++c) {
            const Row under = b.low[c] - q[c], over = q[c] - b.high[c], side = under > over ? under : over;
            const Row out = side > 0 ? side : Row{};
            gaps += out * out * scale[c];
        }
        const int base = depth;
        for (int j = 0; j < wide; ++j) {  // farthest first, so that the nearest is taken next
            if (gaps[j] > best) continue;
            int at = depth++;
            for (; at > base && stack[at - 1].gap < gaps[j]; --at) stack[at] = stack[at - 1];
            stack[at] = {gaps[j], wide * node + 1 + j};
        }
    }
    return found;
}

}  // namespace toile
