#include "geometry/box_tree.h"

#include <algorithm>
#include <numeric>

namespace toile {

namespace {
constexpr int leaf_size = 4;
}

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face) {
    Box box(Vec3(V.row(F(face, 0))));
    box.extend(Vec3(V.row(F(face, 1))));
    box.extend(Vec3(V.row(F(face, 2))));
    return box;
}

BoxTree::BoxTree(const Vertices& V, const Faces& F) {
    const auto m = static_cast<std::size_t>(F.rows());
    boxes_.resize(m);
    order_.resize(m);
    std::iota(order_.begin(), order_.end(), 0);
    std::vector<Vec3> centre(m);
    for (std::size_t f = 0; f < m; ++f) {
        boxes_[f] = toile::face_box(V, F, static_cast<Eigen::Index>(f));
        centre[f] = boxes_[f].center();
    }
    nodes_.reserve(m);
    if (m > 0) split(centre, 0, static_cast<int>(m));
}

int BoxTree::split(const std::vector<Vec3>& centre, int begin, int end) {
    const int self = static_cast<int>(nodes_.size());
    Node node;
    node.begin = begin;
    node.end = end;
    Box centres;
    for (int k = begin; k < end; ++k) {
        const auto f = static_cast<std::size_t>(order_[static_cast<std::size_t>(k)]);
        node.box.extend(boxes_[f]);
        centres.extend(centre[f]);
    }
    nodes_.push_back(node);
    if (end - begin <= leaf_size) return self;
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

void BoxTree::overlapping(const Box& box, std::vector<int>& faces) const {
    int stack[64], top = 0;  // median splits: depth <= log2(2^31 / leaf_size)
    if (!nodes_.empty()) stack[top++] = 0;
    while (top > 0) {
        const int self = stack[--top];
        const Node& node = nodes_[static_cast<std::size_t>(self)];
        if (!node.box.intersects(box)) continue;
        if (!node.leaf()) {
            stack[top++] = node.right;
            stack[top++] = self + 1;
            continue;
        }
        for (int k = node.begin; k < node.end; ++k) {
            const int f = order_[static_cast<std::size_t>(k)];
            if (boxes_[static_cast<std::size_t>(f)].intersects(box)) faces.push_back(f);
        }
    }
}

}  // namespace toile
