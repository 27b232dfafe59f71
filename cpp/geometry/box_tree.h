// A tree of axis-parallel boxes over the triangles of a mesh, in double, so that no pair is lost to rounding.
#pragma once
#include <Eigen/Geometry>
#include <vector>

#include "base/types.h"
#include "geometry/closest.h"

namespace toile {

using Box = Eigen::AlignedBox3d;

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face);

/// Median splits of the faces' centres. Nodes lie in preorder: the left child of `k` is `k + 1`.
/// The tree keeps the corners of its faces; `refit` moves them and keeps the splits.
class BoxTree {
public:
    struct Node {
        Box box;
        int begin = 0, end = 0;  ///< range in `order()`
        int right = -1;          ///< -1: a leaf
        bool leaf() const { return right < 0; }
        int size() const { return end - begin; }
    };
    struct Triangle {
        Vec3 a, b, c;
    };

    BoxTree(const Vertices& V, const Faces& F);

    /// New positions. Faces marked in `hidden` (per face; none when empty) meet nothing until the next call.
    void refit(const Vertices& V, const Faces& F, const std::vector<char>& hidden = {});

    const std::vector<Node>& nodes() const { return nodes_; }
    const std::vector<int>& order() const { return order_; }  ///< faces, leaf after leaf
    const Triangle& triangle(int slot) const { return triangles_[static_cast<std::size_t>(slot)]; }  ///< as in `order()`
    const Box& box(int slot) const { return boxes_[static_cast<std::size_t>(slot)]; }  ///< empty for a hidden face
    int slot_of(int face) const { return slot_[static_cast<std::size_t>(face)]; }

    /// Calls `visit(slot)` for every face whose box meets the closed box, in no meaningful order.
    template <class Visit>
    void visit_overlapping(const Box& box, Visit&& visit) const;
    /// The closest point of all faces; the smallest face among equals. A near `guess` saves time and changes nothing.
    SurfacePoint closest(const Vec3& p, int guess = -1) const;

private:
    int split(const std::vector<Vec3>& centre, int begin, int end);

    std::vector<Node> nodes_;
    std::vector<int> order_, slot_;
    std::vector<Triangle> triangles_;
    std::vector<Box> boxes_;
};

template <class Visit>
void BoxTree::visit_overlapping(const Box& box, Visit&& visit) const {
    int stack[64], top = 0;  // median splits: depth <= log2(2^31 / leaf size)
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
        for (int k = node.begin; k < node.end; ++k)
            if (boxes_[static_cast<std::size_t>(k)].intersects(box)) visit(k);
    }
}

}  // namespace toile
