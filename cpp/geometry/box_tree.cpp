#include "geometry/box_tree.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "base/parallel.h"

namespace toile {

namespace {

constexpr int leaf_size = 4;
constexpr int stack_size = 64;             // median splits: depth <= log2(2^31 / leaf_size)
constexpr double rounding = 1 + 1e-12;     // so that pruning cannot decide between equal distances

double squared_distance(const Box& box, const Vec3& p) {
    const Vec3 low = box.min() - p, high = p - box.max();
    return low.cwiseMax(high).cwiseMax(0.0).squaredNorm();
}

}  // namespace

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face) {
    Box box(Vec3(V.row(F(face, 0))));
    box.extend(Vec3(V.row(F(face, 1))));
    box.extend(Vec3(V.row(F(face, 2))));
    return box;
}

BoxTree::BoxTree(const Vertices& V, const Faces& F) {
    const auto m = static_cast<std::size_t>(F.rows());
    order_.resize(m);
    slot_.resize(m);
    triangles_.resize(m);
    boxes_.resize(m);
    std::iota(order_.begin(), order_.end(), 0);
    std::vector<Vec3> centre(m);
    for (std::size_t f = 0; f < m; ++f) centre[f] = toile::face_box(V, F, static_cast<Eigen::Index>(f)).center();
    nodes_.reserve(m);
    if (m > 0) split(centre, 0, static_cast<int>(m));
    for (std::size_t k = 0; k < m; ++k) slot_[static_cast<std::size_t>(order_[k])] = static_cast<int>(k);
    refit(V, F);
}

int BoxTree::split(const std::vector<Vec3>& centre, int begin, int end) {
    const int self = static_cast<int>(nodes_.size());
    nodes_.push_back({Box(), begin, end, -1});
    if (end - begin <= leaf_size) return self;
    Box centres;
    for (int k = begin; k < end; ++k) centres.extend(centre[static_cast<std::size_t>(order_[static_cast<std::size_t>(k)])]);
    int axis = 0;
    centres.sizes().maxCoeff(&axis);
    const int middle = begin + (end - begin) / 2;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end, [&](int a, int b) {
        const double x = centre[static_cast<std::size_t>(a)][axis], y = centre[static_cast<std::size_t>(b)][axis];
        return x < y || (x == y && a < b);
    });
    split(centre, begin, middle);
    const int right = split(centre, middle, end);
    nodes_[static_cast<std::size_t>(self)].right = right;
    return self;
}

void BoxTree::refit(const Vertices& V, const Faces& F, const std::vector<char>& hidden) {
    parallel_for(F.rows(), [&](std::int64_t k) {
        const auto slot = static_cast<std::size_t>(k);
        const int f = order_[slot];
        triangles_[slot] = {V.row(F(f, 0)), V.row(F(f, 1)), V.row(F(f, 2))};
        const bool seen = hidden.empty() || !hidden[static_cast<std::size_t>(f)];
        boxes_[slot] = seen ? toile::face_box(V, F, f) : Box();
    }, 2048);
    for (std::size_t self = nodes_.size(); self-- > 0;) {
        Node& node = nodes_[self];
        if (!node.leaf()) {
            node.box = nodes_[self + 1].box.merged(nodes_[static_cast<std::size_t>(node.right)].box);
            continue;
        }
        node.box.setEmpty();
        for (int k = node.begin; k < node.end; ++k) node.box.extend(box(k));
    }
}

SurfacePoint BoxTree::closest(const Vec3& p, int guess) const {
    struct Ahead {
        int node;
        double square;
    } stack[stack_size];
    int top = 0, slot = -1;
    double square = std::numeric_limits<double>::infinity();
    const auto visit = [&](int k) {  // relative to p: no digits are lost far from the origin
        const Triangle& t = triangle(k);
        const double s = closest_on_triangle(Vec3::Zero(), t.a - p, t.b - p, t.c - p).point.squaredNorm();
        const bool earlier = slot < 0 || order_[static_cast<std::size_t>(k)] < order_[static_cast<std::size_t>(slot)];
        if (s < square || (s == square && earlier)) square = s, slot = k;
    };
    if (guess >= 0) visit(slot_of(guess));
    if (!nodes_.empty()) stack[top++] = {0, squared_distance(nodes_[0].box, p)};
    while (top > 0) {
        const auto [self, box_square] = stack[--top];
        if (box_square > square * rounding) continue;
        const Node& node = nodes_[static_cast<std::size_t>(self)];
        if (node.leaf()) {
            for (int k = node.begin; k < node.end; ++k) visit(k);
            continue;
        }
        const int left = self + 1, right = node.right;
        const double l = squared_distance(nodes_[static_cast<std::size_t>(left)].box, p),
                     r = squared_distance(nodes_[static_cast<std::size_t>(right)].box, p);
        const bool left_first = l <= r;
        stack[top++] = left_first ? Ahead{right, r} : Ahead{left, l};
        stack[top++] = left_first ? Ahead{left, l} : Ahead{right, r};
    }
    SurfacePoint out;
    if (slot < 0) return out;
    const Triangle& t = triangle(slot);
    out = closest_on_triangle(Vec3::Zero(), t.a - p, t.b - p, t.c - p);
    out.distance = out.point.norm();
    out.point += p;
    out.face = order_[static_cast<std::size_t>(slot)];
    return out;
}

}  // namespace toile
