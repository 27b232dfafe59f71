// A tree of axis-parallel boxes over the triangles of a mesh, in double, so that no pair is lost to rounding.
#pragma once
#include <Eigen/Geometry>
#include <vector>

#include "base/types.h"

namespace toile {

using Box = Eigen::AlignedBox3d;

Box face_box(const Vertices& V, const Faces& F, Eigen::Index face);

/// Median splits of the faces' centres. Nodes lie in preorder: the left child of `k` is `k + 1`.
class BoxTree {
public:
    struct Node {
        Box box;
        int begin = 0, end = 0;  ///< range in `order()`
        int right = -1;          ///< -1: a leaf
        bool leaf() const { return right < 0; }
    };

    BoxTree(const Vertices& V, const Faces& F);

    const std::vector<Node>& nodes() const { return nodes_; }
    const std::vector<int>& order() const { return order_; }  ///< faces, leaf after leaf
    const Box& face_box(int face) const { return boxes_[static_cast<std::size_t>(face)]; }

    /// Appends every face whose box meets the closed box, in no meaningful order.
    void overlapping(const Box& box, std::vector<int>& faces) const;

private:
    int split(const std::vector<Vec3>& centre, int begin, int end);

    std::vector<Node> nodes_;
    std::vector<int> order_;
    std::vector<Box> boxes_;
};

}  // namespace toile
